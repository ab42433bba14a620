"""Demonstrations weighted by how well they fit the observed scene, then one Gaussian of them.

Where motions depend on the scene in a way that no regression on its features shows, those of similar scenes say more
than all of them together. With phi_n the features of demonstration n and v = A phi + offset + noise, noise ~ N(0, R),
what is observed of the scene::

    w_n  ~  exp(-r_n^T (R + h^2 A D A^T)^-1 r_n / 2) + c,    r_n = v - A phi_n - offset,    sum_n w_n = 1
    mean =  sum_n w_n x_n
    S    =  k sum_n w_n (x_n - mean)(x_n - mean)^T,          k = (1 - 1/N) / (1 - sum_n w_n^2)

D holds the features' variances over the demonstrations, so that without noise the bandwidth h counts standard
deviations; noise widens the kernel, masked rows and rows that read nothing of a feature have no part in it. Few
demonstrations in the neighbourhood spread less around their own mean than the motions do: 1 - sum w^2 is the share of
the variance that is left, 1 - 1 / n_eff with the effective number n_eff = 1 / sum w^2. The factor k makes up for it as
far as the plain covariance, divided by N, does: equal weights give k = 1. S is regularised and conditioned on
everything that was observed, the scene included, as any other covariance.

Letters: N demonstrations, Z weights of all blocks, E features, M rows of the scene's observations.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Self

import torch
from jaxtyping import Bool, Float
from torch import Tensor

from eaip_prob.checks import check_type
from eaip_prob.errors import InputError, NotFittedError
from eaip_prob.gaussian import BlockGaussian
from eaip_prob.linalg import collapsed, safe_cholesky, triangular_solve
from eaip_prob.models.base import AbstractJointModel, Posterior, conditioned
from eaip_prob.models.covariance import AbstractCovariance, ShrinkageCovariance, sample_covariance
from eaip_prob.models.rows import ENVIRONMENT, Coordinates, WeightTable
from eaip_prob.observation import AbstractObservation

BANDWIDTHS = (1.0, 1.5, 3.0)
DEFAULT_BANDWIDTH = 1.5
_LEAST_FLOOR = 1e-6  # below, one demonstration may weigh so much that no variance is left to scale
_CONSTANT = 1e-20  # variance over mean square of a feature that never varied


@dataclass(frozen=True, eq=False)
class Neighbourhoods:
    """Demonstrations that can be weighted anew for every scene.

    Args:
        rows: (N, Z).
        coordinates: in which covariances are regularised.
        covariance: estimator with nothing left to choose.
        joint: the Gaussian of equally weighted demonstrations.
        bandwidth: h, in standard deviations of the features; infinity weights all alike.
        floor: c.
    """

    rows: Float[Tensor, "demonstrations joint"]
    coordinates: Coordinates
    covariance: AbstractCovariance
    joint: BlockGaussian
    bandwidth: float
    floor: float
    inner: Float[Tensor, "demonstrations joint"] = field(init=False, repr=False)

    def __post_init__(self) -> None:
        object.__setattr__(self, "inner", self.rows @ self.coordinates.forward.mT)

    @classmethod
    def of(cls, table: WeightTable, covariance: AbstractCovariance, bandwidth: float, floor: float) -> Self:
        """Makes the estimator's held-out choices, once and with equal weights."""
        inner = table.rows @ table.coordinates.forward.mT
        covariance = covariance.chosen(inner, table.folds, table.target, table.features)
        plain = table.coordinates.covariance(covariance.from_moments(sample_covariance(inner), table.features))
        joint = BlockGaussian(table.rows.mean(0), plain, table.layout)
        return cls(table.rows, table.coordinates, covariance, joint, bandwidth, floor)

    def weights(self, observations: Sequence[AbstractObservation]) -> Float[Tensor, "*batch demonstrations"] | None:
        """What each demonstration weighs given what is observed of the scene alone; None where all weigh the same."""
        # What does not fit the block is refused when the joint is conditioned on it.
        block = {ENVIRONMENT: self.joint.layout.sizes.get(ENVIRONMENT, 0)}
        scenes = [observation for observation in observations if dict(observation.num_columns) == block]
        if not scenes or math.isinf(self.bandwidth):
            return None
        features = self.rows[:, self.joint.layout.slice(ENVIRONMENT)]
        variance = features.var(0, correction=0)
        variance = torch.where(variance > _CONSTANT * features.square().mean(0), variance, 0.0)
        design, residual, noise = _stacked(scenes, torch.zeros_like(variance))
        spread = (design * variance) @ design.mT
        reads = spread.diagonal(dim1=-2, dim2=-1) > 0
        both = reads[..., :, None] & reads[..., None, :]
        kernel = torch.where(both, noise + self.bandwidth**2 * spread, torch.eye(noise.shape[-1], dtype=noise.dtype))
        misfit = torch.where(reads[..., None], residual[..., None] - design @ features.mT, 0.0)
        white = triangular_solve(safe_cholesky(kernel, "the kernel over scenes"), misfit)
        log_floor = white.new_tensor(math.log(self.floor))
        weight = torch.logaddexp(-0.5 * white.square().sum(-2), log_floor).softmax(-1)
        return None if bool((weight == weight[..., :1]).all()) else collapsed(weight, 1)

    def near(self, observations: Sequence[AbstractObservation]) -> BlockGaussian:
        """The Gaussian of the demonstrations near the observed scene, not yet conditioned on anything."""
        weight = self.weights(observations)
        if weight is None:
            return self.joint
        concentration = weight.square().sum(-1)
        spread = (1.0 - 1.0 / len(self.rows)) / (1.0 - concentration)
        deviation = self.inner - (weight @ self.inner)[..., None, :]
        half = (weight * spread[..., None]).sqrt()[..., None] * deviation
        features = self.joint.layout.indices([ENVIRONMENT])
        covariance = self.coordinates.covariance(self.covariance.from_moments(half.mT @ half, features))
        return BlockGaussian(weight @ self.rows, covariance, self.joint.layout)


def _stacked(scenes: Sequence[AbstractObservation], reference: Tensor) -> tuple[Tensor, Tensor, Tensor]:
    """(design (*batch, M, E), residual (*batch, M), noise (*batch, M, M)) of all observations of the scene together."""
    parts = []
    for scene in scenes:
        rows = scene.dense()
        design, residual, noise = rows.rows({ENVIRONMENT: reference})
        parts.append((design, residual, noise if rows.correlated else torch.diag_embed(noise)))
    if len(parts) == 1:
        return parts[0]
    batch = torch.broadcast_shapes(
        *[shape for d, r, n in parts for shape in (d.shape[:-2], r.shape[:-1], n.shape[:-2])]
    )
    total = sum(residual.shape[-1] for _, residual, _ in parts)
    together, first = reference.new_zeros(*batch, total, total), 0
    for _, _, noise in parts:
        last = first + noise.shape[-1]
        together[..., first:last, first:last] = noise
        first = last
    design = torch.cat([part.expand(*batch, *part.shape[-2:]) for part, _, _ in parts], -2)
    return design, torch.cat([part.expand(*batch, part.shape[-1]) for _, part, _ in parts], -1), together


@dataclass(frozen=True, eq=False)
class KernelJointModel(AbstractJointModel):
    """One Gaussian of the demonstrations, weighted by a kernel over the observed scene (equations in the module).

    Without an observation of the block `environment` alone, or with one that reads none of it, it is the
    `GaussianJointModel` of the same estimator. So it is with bandwidth infinity, and far from all demonstrations.

    Args:
        covariance: estimator that takes moments; its held-out choices are made once, with equal weights.
        bandwidth: h, in standard deviations of the features; None offers 1, 1.5 and 3 as candidates and means 1.5
            where no group can be held out.
        floor: c, what a demonstration of an altogether different scene weighs, from 1e-6 to 1.
        fitted: what `fit` learnt.

    Raises:
        InputError: an estimator that needs the demonstrations themselves, or numbers out of range.

    Example:
        >>> draw = torch.Generator().manual_seed(0)
        >>> scene = torch.linspace(-2.0, 2.0, 40, dtype=torch.float64)[:, None]
        >>> human = scene.abs() + 0.1 * torch.randn(40, 1, generator=draw, dtype=torch.float64)
        >>> model = KernelJointModel(bandwidth=0.2).fit({"human": human, "environment": scene}, target="human")
        >>> from eaip_prob.observation import LinearObservation
        >>> seen = LinearObservation({"environment": torch.eye(1)}, torch.zeros(1), torch.tensor([-2.0]), torch.ones(1))
        >>> bool(model.posterior([seen]).mean("human") > model.prior.block_mean("human"))
        True
    """

    covariance: AbstractCovariance = field(default_factory=ShrinkageCovariance)
    bandwidth: float | None = None
    floor: float = 0.002
    fitted: Neighbourhoods | None = None

    def __post_init__(self) -> None:
        check_type("covariance", self.covariance, AbstractCovariance, "Use covariance=shrinkage or empirical.")
        if not self.covariance.takes_moments:
            raise InputError(
                f"Expected a covariance estimator that takes moments, got {type(self.covariance).__name__}, which "
                "needs the demonstrations themselves. Use covariance=shrinkage or empirical, or model=gaussian."
            )
        if self.bandwidth is not None and not self.bandwidth > 0:
            raise InputError(f"Expected bandwidth above 0 or None, got {self.bandwidth}.")
        if not _LEAST_FLOOR <= self.floor <= 1.0:
            raise InputError(f"Expected floor from {_LEAST_FLOOR} to 1, got {self.floor}.")

    def candidates(self) -> tuple[Self, ...]:
        """The candidates of the estimator, then the bandwidths."""
        estimators = self.covariance.candidates()
        if len(estimators) > 1:
            return tuple(replace(self, covariance=estimator) for estimator in estimators)
        bandwidths = BANDWIDTHS if self.bandwidth is None else (self.bandwidth,)
        return tuple(replace(self, bandwidth=bandwidth) for bandwidth in bandwidths)

    def fit(
        self,
        weights: Mapping[str, Float[Tensor, "demonstrations weights"]],
        observed: Mapping[str, Bool[Tensor, "demonstrations weights"]] | None = None,
        groups: Sequence[int | str] | None = None,
        target: str = "robot",
        grams: Mapping[str, Float[Tensor, "weights weights"]] | None = None,
    ) -> Self:
        """See `AbstractJointModel.fit`.

        Raises:
            ShapeError: blocks with different numbers of rows, or masks, groups or Gram matrices that do not fit them.
            InputError: fewer than two demonstrations, NaN, or an unknown target.
        """
        table = WeightTable.of(weights, observed, groups, target, grams)
        bandwidth = DEFAULT_BANDWIDTH if self.bandwidth is None else self.bandwidth
        return replace(self, fitted=Neighbourhoods.of(table, self.covariance, bandwidth, self.floor))

    @property
    def prior(self) -> BlockGaussian:
        """The Gaussian of equally weighted demonstrations."""
        return self._neighbourhoods.joint

    def posterior(
        self,
        observations: Sequence[AbstractObservation],
        log_weight: Float[Tensor, "*batch components"] | None = None,
        keep: Sequence[str] | None = None,
    ) -> Posterior:
        """See `AbstractJointModel.posterior`; the log evidence is that of the weighted demonstrations."""
        return conditioned(self._neighbourhoods.near(observations), observations, log_weight, keep)

    @property
    def _neighbourhoods(self) -> Neighbourhoods:
        if self.fitted is None:
            raise NotFittedError("Expected a fitted joint model. Call fit(weights) first and use what it returns.")
        return self.fitted

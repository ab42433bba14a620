"""One joint Gaussian over the blocks: interaction primitives (IP) and environment-adaptive ones (EaIP)."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any, Self

import torch
from jaxtyping import Bool, Float
from torch import Tensor

from eaip_prob.checks import as_bool, as_float64, check_finite
from eaip_prob.errors import InputError, NotFittedError, ShapeError
from eaip_prob.gaussian import BlockGaussian, BlockLayout
from eaip_prob.linalg import min_norm_solution, orthonormal_coordinates, psd_root, symmetrised
from eaip_prob.models.base import AbstractJointModel, Posterior, conditioned
from eaip_prob.models.covariance import AbstractCovariance, ShrinkageCovariance
from eaip_prob.models.folds import group_folds
from eaip_prob.models.missing import completed
from eaip_prob.observation import AbstractObservation

ENVIRONMENT = "environment"


@dataclass(frozen=True, eq=False)
class GaussianJointModel(AbstractJointModel):
    """Mean and covariance of all blocks; without an environment block this is IP, with one EaIP.

    The environment has two forms. `block`: features are weights like any others, and their noise is the sensor's alone.
    `regression`: e = w_e^T (theta - mean) + mean(e), w_e by minimum-norm least squares (Eq. 16-20, centred), which is a
    block with cov(theta, e) = Sigma w_e and cov(e) = w_e^T Sigma w_e, observed with noise sigma_e^2 that also holds the
    residual of the regression. They agree with the sample covariance and no more demonstrations than weights.

    Args:
        covariance: estimator; default shrinkage with a held-out amount.
        environment: "block" or "regression".
        joint: the fitted Gaussian; None until fitted.

    Example:
        >>> rows = torch.randn(30, 2, generator=torch.Generator().manual_seed(0), dtype=torch.float64)
        >>> model = GaussianJointModel().fit({"human": rows, "robot": rows.sum(1, keepdim=True)})
        >>> model.prior.layout.names
        ('human', 'robot')
    """

    covariance: AbstractCovariance = field(default_factory=ShrinkageCovariance)
    environment: str = "block"
    joint: BlockGaussian | None = None

    def __post_init__(self) -> None:
        if self.environment not in ("block", "regression"):
            raise InputError(f"Expected environment 'block' or 'regression', got {self.environment!r}.")

    def candidates(self) -> tuple[Self, ...]:
        """One model for each candidate of the covariance estimator."""
        return tuple(replace(self, covariance=covariance) for covariance in self.covariance.candidates())

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
        rows, layout = _table(weights, observed)
        if groups is not None and len(groups) != len(rows):
            raise ShapeError(f"Expected {len(rows)} groups, one per demonstration, got {len(groups)}.")
        folds = group_folds(range(len(rows)) if groups is None else groups)
        columns = layout.indices([target])
        if self.environment == "regression" and ENVIRONMENT in layout.names:
            joint = self._regression(rows, layout, folds, columns, grams or {})
        else:
            features = layout.indices([ENVIRONMENT]) if ENVIRONMENT in layout.names else columns[:0]
            covariance = self._estimate(rows, _coordinates(layout, grams or {}), folds, columns, features)
            joint = BlockGaussian(rows.mean(0), covariance, layout)
        return replace(self, joint=joint)

    def _estimate(
        self,
        rows: Tensor,
        coordinates: tuple[Tensor, Tensor],
        folds: Sequence[Tensor],
        target: Tensor,
        features: Tensor,
    ) -> Float[Tensor, "weights weights"]:
        """Covariance of the rows, regularised in the coordinates."""
        forward, back = coordinates
        half = back @ psd_root(self.covariance.estimate(rows @ forward.mT, folds, target, features))
        return symmetrised(half @ half.mT)  # a product of roots stays positive semi-definite

    def _regression(
        self,
        rows: Tensor,
        layout: BlockLayout,
        folds: Sequence[Tensor],
        columns: Tensor,
        grams: Mapping[str, Tensor],
    ) -> BlockGaussian:
        features = layout.indices([ENVIRONMENT])
        theta = layout.indices([name for name in layout.names if name != ENVIRONMENT])
        where = torch.full((layout.total,), -1)
        where[theta] = torch.arange(len(theta))
        forward, back = (matrix[theta[:, None], theta] for matrix in _coordinates(layout, grams))
        sigma = self._estimate(rows[:, theta], (forward, back), folds, where[columns], features[:0])
        centred = rows - rows.mean(0)
        w_e = min_norm_solution(centred[:, theta], centred[:, features])
        covariance = rows.new_zeros(layout.total, layout.total)
        covariance[theta[:, None], theta] = sigma
        covariance[theta[:, None], features] = sigma @ w_e
        covariance[features[:, None], theta] = (sigma @ w_e).mT
        covariance[features[:, None], features] = symmetrised(w_e.mT @ sigma @ w_e)
        return BlockGaussian(rows.mean(0), covariance, layout)

    @property
    def prior(self) -> BlockGaussian:
        """The fitted Gaussian."""
        if self.joint is None:
            raise NotFittedError("Expected a fitted joint model. Call fit(weights) first and use what it returns.")
        return self.joint

    def posterior(
        self,
        observations: Sequence[AbstractObservation],
        log_weight: Float[Tensor, "*batch components"] | None = None,
        keep: Sequence[str] | None = None,
    ) -> Posterior:
        """See `AbstractJointModel.posterior`."""
        return conditioned(self.prior, observations, log_weight, keep)

    def state(self) -> dict[str, Any]:
        """Mean, covariance and block sizes."""
        joint = self.prior
        return {"mean": joint.mean, "covariance": joint.covariance, "sizes": dict(joint.layout.sizes)}

    def from_state(self, state: Mapping[str, Any]) -> Self:
        """The model fitted as `state` says."""
        missing = {"mean", "covariance", "sizes"} - set(state)
        if missing:
            raise InputError(f"Expected a state with mean, covariance and sizes, {sorted(missing)} missing.")
        return replace(self, joint=BlockGaussian(state["mean"], state["covariance"], BlockLayout(state["sizes"])))


def _coordinates(layout: BlockLayout, grams: Mapping[str, Tensor]) -> tuple[Tensor, Tensor]:
    """(matrix to the coordinates in which all Gram matrices are the identity, its inverse), block by block."""
    for block, gram in grams.items():
        size = layout.sizes.get(block, 0)
        if gram.shape != (size, size):
            raise ShapeError(
                f"Expected grams[{block!r}] with shape {(size, size)} for its {size} weights, got {tuple(gram.shape)}."
            )
    eye = {block: torch.eye(size, dtype=torch.float64) for block, size in layout.sizes.items()}
    pairs = [orthonormal_coordinates(grams[block]) if block in grams else (eye[block], eye[block]) for block in eye]
    return torch.block_diag(*[pair[0] for pair in pairs]), torch.block_diag(*[pair[1] for pair in pairs])


def _table(
    weights: Mapping[str, Tensor], observed: Mapping[str, Tensor] | None
) -> tuple[Float[Tensor, "demonstrations weights"], BlockLayout]:
    """All blocks side by side, entries that were not observed filled with their expectation."""
    if not weights:
        raise InputError("Expected weights of at least one block, got none.")
    blocks = {name: as_float64(f"weights[{name!r}]", rows) for name, rows in weights.items()}
    counts = {name: rows.shape[0] if rows.ndim == 2 else -1 for name, rows in blocks.items()}
    if len(set(counts.values())) > 1 or -1 in counts.values():
        shapes = {name: tuple(rows.shape) for name, rows in blocks.items()}
        raise ShapeError(f"Expected weights (N, K) with one N for all blocks, got {shapes}.")
    if next(iter(counts.values())) < 2:
        raise InputError("Expected at least two demonstrations to learn a covariance, got one. Record more.")
    rows = torch.cat(list(blocks.values()), -1)
    layout = BlockLayout({name: block.shape[-1] for name, block in blocks.items()})
    if observed is None:
        check_finite("weights", rows)
        return rows, layout
    everything = {name: torch.ones_like(block, dtype=torch.bool) for name, block in blocks.items()}
    for name, mask in observed.items():
        if name not in blocks:
            raise InputError(f"Expected observed for blocks among {tuple(blocks)}, got {name!r}.")
        if mask.shape != blocks[name].shape:
            raise ShapeError(
                f"Expected observed[{name!r}] with shape {tuple(blocks[name].shape)}, got {tuple(mask.shape)}."
            )
        everything[name] = as_bool(f"observed[{name!r}]", mask)
    mask = torch.cat([everything[name] for name in layout.names], -1)
    check_finite("weights", rows, where=mask)
    return completed(rows, mask), layout

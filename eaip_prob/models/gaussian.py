"""One joint Gaussian over the blocks: interaction primitives (IP) and environment-adaptive ones (EaIP)."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import ClassVar, Self

import torch
from jaxtyping import Bool, Float
from torch import Tensor

from eaip_prob.errors import InputError, NotFittedError
from eaip_prob.gaussian import BlockGaussian
from eaip_prob.linalg import min_norm_solution, symmetrised
from eaip_prob.models.base import AbstractJointModel, Posterior, conditioned
from eaip_prob.models.covariance import AbstractCovariance, ShrinkageCovariance
from eaip_prob.models.rows import ENVIRONMENT, WeightTable
from eaip_prob.observation import AbstractObservation


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

    conditions_prior: ClassVar[bool] = True
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
        table = WeightTable.of(weights, observed, groups, target, grams)
        if self.environment == "regression" and len(table.features):
            return replace(self, joint=self._regression(table))
        inner = table.rows @ table.coordinates.forward.mT
        inner = self.covariance.estimate(inner, table.folds, table.target, table.features)
        return replace(self, joint=BlockGaussian(table.rows.mean(0), table.coordinates.covariance(inner), table.layout))

    def _regression(self, table: WeightTable) -> BlockGaussian:
        rows, layout, features = table.rows, table.layout, table.features
        theta = layout.indices([name for name in layout.names if name != ENVIRONMENT])
        where = torch.full((layout.total,), -1)
        where[theta] = torch.arange(len(theta))
        coordinates = table.coordinates.of_some(theta)
        inner = rows[:, theta] @ coordinates.forward.mT
        inner = self.covariance.estimate(inner, table.folds, where[table.target], features[:0])
        sigma = coordinates.covariance(inner)
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

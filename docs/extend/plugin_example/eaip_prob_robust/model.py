"""One Gaussian of all demonstrations, in which bad ones (a wrong reach, a lost hand) weigh little.

The weights are those of EM for a multivariate Student-t distribution with nu degrees of freedom and d dimensions,
u_n = (nu + d) / (nu + m_n^2). With tail = nu / d and s_n = m_n^2 / d, up to a factor that is the same for all::

    w_n ~ 1 / (1 + s_n / tail),    sum_n w_n = 1,    mean = sum_n w_n x_n,    S = sum_n w_n (x_n - mean)(x_n - mean)^T

s_n is measured weight by weight, in standard deviations around what the scene explains: an unusual scene is no bad
demonstration, and with fewer demonstrations than weights a full Mahalanobis distance is the same for all of them.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import ClassVar, Self

import torch
from jaxtyping import Bool, Float
from torch import Tensor

from eaip_prob.errors import InputError, NotFittedError
from eaip_prob.gaussian import BlockGaussian
from eaip_prob.linalg import psd_pseudo_solve
from eaip_prob.models import (
    AbstractCovariance,
    AbstractJointModel,
    Posterior,
    ShrinkageCovariance,
    WeightTable,
    conditioned,
)
from eaip_prob.observation import AbstractObservation

_NUM_ROUNDS = 20
_CONSTANT = 1e-20  # variance over mean square of a weight that does not vary


@dataclass(frozen=True, eq=False)
class RobustJointModel(AbstractJointModel):
    """A Gaussian of demonstrations that weigh the less, the more unusual their motions are for their scenes.

    Args:
        covariance: estimator that takes moments.
        tail: above 0; at 1, what is three standard deviations away weighs a fifth of what is one away; infinity weighs
            all alike, as `GaussianJointModel` does.
        share: (N,), what each demonstration weighs, together 1; None until fitted.
        joint: the fitted Gaussian; None until fitted.
    """

    conditions_prior: ClassVar[bool] = True
    covariance: AbstractCovariance = field(default_factory=ShrinkageCovariance)
    tail: float = 1.0
    share: Float[Tensor, "demonstrations"] | None = None
    joint: BlockGaussian | None = None

    def __post_init__(self) -> None:
        if not self.tail > 0:
            raise InputError(f"Expected tail above 0, got {self.tail}.")

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
        """See `AbstractJointModel.fit`."""
        table = WeightTable.of(weights, observed, groups, target, grams)
        rows = table.rows @ table.coordinates.forward.mT
        estimator = self.covariance.chosen(rows, table.folds, table.target, table.features)
        share = torch.full_like(rows[:, 0], 1.0 / len(rows))
        for _ in range(_NUM_ROUNDS):
            share = 1.0 / (1.0 + _strangeness(rows, share, table.features) / self.tail)
            share = share / share.sum()
        centred = rows - share @ rows
        inner = estimator.from_moments((share[:, None] * centred).mT @ centred, table.features)
        joint = BlockGaussian(share @ table.rows, table.coordinates.covariance(inner), table.layout)
        return replace(self, share=share, joint=joint)

    def posterior(
        self,
        observations: Sequence[AbstractObservation],
        log_weight: Float[Tensor, "*batch components"] | None = None,
        keep: Sequence[str] | None = None,
    ) -> Posterior:
        """See `AbstractJointModel.posterior`."""
        if self.joint is None:
            raise NotFittedError("Expected a fitted joint model. Call fit(weights) first and use what it returns.")
        return conditioned(self.joint, observations, log_weight, keep)


def _strangeness(rows: Tensor, share: Tensor, features: Tensor) -> Tensor:
    """s_n (N,): mean square, in standard deviations, of what the features do not explain of each row; 1 on average."""
    centred = rows - share @ rows
    moments = (share[:, None] * centred).mT @ centred
    explained = centred[:, features] @ psd_pseudo_solve(moments[features[:, None], features], moments[features])
    squares = (centred - explained).square()
    varies = share @ squares > _CONSTANT * (share @ rows.square())
    varies[features] = False
    return (squares / (share @ squares))[:, varies].sum(-1) / max(1, int(varies.sum()))

"""Covariance estimators. With 10 to 40 demonstrations and 200 weights the estimator is the model.

Every estimator is unit-equivariant: rescaling one weight rescales its row and column and nothing else.
"""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass
from typing import ClassVar

import torch
from jaxtyping import Float
from torch import Tensor

from eaip_prob.checks import check_fraction
from eaip_prob.errors import InputError
from eaip_prob.linalg import log_det, psd_pseudo_solve, safe_cholesky, symmetrised, triangular_solve

_AMOUNTS = (1e-4, 3e-4, 1e-3, 3e-3, 0.01, 0.03, 0.06, 0.1, 0.2, 0.3, 0.5, 0.7, 0.9)
_CANDIDATES = (0.001, 0.01, 0.1, 0.3, 0.6)
DEFAULT_AMOUNT = 0.1


@dataclass(frozen=True)
class AbstractCovariance(ABC):
    """Estimates the covariance of weights; a subclass gives `estimate`.

    An estimator that needs no more of the demonstrations than their covariance says so by `takes_moments` and gives
    `from_moments`; in return it serves models that weight the demonstrations anew for every scene.
    """

    takes_moments: ClassVar[bool] = False

    def candidates(self) -> tuple[AbstractCovariance, ...]:
        """Estimators to choose from by what they predict on held-out groups; itself where nothing is open."""
        return (self,)

    def chosen(
        self,
        weights: Float[Tensor, "demonstrations weights"],
        folds: Sequence[Tensor],
        target: Tensor,
        features: Tensor,
    ) -> AbstractCovariance:
        """The estimator with its held-out choices made on these demonstrations; arguments as in `estimate`."""
        return self

    def from_moments(
        self, covariance: Float[Tensor, "*batch weights weights"], features: Tensor
    ) -> Float[Tensor, "*batch weights weights"]:
        """The estimate from covariances of weighted demonstrations, without held-out choices.

        Args:
            covariance: (*batch, Z, Z), of the weighted demonstrations around their weighted mean.
            features: positions of the environment's features among the weights.

        Raises:
            InputError: an estimator that needs the demonstrations themselves.
        """
        raise InputError(
            f"Expected a covariance estimator that takes moments, got {type(self).__name__}, which needs the "
            "demonstrations themselves. Use covariance=shrinkage or empirical."
        )

    @abstractmethod
    def estimate(
        self,
        weights: Float[Tensor, "demonstrations weights"],
        folds: Sequence[Tensor],
        target: Tensor,
        features: Tensor,
    ) -> Float[Tensor, "weights weights"]:
        """Covariance of the weights around their mean.

        Args:
            weights: (N, Z), one row a demonstration.
            folds: index tensors of the demonstrations held out together; empty where no held-out choice is possible.
            target: positions of the weights to be predicted from all others, for held-out choices.
            features: positions of the environment's features among the weights, empty where there are none.
        """


@dataclass(frozen=True)
class EmpiricalCovariance(AbstractCovariance):
    """The sample covariance divided by N (Eq. 9).

    Example:
        >>> rows = torch.tensor([[1.0, 0.0], [3.0, 4.0]], dtype=torch.float64)
        >>> EmpiricalCovariance().estimate(rows, (), torch.tensor([0]), torch.tensor([], dtype=torch.long)).tolist()
        [[1.0, 2.0], [2.0, 4.0]]
    """

    takes_moments: ClassVar[bool] = True

    def from_moments(
        self, covariance: Float[Tensor, "*batch weights weights"], features: Tensor
    ) -> Float[Tensor, "*batch weights weights"]:
        """The covariance as it is."""
        return covariance

    def estimate(
        self,
        weights: Float[Tensor, "demonstrations weights"],
        folds: Sequence[Tensor],
        target: Tensor,
        features: Tensor,
    ) -> Float[Tensor, "weights weights"]:
        """See `AbstractCovariance.estimate`; nothing is chosen."""
        return sample_covariance(weights)


@dataclass(frozen=True)
class ShrinkageCovariance(AbstractCovariance):
    """Shrinks towards the diagonal what the environment does not explain; unit-equivariant.

        S_ww = C + B S_ee B^T,   C -> (1 - amount) C + amount diag(C)

    with w the movement weights, e the features, B = S_we S_ee^-1. The few features are regressed on directly: shrinking
    their cross-covariances with hundreds of weights as well would bias every prediction from the environment towards
    the mean.

    Args:
        amount: between 0 and 1; None chooses it by the held-out likelihood of the target given all other weights, or
            takes 0.1 where no group can be left out. An `InteractionPredictor` chooses among `candidates` instead, by
            the held-out density of the target's future given the beginning of a motion.

    Example:
        >>> rows = torch.tensor([[1.0, 0.0], [3.0, 4.0]], dtype=torch.float64)
        >>> no_features = torch.tensor([], dtype=torch.long)
        >>> ShrinkageCovariance(0.5).estimate(rows, (), torch.tensor([0]), no_features).tolist()
        [[1.0, 1.0], [1.0, 4.0]]
    """

    takes_moments: ClassVar[bool] = True
    amount: float | None = None

    def __post_init__(self) -> None:
        if self.amount is not None:
            check_fraction("amount", self.amount)

    def candidates(self) -> tuple[AbstractCovariance, ...]:
        """Five amounts, unless one was given."""
        return (self,) if self.amount is not None else tuple(ShrinkageCovariance(amount) for amount in _CANDIDATES)

    def estimate(
        self,
        weights: Float[Tensor, "demonstrations weights"],
        folds: Sequence[Tensor],
        target: Tensor,
        features: Tensor,
    ) -> Float[Tensor, "weights weights"]:
        """See `AbstractCovariance.estimate`."""
        return self.chosen(weights, folds, target, features).from_moments(sample_covariance(weights), features)

    def chosen(
        self,
        weights: Float[Tensor, "demonstrations weights"],
        folds: Sequence[Tensor],
        target: Tensor,
        features: Tensor,
    ) -> ShrinkageCovariance:
        """With the amount of the highest held-out likelihood, unless one was given."""
        if self.amount is not None:
            return self
        return ShrinkageCovariance(self.chosen_amount(weights, folds, target, features) if folds else DEFAULT_AMOUNT)

    def from_moments(
        self, covariance: Float[Tensor, "*batch weights weights"], features: Tensor
    ) -> Float[Tensor, "*batch weights weights"]:
        """The covariances shrunk by the amount, or by 0.1 where it is open."""
        amount = DEFAULT_AMOUNT if self.amount is None else self.amount
        return shrunk(covariance, features, torch.tensor(amount, dtype=torch.float64))

    @staticmethod
    def chosen_amount(weights: Tensor, folds: Sequence[Tensor], target: Tensor, features: Tensor) -> float:
        """The amount with the highest held-out log likelihood of the target given all other weights.

        Weights that do not vary carry no likelihood and are left out of it.
        """
        order, num_given, num_features = _likelihood_order(weights, target, features)
        if num_given == len(order):
            return DEFAULT_AMOUNT
        scaled = weights[:, order] / weights[:, order].std(0)
        amounts = torch.tensor(_AMOUNTS, dtype=torch.float64)
        total = torch.zeros_like(amounts)
        for fold in folds:
            train = torch.ones(len(weights), dtype=torch.bool)
            train[fold] = False
            covariance = shrunk(sample_covariance(scaled[train]), torch.arange(num_features), amounts)
            total += _conditional_log_likelihood(covariance, scaled[fold] - scaled[train].mean(0), num_given)
        return float(amounts[total.argmax()])


def _likelihood_order(weights: Tensor, target: Tensor, features: Tensor) -> tuple[Tensor, int, int]:
    """(columns that vary as features, other given weights, target; number given; number of features)."""
    role = torch.ones(weights.shape[-1], dtype=torch.long)
    role[features] = 0
    role[target] = 2
    varying = (weights.var(0) > 1e-20 * weights.square().mean(0)).nonzero()[:, 0]
    order = varying[role[varying].argsort(stable=True)]
    return order, int((role[order] < 2).sum()), int((role[order] == 0).sum())


def sample_covariance(weights: Float[Tensor, "demonstrations weights"]) -> Float[Tensor, "weights weights"]:
    """Sum of squared deviations divided by N (Eq. 9)."""
    centred = weights - weights.mean(0)
    return centred.mT @ centred / len(weights)


def shrunk(
    covariance: Float[Tensor, "*#batch weights weights"], features: Tensor, amount: Float[Tensor, "*#batch"]
) -> Float[Tensor, "*batch weights weights"]:
    """The covariance with what the features do not explain shrunk towards its diagonal."""
    share = amount[..., None, None]
    explained = explained_by(covariance, features)
    rest = symmetrised(covariance - explained)
    return explained + (1.0 - share) * rest + share * torch.diag_embed(rest.diagonal(dim1=-2, dim2=-1).clamp_min(0.0))


def explained_by(
    covariance: Float[Tensor, "*batch weights weights"], features: Tensor
) -> Float[Tensor, "*batch weights weights"]:
    """S_we S_ee^-1 S_ew, the covariance that a regression on the features explains."""
    if not len(features):
        return torch.zeros_like(covariance)
    cross = covariance[..., :, features]
    flat = cross.reshape(-1, *cross.shape[-2:])
    # A feature that repeats another, or is constant, leaves a singular S_ee: its minimum-norm share is taken.
    if len(flat) == 1:
        return cross @ psd_pseudo_solve(flat[0, features], flat[0].mT)
    return cross @ torch.vmap(psd_pseudo_solve)(flat[:, features], flat.mT).reshape(cross.mT.shape)


def _conditional_log_likelihood(covariance: Tensor, deviation: Tensor, num_given: int) -> Tensor:
    """Sum over rows of log N(target | given), for each covariance of a batch; given weights stand first.

    With the Cholesky factor of [given, target], the conditional density is read off the trailing rows.
    """
    # A weight that is constant in this fold alone has no density: 1e-6 of its variance over all folds stands in.
    floor = torch.diag_embed((covariance.diagonal(dim1=-2, dim2=-1) < 1e-6) * 1e-6)
    factor = safe_cholesky(covariance + floor)
    white = triangular_solve(factor, deviation.mT.expand(len(covariance), -1, -1))[:, num_given:]
    tail = factor[:, num_given:, num_given:]
    constant = log_det(tail) + tail.shape[-1] * math.log(2.0 * math.pi)
    return -0.5 * (white.square().sum((-2, -1)) + len(deviation) * constant)

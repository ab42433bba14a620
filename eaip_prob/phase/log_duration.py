"""Log durations expected from the environment: a ridge regression, and how far it holds for groups left out.

log T and the mapped features phi(e) are jointly Gaussian, so that features which were not observed are marginalised and
the error of the sensor is added: E[log T | phi_o] = mean + c_o^T (C_oo + ridge diag C_oo + R_oo)^-1 (phi_o - mean_o).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Self

import torch
from jaxtyping import Bool, Float, Int
from torch import Tensor

from eaip_prob.data.environment import EnvironmentFeatures
from eaip_prob.data.feature_map import AbstractFeatureMap
from eaip_prob.folds import group_folds
from eaip_prob.linalg import psd_solve
from eaip_prob.slope import Slope

_CONSTANT = 1e-9  # standard deviation, relative to the mean, below which a feature does not vary
_NUM_ROUNDS = 50  # of expectation and maximisation, where features are missing


@dataclass(frozen=True, eq=False)
class LogDurationRegression:
    """Log T expected from an environment, within a factor of two of the demonstrated durations.

    Args:
        feature_map: fitted.
        offset: mean of log T (s).
        bounds: least and greatest log T that is expected.
        mean: (P,), of the mapped features.
        scale: (P,), one over their standard deviation; 0 for those that do not vary, which say nothing.
        covariance: (P, P), of the scaled features, ridge included.
        cross: (P,), covariance of the scaled features with log T.
        coefficient: (P,), log T per unscaled feature where all are observed exactly.
    """

    feature_map: AbstractFeatureMap
    offset: float
    bounds: tuple[float, float]
    mean: Float[Tensor, "mapped"]
    scale: Float[Tensor, "mapped"]
    covariance: Float[Tensor, "mapped mapped"]
    cross: Float[Tensor, "mapped"]
    coefficient: Float[Tensor, "mapped"]

    @classmethod
    def fit(
        cls,
        feature_map: AbstractFeatureMap,
        environment: EnvironmentFeatures,
        log_duration: Float[Tensor, "demonstrations"],
        ridge: float,
    ) -> Self:
        """The regression of log durations on mapped features.

        Args:
            feature_map: not yet fitted.
            environment: (N, E), each with a feature observed.
            log_duration: (N,), log seconds.
            ridge: relative to each feature's variance.
        """
        feature_map = feature_map.fit(environment)
        value, _, observed = feature_map.moments(feature_map.ordered(environment))
        count = observed.sum(0).clamp_min(1)
        mean = torch.where(observed, value, 0.0).sum(0) / count
        centred = torch.where(observed, value - mean, 0.0)
        deviation = (centred.square().sum(0) / count).sqrt()
        varies = deviation > _CONSTANT * mean.abs()
        scale = torch.where(varies, 1.0 / torch.where(varies, deviation, 1.0), 0.0)
        rows = torch.cat([centred * scale, (log_duration - log_duration.mean())[:, None]], -1)
        seen = torch.cat([observed | ~varies, torch.ones_like(observed[:, :1])], -1)
        shift, joint = _joint_moments(rows, seen, ridge)
        mean = mean + torch.where(varies, shift[:-1] * deviation, 0.0)
        covariance = _ridged(joint[:-1, :-1], ridge)
        cross = joint[:-1, -1]
        coefficient = psd_solve(covariance, cross[:, None])[:, 0] * scale
        bounds = (float(log_duration.amin()) - math.log(2.0), float(log_duration.amax()) + math.log(2.0))
        return cls(feature_map, float(log_duration.mean()), bounds, mean, scale, covariance, cross, coefficient)

    def expectation(self, environment: EnvironmentFeatures) -> Float[Tensor, "*batch"]:
        """E[log T | e] of any batch of environments; the mean where nothing was observed."""
        value, error, observed = self.feature_map.moments(self.feature_map.ordered(environment))
        centred = value - self.mean
        if error is None and bool(observed.all()):
            deviation = centred @ self.coefficient
        else:
            deviation = self._conditional(centred * self.scale, error, observed)
        return (self.offset + deviation).clamp(*self.bounds)

    def _conditional(self, scaled: Tensor, error: Tensor | None, observed: Tensor) -> Float[Tensor, "*batch"]:
        matrix = self.covariance if error is None else self.covariance + self.scale[:, None] * error * self.scale
        both = observed[..., :, None] & observed[..., None, :]
        # Rows of the identity in the place of unobserved ones: the factor is that of the observed block alone.
        matrix = torch.where(both, matrix, torch.eye(len(self.scale), dtype=torch.float64))
        cross = torch.where(observed, self.cross, 0.0)
        gain = psd_solve(matrix, cross[..., None], "covariance of the environment's features")[..., 0]
        return (gain * scaled).sum(-1)


@dataclass(frozen=True, eq=False)
class HeldOut:
    """Deviations of log T from its mean, for demonstrations of groups that were left out.

    Args:
        predicted: (M,), by the regression on the other groups.
        true: (M,), from the other groups' mean.
        group: (M,), number of each demonstration's group.
    """

    predicted: Float[Tensor, "held_out"]
    true: Float[Tensor, "held_out"]
    group: Int[Tensor, "held_out"]

    @classmethod
    def of(
        cls,
        feature_map: AbstractFeatureMap,
        environment: EnvironmentFeatures,
        log_duration: Float[Tensor, "demonstrations"],
        groups: Sequence[int | str],
        ridge: float,
    ) -> Self | None:
        """Deviations over folds of whole groups; None where nothing can be left out."""
        folds = group_folds(groups)
        if not folds:
            return None
        order = {label: number for number, label in enumerate(dict.fromkeys(groups))}
        predicted, true = [], []
        for fold in folds:
            kept = torch.ones(len(groups), dtype=torch.bool)
            kept[fold] = False
            regression = LogDurationRegression.fit(feature_map, environment[kept], log_duration[kept], ridge)
            predicted.append(regression.expectation(environment[fold]) - regression.offset)
            true.append(log_duration[fold] - regression.offset)
        group = torch.tensor([order[label] for label in groups])[torch.cat(folds)]
        return cls(torch.cat(predicted), torch.cat(true), group)

    @property
    def squared_error(self) -> float:
        """Mean squared error of log T."""
        return float((self.true - self.predicted).square().mean())

    def slope(self) -> Slope:
        """Slope of the true on the predicted deviation; 0 where fewer than two groups were left out."""
        labels, member = self.group.unique(return_inverse=True)
        zeros = torch.zeros(len(labels), dtype=torch.float64)
        columns = (self.predicted * self.true, self.predicted.square(), self.true.square())
        product, power, total = [zeros.index_add(0, member, column) for column in columns]
        return Slope.of(product, power, total, towards=0.0)


def _joint_moments(
    rows: Float[Tensor, "demonstrations columns"], seen: Bool[Tensor, "demonstrations columns"], ridge: float
) -> tuple[Float[Tensor, "columns"], Float[Tensor, "columns columns"]]:
    """Maximum-likelihood mean and covariance of centred rows of which some entries are missing (stored as zero)."""
    mean, covariance = rows.mean(0), rows.mT @ rows / len(rows)
    if bool(seen.all()):
        return mean, covariance
    patterns, member = torch.unique(seen, dim=0, return_inverse=True)
    for _ in range(_NUM_ROUNDS):
        filled, hidden_covariance = _expected(rows, patterns, member, mean, _ridged(covariance, ridge))
        previous, mean = covariance, filled.mean(0)
        covariance = (filled - mean).mT @ (filled - mean) / len(rows) + hidden_covariance
        if bool((covariance - previous).abs().max() <= 1e-9 * covariance.abs().max()):
            break
    return mean, covariance


def _expected(
    rows: Tensor, patterns: Tensor, member: Tensor, mean: Tensor, covariance: Tensor
) -> tuple[Float[Tensor, "demonstrations columns"], Float[Tensor, "columns columns"]]:
    """(rows with what is missing at its expectation, mean covariance of what is missing)."""
    filled, left = rows.clone(), torch.zeros_like(covariance)
    for number, pattern in enumerate(patterns):
        known, hidden, at = pattern.nonzero()[:, 0], (~pattern).nonzero()[:, 0], (member == number).nonzero()[:, 0]
        between = covariance[known[:, None], hidden]
        gain = psd_solve(covariance[known[:, None], known], between)
        filled[at[:, None], hidden] = mean[hidden] + (rows[at[:, None], known] - mean[known]) @ gain
        conditional = covariance[hidden[:, None], hidden] - between.mT @ gain
        left[hidden[:, None], hidden] += conditional * (len(at) / len(rows))
    return filled, left


def _ridged(covariance: Float[Tensor, "n n"], ridge: float) -> Float[Tensor, "n n"]:
    """The covariance with a ridge relative to its diagonal; 1 where that is zero, for columns that say nothing."""
    diagonal = covariance.diagonal()
    return covariance + torch.diag(torch.where(diagonal > 0, ridge * diagonal, 1.0))

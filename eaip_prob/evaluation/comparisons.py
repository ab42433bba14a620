"""What a comparison of two methods shows: paired gains over groups, and shares of successes, with intervals.

Motions of one person (object, recording) resemble one another, so the unit that is counted is the group: errors are
averaged within each group and the interval is over groups.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import torch
from jaxtyping import Float
from scipy.special import stdtrit
from torch import Tensor

from eaip_prob.checks import as_float64, check_finite
from eaip_prob.errors import InputError, ShapeError
from eaip_prob.evaluation.groups import group_index, group_means


@dataclass(frozen=True)
class Gain:
    """How much lower a method's error is than a baseline's: mean over groups, with an interval.

    Args:
        mean: positive where the method is better, in the unit of the errors.
        low: lower end of the interval; minus infinity with one group.
        high: upper end; infinity with one group.
        num_groups: groups that were averaged.

    Example:
        >>> Gain(mean=0.2, low=-0.1, high=0.5, num_groups=8).holds_zero
        True
    """

    mean: float
    low: float
    high: float
    num_groups: int

    @property
    def holds_zero(self) -> bool:
        """Whether the data leave open that the method does not help."""
        return self.low <= 0.0 <= self.high


@dataclass(frozen=True)
class Share:
    """A fraction (0..1) of successes with an interval.

    Args:
        share: successes over trials.
        low: lower end of the interval.
        high: upper end.
        num_trials: trials that were counted.

    Example:
        >>> few, many = success_share(3, 4), success_share(300, 400)
        >>> few.share == many.share, few.low < many.low
        (True, True)
    """

    share: float
    low: float
    high: float
    num_trials: int


def paired_gain(
    baseline_error: Float[Tensor, "motions"],
    method_error: Float[Tensor, "motions"],
    groups: Sequence[int | str] | Tensor,
    level: float = 0.95,
) -> Gain:
    """Mean over groups of baseline - method, with a Student-t interval over the G groups.

    mean +- t(G - 1) s / sqrt(G), s the standard deviation of the groups' differences (over G - 1); with many groups
    this is the normal interval. One group says nothing about others: its interval is (-inf, inf).

    Args:
        baseline_error: (N,), error of each motion under the baseline.
        method_error: (N,), under the method, same motions in the same order and unit.
        groups: (N,), the person, object or recording of each motion.
        level: fraction of such intervals that hold the true mean.

    Raises:
        ShapeError: other numbers of errors or groups.
        InputError: errors that are not finite, or a level outside (0, 1).

    Example:
        >>> gain = paired_gain(torch.tensor([3.0, 5.0, 4.0]), torch.tensor([2.0, 2.0, 1.0]), ["a", "a", "b"])
        >>> gain.mean, gain.num_groups, gain.holds_zero
        (2.5, 2, True)
    """
    differences = _group_differences(baseline_error, method_error, groups)
    count, mean = len(differences), float(differences.mean())
    _checked_level(level)
    if count == 1:
        return Gain(mean, -math.inf, math.inf, 1)
    quantile = float(stdtrit(count - 1, 0.5 + 0.5 * level))
    reach = quantile * float(differences.std()) / math.sqrt(count)
    return Gain(mean, mean - reach, mean + reach, count)


def bootstrap_gain(
    baseline_error: Float[Tensor, "motions"],
    method_error: Float[Tensor, "motions"],
    groups: Sequence[int | str] | Tensor,
    generator: torch.Generator,
    level: float = 0.95,
    num_resamples: int = 10_000,
) -> Gain:
    """As `paired_gain`, with the percentile interval of a bootstrap that draws whole groups with replacement.

    It assumes no normal differences, but is too narrow with few groups (by sqrt((G - 1) / G) and the t quantile).

    Args:
        baseline_error: (N,), error of each motion under the baseline.
        method_error: (N,), under the method.
        groups: (N,), the person, object or recording of each motion.
        generator: source of the draws.
        level: nominal fraction.
        num_resamples: number of resamples.

    Raises:
        ShapeError: other numbers of errors or groups.
        InputError: errors that are not finite, or a level outside (0, 1).

    Example:
        >>> error = torch.tensor([3.0, 5.0, 4.0])
        >>> bootstrap_gain(error, error - 1.0, [0, 1, 2], torch.Generator().manual_seed(0), num_resamples=50)
        Gain(mean=1.0, low=1.0, high=1.0, num_groups=3)
    """
    differences = _group_differences(baseline_error, method_error, groups)
    count, mean = len(differences), float(differences.mean())
    tail = 0.5 * (1.0 - _checked_level(level))
    if count == 1:
        return Gain(mean, -math.inf, math.inf, 1)
    draws = torch.randint(count, (num_resamples, count), generator=generator)
    ends = differences[draws].mean(-1).quantile(torch.tensor([tail, 1.0 - tail], dtype=torch.float64))
    return Gain(mean, float(ends[0]), float(ends[1]), count)


def success_share(num_successes: int, num_trials: int, level: float = 0.95) -> Share:
    """Share of successes with its Wilson score interval; trials are taken as independent.

    (p + z^2 / 2n +- z sqrt(p (1 - p) / n + z^2 / 4n^2)) / (1 + z^2 / n).

    Args:
        num_successes: how many of the trials succeeded.
        num_trials: n, at least 1.
        level: nominal fraction of such intervals that hold the true share.

    Raises:
        InputError: no trial, more successes than trials, or a level outside (0, 1).

    Example:
        >>> result = success_share(8, 8)
        >>> result.share, round(result.low, 3), result.high
        (1.0, 0.676, 1.0)
    """
    if not 0 <= num_successes <= num_trials or num_trials < 1:
        raise InputError(f"Expected 0 <= num_successes <= num_trials and a trial, got {num_successes} of {num_trials}.")
    share, z = num_successes / num_trials, _normal_quantile(0.5 + 0.5 * _checked_level(level))
    shrink = 1.0 + z**2 / num_trials
    centre = (share + z**2 / (2 * num_trials)) / shrink
    reach = z * math.sqrt(share * (1.0 - share) / num_trials + z**2 / (4 * num_trials**2)) / shrink
    low = 0.0 if num_successes == 0 else centre - reach
    return Share(share, low, 1.0 if num_successes == num_trials else centre + reach, num_trials)


def _group_differences(baseline: Tensor, method: Tensor, groups: Sequence[int | str] | Tensor) -> Tensor:
    baseline, method = as_float64("baseline_error", baseline), as_float64("method_error", method)
    if baseline.ndim != 1 or baseline.shape != method.shape:
        raise ShapeError(
            f"Expected baseline_error and method_error with one shape (N,), got {tuple(baseline.shape)} and "
            f"{tuple(method.shape)}. Flatten both, in one order."
        )
    check_finite("baseline_error", baseline)
    check_finite("method_error", method)
    return group_means(baseline - method, *group_index(groups, len(baseline)))


def _normal_quantile(probability: float) -> float:
    return float(torch.special.ndtri(torch.tensor(probability, dtype=torch.float64)))


def _checked_level(level: float) -> float:
    if not 0.0 < level < 1.0:
        raise InputError(f"Expected level above 0 and below 1, got {level}. Give 95 % as 0.95.")
    return float(level)

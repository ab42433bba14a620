"""Quantiles and probabilities of predictions: intervals, coverage, and the probability integral transform (PIT).

All are per scalar sample: the marginal of one signal at one time. Components of a mixture stand on axis -3.
"""

from __future__ import annotations

import torch
from jaxtyping import Bool, Float
from torch import Tensor

from eaip_prob.checks import as_float64
from eaip_prob.errors import InputError
from eaip_prob.evaluation.scores import normalised_log_weight
from eaip_prob.evaluation.scoring import scored_mask, scored_mean, scored_values

# 2^-50 of the bracket, which spans the components' own quantiles: below the round-off of the means.
_NUM_BISECTIONS = 50


def coverage(
    lower: Float[Tensor, "*#batch time signals"],
    upper: Float[Tensor, "*#batch time signals"],
    truth: Float[Tensor, "*#batch time signals"],
    mask: Bool[Tensor, "..."],
) -> Float[Tensor, "*batch"]:
    """Fraction (0..1) of the scored samples of each motion that lie in [lower, upper].

    Args:
        lower: (*batch, T, D), in the signals' unit.
        upper: (*batch, T, D), same unit.
        truth: (*batch, T, D), same unit.
        mask: (*batch, T, D) or (*batch, T), True where a sample is scored.

    Raises:
        ShapeError: shapes that do not fit.
        InputError: NaN in a scored sample, a motion without scored samples, or lower above upper.

    Example:
        >>> truth = torch.tensor([[0.0], [5.0]], dtype=torch.float64)
        >>> coverage(torch.full_like(truth, -1.0), torch.full_like(truth, 1.0), truth, truth > -1)
        tensor(0.5000, dtype=torch.float64)
    """
    scored = scored_mask(mask, truth)
    low, high = scored_values("lower", lower, scored), scored_values("upper", upper, scored)
    if bool((low > high).any()):
        raise InputError(
            f"Expected lower <= upper, {int((low > high).sum())} scored samples differ. Swap the arguments."
        )
    value = scored_values("truth", truth, scored)
    return scored_mean(((low <= value) & (value <= high)).to(torch.float64), scored)


def interval(
    mean: Float[Tensor, "*#shape"], variance: Float[Tensor, "*#shape"], level: float
) -> tuple[Float[Tensor, "*shape"], Float[Tensor, "*shape"]]:
    """Central Gaussian interval (lower, upper) that holds the fraction `level`.

    Args:
        mean: any shape, in the signals' unit.
        variance: same shape, unit squared; 0 gives an interval of no width.
        level: between 0 and 1, exclusive.

    Raises:
        InputError: a negative variance, or a level outside (0, 1).

    Example:
        >>> [round(float(end), 3) for end in interval(torch.tensor(1.0), torch.tensor(4.0), 0.9)]
        [-2.29, 4.29]
    """
    tail = 0.5 * (1.0 - _checked_level(level))
    mean, deviation = as_float64("mean", mean), _standard_deviation("variance", variance)
    reach = deviation * torch.special.ndtri(deviation.new_tensor(1.0 - tail))
    return mean - reach, mean + reach


def pit(
    mean: Float[Tensor, "*#shape"], variance: Float[Tensor, "*#shape"], truth: Float[Tensor, "*#shape"]
) -> Float[Tensor, "*shape"]:
    """Predicted probability of a value up to the truth, per sample: uniform on [0, 1] if the prediction is honest.

    Select the scored samples afterwards, `pit(...)[mask]`. Samples of one motion are dependent.

    Args:
        mean: any shape, in the signals' unit.
        variance: same shape, unit squared.
        truth: same shape, in the signals' unit.

    Raises:
        InputError: a negative variance.

    Example:
        >>> pit(torch.tensor(2.0), torch.tensor(9.0), torch.tensor(2.0))
        tensor(0.5000, dtype=torch.float64)
    """
    return _component_cdf(
        as_float64("mean", mean), _standard_deviation("variance", variance), as_float64("truth", truth)
    )


def mixture_pit(
    means: Float[Tensor, "*#batch components time signals"],
    variances: Float[Tensor, "*#batch components time signals"],
    log_weight: Float[Tensor, "*#batch components"],
    truth: Float[Tensor, "*#batch time signals"],
) -> Float[Tensor, "*batch time signals"]:
    """As `pit`, for a mixture: sum_j w_j Phi((y - m_j) / s_j). Equals `pit` for J = 1.

    Args:
        means: (*batch, J, T, D), in the signals' unit.
        variances: (*batch, J, T, D), unit squared.
        log_weight: (*batch, J), up to a constant.
        truth: (*batch, T, D), in the signals' unit.

    Raises:
        InputError: a negative variance, or weights of which none is finite.

    Example:
        >>> means = torch.tensor([[[-3.0]], [[3.0]]])
        >>> mixture_pit(means, torch.ones_like(means), torch.zeros(2), torch.zeros(1, 1))
        tensor([[0.5000]], dtype=torch.float64)
    """
    weight = normalised_log_weight(log_weight).exp()[..., None, None]
    deviation = _standard_deviation("variances", variances)
    return _mixture_cdf(as_float64("means", means), deviation, weight, as_float64("truth", truth))


def mixture_quantile(
    means: Float[Tensor, "*#batch components time signals"],
    variances: Float[Tensor, "*#batch components time signals"],
    log_weight: Float[Tensor, "*#batch components"],
    level: float,
) -> Float[Tensor, "*batch time signals"]:
    """Quantile of each sample's mixture, by bisection between the components' own quantiles; exact for J = 1.

    The mixture's quantile lies between the smallest and the largest of its components' quantiles.

    Args:
        means: (*batch, J, T, D), in the signals' unit.
        variances: (*batch, J, T, D), unit squared.
        log_weight: (*batch, J), up to a constant.
        level: between 0 and 1, exclusive.

    Raises:
        InputError: a negative variance, weights of which none is finite, or a level outside (0, 1).

    Example:
        >>> means = torch.tensor([[[1.0]], [[5.0]]])
        >>> mixture_quantile(means, torch.ones_like(means), torch.zeros(2), 0.5)
        tensor([[3.0000]], dtype=torch.float64)
    """
    weight = normalised_log_weight(log_weight).exp()[..., None, None]
    means, deviation = as_float64("means", means), _standard_deviation("variances", variances)
    own = means + deviation * torch.special.ndtri(means.new_tensor(_checked_level(level)))
    # A component of no weight must not widen the bracket.
    low = torch.where(weight > 0, own, torch.inf).amin(-3)
    high = torch.where(weight > 0, own, -torch.inf).amax(-3)
    if torch.equal(low, high):
        return low
    for _ in range(_NUM_BISECTIONS):
        middle = 0.5 * (low + high)
        below = _mixture_cdf(means, deviation, weight, middle) < level
        low, high = torch.where(below, middle, low), torch.where(below, high, middle)
    return 0.5 * (low + high)


def mixture_interval(
    means: Float[Tensor, "*#batch components time signals"],
    variances: Float[Tensor, "*#batch components time signals"],
    log_weight: Float[Tensor, "*#batch components"],
    level: float,
) -> tuple[Float[Tensor, "*batch time signals"], Float[Tensor, "*batch time signals"]]:
    """Central interval (lower, upper) of each sample's mixture that holds the fraction `level`; see `mixture_quantile`.

    Args:
        means: (*batch, J, T, D), in the signals' unit.
        variances: (*batch, J, T, D), unit squared.
        log_weight: (*batch, J), up to a constant.
        level: between 0 and 1, exclusive.

    Raises:
        InputError: a negative variance, weights of which none is finite, or a level outside (0, 1).

    Example:
        >>> means = torch.tensor([[[1.0]], [[5.0]]])
        >>> low, high = mixture_interval(means, torch.ones_like(means), torch.zeros(2), 0.9)
        >>> bool(torch.isclose(low + high, torch.tensor(6.0, dtype=torch.float64)))
        True
    """
    tail = 0.5 * (1.0 - _checked_level(level))
    return (
        mixture_quantile(means, variances, log_weight, tail),
        mixture_quantile(means, variances, log_weight, 1.0 - tail),
    )


def _mixture_cdf(means: Tensor, deviation: Tensor, weight: Tensor, value: Tensor) -> Tensor:
    # w_j = 0 times the probability of a component without meaning (NaN) would be NaN.
    each = torch.where(weight > 0, weight * _component_cdf(means, deviation, value[..., None, :, :]), 0.0)
    return each.sum(-3)


def _component_cdf(mean: Tensor, deviation: Tensor, value: Tensor) -> Tensor:
    # Without spread the probability is a step; (value - mean) / 0 would be NaN at the step itself.
    certain = deviation == 0
    smooth = torch.special.ndtr((value - mean) / torch.where(certain, 1.0, deviation))
    return torch.where(certain, (value >= mean).to(smooth.dtype), smooth)


def _standard_deviation(name: str, variance: Tensor) -> Tensor:
    values = as_float64(name, variance)
    if bool((values < 0).any()):
        raise InputError(
            f"Expected {name} of zero or more, got {float(values[values < 0][0]):.3g}. Check the covariance."
        )
    return values.sqrt()


def _checked_level(level: float) -> float:
    if not 0.0 < level < 1.0:
        raise InputError(f"Expected level above 0 and below 1, got {level}. Give 90 % as 0.9.")
    return float(level)

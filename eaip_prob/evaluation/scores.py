"""Errors and densities of predictions at the motions that really followed.

Units follow the signals: errors in the signal's unit (squared for `squared_error`), densities in nats per scalar
sample, so that `nll` shifts by log(scale) when a signal is given in another unit.
"""

from __future__ import annotations

import math

import torch
from jaxtyping import Bool, Float
from torch import Tensor

from eaip_prob.checks import as_bool, as_float64, check_finite, check_shape
from eaip_prob.data.trajectory import Trajectory
from eaip_prob.errors import InputError, ShapeError
from eaip_prob.evaluation.scoring import scored_mask, scored_mean, scored_values, scored_variance
from eaip_prob.linalg import safe_cholesky, triangular_solve


def squared_error(
    mean: Float[Tensor, "*#batch time signals"],
    truth: Float[Tensor, "*#batch time signals"],
    mask: Bool[Tensor, "..."],
) -> Float[Tensor, "*batch"]:
    """Mean of (mean - truth)^2 over the scored samples and signals of each motion, units of the signals squared.

    Args:
        mean: (*batch, T, D), the prediction, in the signals' unit.
        truth: (*batch, T, D), what really followed.
        mask: (*batch, T, D) or (*batch, T), True where a sample is scored.

    Returns:
        (*batch,), one number per motion.

    Raises:
        ShapeError: shapes that do not fit.
        InputError: NaN in a scored sample, or a motion without scored samples.

    Example:
        >>> truth = torch.tensor([[0.0], [3.0]], dtype=torch.float64)
        >>> squared_error(torch.zeros_like(truth), truth, torch.tensor([False, True]))
        tensor(9., dtype=torch.float64)
    """
    scored = scored_mask(mask, truth)
    return scored_mean((scored_values("mean", mean, scored) - scored_values("truth", truth, scored)).square(), scored)


def motion_rmse(
    mean: Float[Tensor, "*#batch time signals"],
    truth: Float[Tensor, "*#batch time signals"],
    mask: Bool[Tensor, "..."],
) -> Float[Tensor, "*batch"]:
    """Root of `squared_error`, per motion, in the signals' unit.

    Args:
        mean: (*batch, T, D), the prediction, in the signals' unit.
        truth: (*batch, T, D), what really followed.
        mask: (*batch, T, D) or (*batch, T), True where a sample is scored.

    Raises:
        ShapeError: shapes that do not fit.
        InputError: NaN in a scored sample, or a motion without scored samples.

    Example:
        >>> truth = torch.tensor([[[3.0]], [[4.0]]], dtype=torch.float64)
        >>> motion_rmse(torch.zeros_like(truth), truth, truth > 0)
        tensor([3., 4.], dtype=torch.float64)
    """
    return squared_error(mean, truth, mask).sqrt()


def rmse(
    mean: Float[Tensor, "*#batch time signals"],
    truth: Float[Tensor, "*#batch time signals"],
    mask: Bool[Tensor, "..."],
) -> Float[Tensor, ""]:
    """Pooled error: root of the mean over motions of `squared_error`, in the signals' unit.

    Every motion counts the same, however many of its samples are scored.

    Args:
        mean: (*batch, T, D), the prediction, in the signals' unit.
        truth: (*batch, T, D), what really followed.
        mask: (*batch, T, D) or (*batch, T), True where a sample is scored.

    Raises:
        ShapeError: shapes that do not fit.
        InputError: NaN in a scored sample, or a motion without scored samples.

    Example:
        >>> truth = torch.tensor([[[1.0]], [[7.0]]], dtype=torch.float64)
        >>> rmse(torch.zeros_like(truth), truth, truth > 0)
        tensor(5., dtype=torch.float64)
    """
    return squared_error(mean, truth, mask).mean().sqrt()


def nll(
    mean: Float[Tensor, "*#batch time signals"],
    variance: Float[Tensor, "*#batch time signals"],
    truth: Float[Tensor, "*#batch time signals"],
    mask: Bool[Tensor, "..."],
) -> Float[Tensor, "*batch"]:
    """Mean per-sample marginal Gaussian negative log density of each motion, nats per scalar sample.

    -log N(y | m, v) = ((y - m)^2 / v + log(2 pi v)) / 2, averaged over the scored samples and signals.

    Args:
        mean: (*batch, T, D), in the signals' unit.
        variance: (*batch, T, D), predictive variance plus representation residual, units of the signals squared.
        truth: (*batch, T, D), what really followed.
        mask: (*batch, T, D) or (*batch, T), True where a sample is scored.

    Raises:
        ShapeError: shapes that do not fit.
        InputError: as `squared_error`, or a variance that is not above zero in a scored sample.

    Example:
        >>> truth = torch.zeros(1, 1, dtype=torch.float64)
        >>> round(float(nll(truth, torch.ones_like(truth), truth, truth == 0)), 6)
        0.918939
    """
    scored = scored_mask(mask, truth)
    deviation = scored_values("truth", truth, scored) - scored_values("mean", mean, scored)
    return scored_mean(-_log_density(deviation, scored_variance("variance", variance, scored)), scored)


def gaussian_mixture_nll(
    means: Float[Tensor, "*#batch components time signals"],
    variances: Float[Tensor, "*#batch components time signals"],
    log_weight: Float[Tensor, "*#batch components"],
    truth: Float[Tensor, "*#batch time signals"],
    mask: Bool[Tensor, "..."],
) -> Float[Tensor, "*batch"]:
    """As `nll`, for a mixture: -log sum_j w_j N(y | m_j, v_j) per scalar sample, averaged over the scored ones.

    Args:
        means: (*batch, J, T, D), in the signals' unit.
        variances: (*batch, J, T, D), unit squared, with the representation residual.
        log_weight: (*batch, J), up to a constant; minus infinity leaves a component out.
        truth: (*batch, T, D), what really followed.
        mask: (*batch, T, D) or (*batch, T), True where a sample is scored.

    Raises:
        ShapeError: shapes that do not fit.
        InputError: as `nll`, or weights of which none is finite.

    Example:
        >>> truth = torch.zeros(1, 1, dtype=torch.float64)
        >>> means = torch.tensor([[[-1.0]], [[1.0]]], dtype=torch.float64)
        >>> weight = torch.zeros(2, dtype=torch.float64)
        >>> round(float(gaussian_mixture_nll(means, torch.ones_like(means), weight, truth, truth == 0)), 6)
        1.418939
    """
    scored = scored_mask(mask, truth)
    each = scored[..., None, :, :]
    deviation = scored_values("truth", truth, scored)[..., None, :, :] - scored_values("means", means, each)
    density = _log_density(deviation, scored_variance("variances", variances, each))
    return scored_mean(-torch.logsumexp(density + normalised_log_weight(log_weight)[..., None, None], -3), scored)


def normalised_log_weight(log_weight: Float[Tensor, "*batch components"]) -> Float[Tensor, "*batch components"]:
    """The log weights of a mixture, shifted so that the weights sum to one.

    Raises:
        InputError: NaN or plus infinity among them, or all of them minus infinity.
    """
    weight = as_float64("log_weight", log_weight)
    if bool(torch.isnan(weight).any() | (weight == math.inf).any()) or not bool(torch.isfinite(weight).any(-1).all()):
        raise InputError(
            "Expected log_weight without NaN and with a finite entry for every motion. Check the evidence."
        )
    return weight - torch.logsumexp(weight, -1, keepdim=True)


def mahalanobis(
    mean: Float[Tensor, "*#batch entries"],
    covariance: Float[Tensor, "*#batch entries entries"],
    truth: Float[Tensor, "*#batch entries"],
    mask: Bool[Tensor, "*#batch entries"] | None = None,
) -> Float[Tensor, "*batch"]:
    """Squared Mahalanobis distance of the truth over the number n of scored entries: 1 is expected, above is confident.

    d^2 / n = (y - m)^T C^-1 (y - m) / n, with variance 2 / n if the truth is a draw from N(m, C).

    Args:
        mean: (*batch, entries), e.g. a flattened motion or weights, in their own unit.
        covariance: (*batch, entries, entries), unit squared, full rank: a motion needs its representation residual.
        truth: (*batch, entries), same unit.
        mask: (*batch, entries), entries that are scored (the others are marginalised); default all.

    Raises:
        ShapeError: shapes that do not fit.
        InputError: NaN in a scored entry, or no scored entry.
        NotPositiveDefiniteError: the covariance of the scored entries has no Cholesky factor.

    Example:
        >>> zeros = torch.zeros(2, dtype=torch.float64)
        >>> mahalanobis(zeros, 4.0 * torch.eye(2, dtype=torch.float64), zeros + 4.0)
        tensor(4., dtype=torch.float64)
    """
    entries = torch.ones_like(truth, dtype=torch.bool) if mask is None else as_bool("mask", mask)
    check_shape("mask", entries, [truth.shape[-1]])
    scored = scored_mask(entries[..., None], truth[..., None])
    column = scored_values("truth", truth[..., None], scored) - scored_values("mean", mean[..., None], scored)
    matrix = as_float64("covariance", covariance)
    check_shape("covariance", matrix, [truth.shape[-1]] * 2)
    factor = safe_cholesky(_marginal(matrix, scored[..., 0]))
    batch = torch.broadcast_shapes(factor.shape[:-2], column.shape[:-2])
    white = triangular_solve(factor.expand(*batch, *factor.shape[-2:]), column.expand(*batch, *column.shape[-2:]))
    return white.square().sum((-2, -1)) / scored.sum((-2, -1))


def dtw_to_motions(
    plans: Float[Tensor, "*batch time signals"],
    references: Trajectory,
) -> Float[Tensor, "*batch"]:
    """Summed Euclidean DTW cost of each whole plan to given motions, averaged over the motions (the paper's Fig. 3).

    Args:
        plans: (*batch, T, D), whole plans, in the signals' unit.
        references: batch (R,) of motions seen without gaps; padding at their end is left out.

    Raises:
        ShapeError: other signals.
        InputError: NaN in a plan, references that are no batch or have gaps.

    Example:
        >>> training = Trajectory(time=[0.0, 0.4], values=[[[0.0], [1.0]], [[0.0], [3.0]]])
        >>> dtw_to_motions(torch.tensor([[0.0], [1.0]], dtype=torch.float64), training)
        tensor(1., dtype=torch.float64)
    """
    from eaip_prob.phase.alignment import dtw_cost

    plans = as_float64("plans", plans)
    if len(references.batch_shape) != 1:
        raise InputError(
            f"Expected references as one batch (R,), got batch {tuple(references.batch_shape)}. Use stack."
        )
    check_shape("plans", plans, ["T", references.num_signals])
    check_finite("plans", plans)
    lengths = references.seen.sum(-1)
    whole = torch.arange(references.num_samples) < lengths[:, None]
    if not bool((references.mask == whole[..., None]).all()) or bool((lengths == 0).any()):
        raise InputError(
            "Expected references seen from the first sample to their end in every signal. Fill gaps first."
        )
    return dtw_cost(plans, references.values, lengths).mean(-1)


def _log_density(deviation: Tensor, variance: Tensor) -> Tensor:
    return -0.5 * (deviation.square() / variance + (2.0 * math.pi * variance).log())


def _marginal(covariance: Tensor, scored: Tensor) -> Tensor:
    """The covariance with unscored entries made independent, at the scored ones' mean variance.

    That variance keeps the scale to which `safe_cholesky` relates its jitter.
    """
    if scored.shape[-1] != covariance.shape[-1]:
        raise ShapeError(f"Expected mask with {covariance.shape[-1]} entries, got {scored.shape[-1]}.")
    both = scored[..., :, None] & scored[..., None, :]
    diagonal = torch.where(scored, covariance.diagonal(dim1=-2, dim2=-1), 0.0)
    fill = diagonal.sum(-1, keepdim=True) / scored.sum(-1, keepdim=True)
    return torch.where(both, covariance, torch.diag_embed(torch.where(scored, 0.0, fill)))

"""Which samples are scored: masks, their checks, and means over what they select."""

from __future__ import annotations

from typing import Any

import torch
from jaxtyping import Bool, Float
from torch import Tensor

from eaip_prob.checks import as_bool, as_float64, check_finite, check_shape
from eaip_prob.data.trajectory import Trajectory
from eaip_prob.errors import InputError, ShapeError


def future_mask(truth: Trajectory, seen_until: Float[Tensor, "*#batch"] | float) -> Bool[Tensor, "*batch time signals"]:
    """The recorded samples later than `seen_until`: what a prediction made at that moment is scored on.

    A motion that had ended by then has no such sample; drop it with `mask.any((-2, -1))` before scoring.

    Args:
        truth: the motions that really followed.
        seen_until: (*batch,) or one number, seconds on the time axis of `truth`; usually `observed.end`.

    Example:
        >>> truth = Trajectory(time=[0.0, 0.5, 1.0], values=[[1.0], [2.0], [3.0]])
        >>> future_mask(truth, 0.5).squeeze(-1)
        tensor([False, False,  True])
    """
    later = truth.time > as_float64("seen_until", seen_until)[..., None]
    return truth.mask & later[..., None]


def scored_mask(mask: Any, truth: Tensor) -> Tensor:
    """The mask with its signal axis, (*batch, T, D); every motion must have a scored sample.

    Args:
        mask: shape of `truth`, or that shape without the signal axis, or with more leading axes.
        truth: (*batch, T, D).

    Raises:
        ShapeError: the mask does not fit the truth.
        InputError: the mask is not boolean, or a motion has no scored sample (the message names it).
    """
    if truth.ndim < 2:
        raise ShapeError(f"Expected truth with shape (*batch, T, D), got {tuple(truth.shape)}.")
    result = as_bool("mask", mask)
    if result.ndim == truth.ndim - 1:
        result = result[..., None].expand(*result.shape, truth.shape[-1])
    if result.ndim < 2 or result.shape[-2:] != truth.shape[-2:]:
        raise ShapeError(
            f"Expected mask with the shape of truth, {tuple(truth.shape)}, or without its last axis, "
            f"got {tuple(as_bool('mask', mask).shape)}."
        )
    empty = ~result.any(-1).any(-1)
    if bool(empty.any()):
        motion = tuple(int(i) for i in empty.nonzero()[0])
        where = f"motion {motion[0] if len(motion) == 1 else motion}" if motion else "the motion"
        raise InputError(
            f"Expected at least one scored sample in every motion, {where} has none ({int(empty.sum())} such motions). "
            f"Drop motions that had already ended: keep = mask.any((-2, -1))."
        )
    return result


def scored_values(name: str, values: Any, mask: Tensor, fill: float = 0.0) -> Tensor:
    """The values as float64, finite where scored and `fill` elsewhere.

    Raises:
        ShapeError: the last two axes differ from the mask's.
        InputError: NaN or infinity in a scored sample.
    """
    tensor = as_float64(name, values)
    check_shape(name, tensor, list(mask.shape[-2:]))
    try:
        tensor, mask = torch.broadcast_tensors(tensor, mask)
    except RuntimeError as error:
        raise ShapeError(
            f"Expected {name} with leading axes that fit the mask's, {tuple(mask.shape)}, got {tuple(tensor.shape)}."
        ) from error
    check_finite(name, tensor, where=mask)
    return torch.where(mask, tensor, fill)


def scored_variance(name: str, values: Any, mask: Tensor) -> Tensor:
    """Variances that are above zero where scored and 1 elsewhere.

    Raises:
        InputError: a variance of zero or below in a scored sample.
    """
    variance = scored_values(name, values, mask, fill=1.0)
    if bool((variance <= 0).any()):
        index = tuple(int(i) for i in (variance <= 0).nonzero()[0])
        raise InputError(
            f"Expected {name} above zero in every scored sample, got {float(variance[index]):.3g} at index {index}. "
            f"Add the representation residual to the predictive variance."
        )
    return variance


def scored_mean(values: Float[Tensor, "*#batch time signals"], mask: Tensor) -> Float[Tensor, "*batch"]:
    """Mean over the scored samples and signals of each motion."""
    return torch.where(mask, values, 0.0).sum((-2, -1)) / mask.sum((-2, -1))

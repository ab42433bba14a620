"""Checks that the functions of `phase.alignment` share, and the way from tensors to the kernels' arrays."""

from __future__ import annotations

import numpy as np
import torch
from torch import Tensor

from eaip_prob.checks import as_float64, check_finite
from eaip_prob.errors import InputError, ShapeError


def checked_signals(name: str, values: Tensor) -> Tensor:
    """The values as float64 (..., T, D) with at least one sample and one signal."""
    samples = as_float64(name, values)
    if samples.ndim < 2 or 0 in samples.shape[-2:]:
        raise ShapeError(
            f"Expected {name} with at least one sample and one signal, (..., T, D), got {tuple(samples.shape)}. "
            f"A single signal needs its own axis: {name}[:, None]."
        )
    return samples


def checked_stack(name: str, values: Tensor) -> Tensor:
    """The values as float64 (N, T, D), none of them zero."""
    samples = checked_signals(name, values)
    if samples.ndim != 3 or len(samples) == 0:
        raise ShapeError(
            f"Expected {name} with shape (N, T, D) and N >= 1, got {tuple(samples.shape)}. "
            f"A single one needs its own axis: {name}[None]."
        )
    return samples


def reference_columns(reference: Tensor) -> np.ndarray:
    """A read-only copy (D, T_r) of a reference (T_r, D): one contiguous row for each signal."""
    samples = checked_signals("reference", reference)
    if samples.ndim != 2:
        raise ShapeError(f"Expected a single reference with shape (T, D), got {tuple(samples.shape)}.")
    check_finite("reference", samples)
    return read_only(array(samples.T).copy())


def checked_lengths(lengths: Tensor | None, padded: Tensor) -> Tensor:
    """The lengths (*batch,) of padded samples (*batch, T, D), all T where none are given."""
    batch, longest = padded.shape[:-2], padded.shape[-2]
    if lengths is None:
        return torch.full(batch, longest)
    counts = torch.as_tensor(lengths)
    if counts.shape != batch or counts.is_floating_point() or counts.is_complex() or counts.dtype == torch.bool:
        raise ShapeError(
            f"Expected lengths as integers with shape {tuple(batch)}, got {counts.dtype} with shape "
            f"{tuple(counts.shape)}. Give one number of samples for each."
        )
    if bool(((counts < 1) | (counts > longest)).any()):
        raise InputError(f"Expected lengths between 1 and the {longest} samples given, got {counts.tolist()}.")
    return counts.to(torch.int64)


def within(lengths: Tensor, padded: Tensor) -> Tensor:
    """True (*batch, T, D) where a sample of `padded` is no padding."""
    return (torch.arange(padded.shape[-2]) < lengths[..., None])[..., None].expand_as(padded)


def array(tensor: Tensor) -> np.ndarray:
    """A contiguous array for reading; shares the tensor's memory where it can."""
    return tensor.detach().cpu().contiguous().numpy()


def read_only(values: np.ndarray) -> np.ndarray:
    """The same array, closed to writing."""
    values.flags.writeable = False
    return values

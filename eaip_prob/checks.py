"""Checks of arguments at public boundaries: typed errors that say what was expected and what came."""

from __future__ import annotations

import math
import numbers
from collections.abc import Iterable, Sequence
from typing import Any

import numpy as np
import torch
from torch import Tensor

from eaip_prob.errors import InputError, ShapeError


def as_float64(name: str, values: Any) -> Tensor:
    """The values as a detached-by-reference float64 tensor; the caller's array is never written to.

    Raises:
        InputError: the values are not numbers in a rectangular array.
    """
    try:
        if isinstance(values, Tensor):
            return values if values.dtype == torch.float64 else values.to(torch.float64)
        return torch.as_tensor(np.asarray(values, dtype=np.float64))
    except (TypeError, ValueError) as error:
        raise InputError(f"Expected {name} as numbers in a rectangular array, got {_kind(values)}: {error}.") from error


def as_bool(name: str, values: Any) -> Tensor:
    """The values as a boolean tensor; other types are refused so that a mask is never a rounded number."""
    tensor = values if isinstance(values, Tensor) else torch.as_tensor(np.asarray(values))
    if tensor.dtype != torch.bool:
        raise InputError(
            f"Expected {name} as booleans (True = observed), got dtype {tensor.dtype}. Compare explicitly."
        )
    return tensor


def check_finite(
    name: str,
    values: Tensor,
    where: Tensor | None = None,
    advice: str = "Mark missing samples with mask=False instead.",
) -> None:
    """Refuses NaN and infinity, looking only at entries where `where` holds; `advice` says what to do.

    Raises:
        InputError: names the first offending index.
    """
    if math.isfinite(float(values.sum())):  # one pass; a sum that overflows is looked at closer
        return
    bad = ~torch.isfinite(values)
    if where is not None:
        bad = bad & where
    if bool(bad.any()):
        index = tuple(int(i) for i in bad.nonzero()[0])
        raise InputError(
            f"Expected finite numbers in {name}, got {float(values[index])} at index {index} "
            f"({int(bad.sum())} such entries). {advice}"
        )


def check_shape(name: str, tensor: Tensor, expected: Sequence[int | str]) -> None:
    """Checks trailing axes; a string stands for any size, leading batch axes are free.

    Raises:
        ShapeError: the trailing axes differ.
    """
    shape = tuple(tensor.shape)
    trailing = shape[len(shape) - len(expected) :]
    fits = len(shape) >= len(expected) and all(
        isinstance(want, str) or want == got for want, got in zip(expected, trailing, strict=True)
    )
    if not fits:
        wanted = ", ".join(["*batch", *map(str, expected)])
        raise ShapeError(f"Expected {name} with shape ({wanted}), got {shape}.")


def check_names(name: str, names: Iterable[str], count: int) -> tuple[str, ...]:
    """The names as a tuple of `count` different strings.

    Raises:
        InputError: wrong number of names, or one given twice.
    """
    result = tuple(names)
    if len(result) != count or len(set(result)) != count or not all(isinstance(n, str) for n in result):
        raise InputError(f"Expected {count} different names in {name}, got {result}.")
    return result


def check_type(name: str, value: Any, expected: type, advice: str) -> None:
    """Refuses an object of another class; `advice` says how to make the right one."""
    if not isinstance(value, expected):
        raise InputError(f"Expected {name} as {expected.__name__}, got {type(value).__name__}. {advice}")


def check_count(name: str, value: Any, least: int = 1) -> int:
    """The value, which must be an integer of at least `least`."""
    if not isinstance(value, numbers.Integral) or int(value) < least:
        raise InputError(f"Expected {name} as an integer of at least {least}, got {value!r}.")
    return int(value)


def check_fraction(name: str, value: float) -> float:
    """The value, which must lie in [0, 1]."""
    if not 0.0 <= value <= 1.0:
        raise InputError(f"Expected {name} between 0 and 1, got {value}.")
    return float(value)


def check_positive(name: str, value: float) -> float:
    """The value, which must be finite and above zero."""
    if not (np.isfinite(value) and value > 0):
        raise InputError(f"Expected {name} above zero and finite, got {value}.")
    return float(value)


def _kind(values: Any) -> str:
    return f"{type(values).__name__} {str(values)[:40]!r}"

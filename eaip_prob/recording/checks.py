"""Checks that the records of a run share."""

from __future__ import annotations

from typing import Any

import numpy as np

from eaip_prob.checks import as_float64, check_finite
from eaip_prob.errors import InputError, ShapeError

Color = tuple[int, int, int] | tuple[int, int, int, int]


def checked_entity(entity: str) -> str:
    """The entity's path: words of letters, digits, `_`, `-` and `.`, with slashes between them.

    Raises:
        InputError: an empty path or word, or another character.
    """
    words = entity.split("/")
    if not all(word and all(letter.isalnum() or letter in "_-." for letter in word) for word in words):
        raise InputError(f"Expected an entity such as 'human/left', of letters, digits, '_', '-', '.', got {entity!r}.")
    return entity


def checked_color(color: Color) -> Color:
    """The color with its opacity, 255 where none is given.

    Raises:
        InputError: not three or four whole numbers from 0 to 255.
    """
    full = (*color, 255) if len(color) == 3 else tuple(color)
    if len(full) != 4 or not all(isinstance(part, int) and 0 <= part <= 255 for part in full):
        raise InputError(f"Expected a color as (red, green, blue) or with opacity, whole numbers 0..255, got {color}.")
    return full


def as_array(name: str, values: Any) -> np.ndarray:
    """The values as a finite float64 array, from a tensor on any device, an array or nested lists.

    Raises:
        InputError: not numbers, NaN or infinity.
    """
    tensor = as_float64(name, values)
    check_finite(name, tensor)
    return tensor.detach().cpu().numpy()


def check_bounds(entity: str, lower: np.ndarray, upper: np.ndarray, shape: tuple[int, ...]) -> None:
    """Refuses bounds of another shape, or a lower bound above the upper one.

    Raises:
        ShapeError: another shape.
        InputError: names the first index at which the bounds are exchanged.
    """
    if lower.shape != shape or upper.shape != shape:
        raise ShapeError(
            f"Expected lower and upper with shape {shape} at {entity!r}, got {lower.shape} and {upper.shape}."
        )
    if bool((lower > upper).any()):
        at = tuple(int(i) for i in np.argwhere(lower > upper)[0])
        raise InputError(
            f"Expected lower <= upper at {entity!r}, got {lower[at]:.6g} > {upper[at]:.6g} "
            f"at index {at}. Were the two exchanged?"
        )


def shaped_array(name: str, values: Any, axes: tuple[str, ...]) -> np.ndarray:
    """The values as a finite float64 array with the given axes, none of them empty.

    Raises:
        ShapeError: other axes, or nothing along one of them.
        InputError: not numbers, NaN or infinity.
    """
    array = as_array(name, values)
    if array.ndim != len(axes) or 0 in array.shape:
        raise ShapeError(f"Expected {name} with shape ({', '.join(axes)}) and at least one entry, got {array.shape}.")
    return array

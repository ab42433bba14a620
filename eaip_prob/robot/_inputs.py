"""Checks that the parts of `robot` share, and the way from what is given to float64 arrays."""

from __future__ import annotations

from typing import Any

import numpy as np

from eaip_prob.errors import InputError, ShapeError


def checked_rows(name: str, values: Any, columns: int, what: str) -> np.ndarray:
    """The values as float64 (*batch, columns), finite; `what` the last axis holds, for the message."""
    try:
        rows = np.asarray(values, dtype=np.float64)
    except (TypeError, ValueError) as error:
        raise InputError(f"Expected {name} as numbers in a rectangular array, got {error}.") from error
    if rows.ndim == 0 or rows.shape[-1] != columns:
        raise ShapeError(f"Expected {name} with shape (*batch, {columns}), {what}, got {rows.shape}.")
    bad = np.argwhere(~np.isfinite(rows))
    if len(bad):
        raise InputError(
            f"Expected finite numbers in {name}, got {rows[tuple(bad[0])]} at index {tuple(bad[0].tolist())}. "
            "Leave out or fill in what was not measured."
        )
    return rows


def checked_samples(name: str, values: Any, columns: int, what: str) -> np.ndarray:
    """The values as float64 (T, columns), finite, with at least one sample."""
    rows = checked_rows(name, values, columns, what)
    if rows.ndim != 2 or len(rows) == 0:
        raise ShapeError(f"Expected {name} with shape (T, {columns}) and at least one sample, got {rows.shape}.")
    return np.ascontiguousarray(rows)


def checked_vector(name: str, values: Any, count: int, what: str) -> np.ndarray:
    """The values as float64 (count,), finite."""
    vector = checked_rows(name, values, count, what)
    if vector.ndim != 1:
        raise ShapeError(f"Expected {name} with shape ({count},), {what}, got {vector.shape}.")
    return vector


def checked_time(time: Any, count: int) -> np.ndarray:
    """The times as float64 (count,), strictly increasing, s."""
    times = checked_vector("time", time, count, "one for each sample")
    late = np.flatnonzero(np.diff(times) <= 0)
    if len(late):
        first = int(late[0])
        raise InputError(
            f"Expected time that strictly increases, got {times[first]:g} s and then {times[first + 1]:g} s at sample "
            f"{first + 1}. Sort the samples and leave out repeated ones."
        )
    return times

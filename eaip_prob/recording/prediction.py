"""A prediction made at one moment, taken apart into the records that show it."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np

from eaip_prob.checks import check_names
from eaip_prob.errors import InputError, ShapeError
from eaip_prob.recording.checks import Color, as_array, check_bounds
from eaip_prob.recording.records import (
    OBSERVED,
    PREDICTED,
    Box,
    Curves,
    Moment,
    Paths,
    Record,
)

_EARLY: Color = (246, 190, 70)
_LATE: Color = (196, 40, 60)

Bounds = tuple[np.ndarray, np.ndarray]


def prediction_records(
    entity: str,
    time: Any,
    mean: Any,
    names: Sequence[str],
    at: Moment,
    *,
    bounds: tuple[Any, Any] | None = None,
    samples: Any = None,
    observed: Any = None,
    fan: bool = True,
) -> list[Record]:
    """The records of `AbstractRunLogger.prediction`, all of them checked before the first is stored.

    Args:
        entity: whose motion is predicted.
        time: (T,), seconds.
        mean: (T, D).
        names: D names.
        at: when the prediction was made.
        bounds: lower and upper, (T, D) each.
        samples: (N, T, D).
        observed: (samples seen, 2 or 3).
        fan: whether the curves of the plots are among the records.

    Raises:
        ShapeError: axes do not match.
        InputError: bounds exchanged, or numbers not finite.

    Example:
        >>> now = Moment(samples_seen=1, time=0.0)
        >>> [r.entity for r in prediction_records("robot", [0.0, 0.1], [[0.0, 0.0], [9.0, 5.0]], ["x", "y"], now)]
        ['robot/mean', 'signals/x/robot_0001', 'signals/y/robot_0001']
    """
    clock, centre = as_array("time", time), as_array("mean", mean)
    if clock.ndim != 1 or centre.shape != (len(clock), len(names)):
        raise ShapeError(
            f"Expected time (T,) and mean (T, {len(names)}) at {entity!r}, got {clock.shape} and {centre.shape}."
        )
    check_names("names", names, len(names))
    pair = None if bounds is None else _checked(entity, bounds, centre.shape)
    records: list[Record] = []
    if observed is not None:
        records.append(Paths(f"{entity}/observed", as_array("observed", observed)[None], 2.5, OBSERVED, at))
    if centre.shape[1] in (2, 3):
        records.extend(_picture(entity, centre, pair, samples, at))
    if fan:
        records.extend(_fan(entity, clock, centre, pair, names, at))
    return records


def _checked(entity: str, bounds: tuple[Any, Any], shape: tuple[int, ...]) -> Bounds:
    if bounds[0] is None or bounds[1] is None:
        raise InputError(f"Expected both bounds of the interval at {entity!r} or neither, got one.")
    lower, upper = as_array("lower", bounds[0]), as_array("upper", bounds[1])
    check_bounds(entity, lower, upper, shape)
    return lower, upper


def _picture(entity: str, mean: np.ndarray, bounds: Bounds | None, samples: Any, at: Moment) -> Iterator[Record]:
    if samples is not None:
        drawn = as_array("samples", samples)
        if drawn.ndim != 3 or drawn.shape[1:] != mean.shape:
            raise ShapeError(
                f"Expected samples with shape (N, {mean.shape[0]}, {mean.shape[1]}) at {entity!r}, got {drawn.shape}."
            )
        yield Paths(f"{entity}/samples", drawn, 0.5, (*PREDICTED[:3], 70), at)
    yield Paths(f"{entity}/mean", mean[None], 2.0, PREDICTED, at)
    if bounds is not None:
        yield Box(f"{entity}/end_interval", bounds[0][-1], bounds[1][-1], PREDICTED, at)


def _fan(
    entity: str, time: np.ndarray, mean: np.ndarray, bounds: Bounds | None, names: Sequence[str], at: Moment
) -> Iterator[Record]:
    ahead = time >= at.time
    if not ahead.any():
        return
    shade = _shade((at.time - time[0]) / max(float(time[-1] - time[0]), 1e-9))
    place = time[ahead], at.samples_seen + np.arange(int(ahead.sum()))
    label = f"after {at.samples_seen}"
    for signal, name in enumerate(names):
        columns = [mean, *(bounds or ())]
        values = np.stack([column[ahead, signal] for column in columns], axis=-1)
        colors: tuple[Color, ...] = (shade, (*shade[:3], 110), (*shade[:3], 110))
        root = f"signals/{name}/{entity}_{at.samples_seen:04d}"
        yield Curves(root, *place, values, (label,) * len(columns), colors[: len(columns)])


def _shade(share: float) -> Color:
    share = min(max(share, 0.0), 1.0)
    red, green, blue = (round(a + share * (b - a)) for a, b in zip(_EARLY[:3], _LATE[:3], strict=True))
    return red, green, blue

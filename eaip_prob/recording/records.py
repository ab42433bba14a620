"""The values that a run logger stores: checked once here, for every logger alike.

Letters: N paths, T time steps, D dimensions of a point (2 or 3), C curves in one plot.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from jaxtyping import Float64, Int64

from eaip_prob.checks import check_names, check_positive
from eaip_prob.errors import InputError, ShapeError
from eaip_prob.recording.checks import Color, as_array, check_bounds, checked_color, checked_entity, shaped_array

TRUTH: Color = (150, 150, 150)
OBSERVED: Color = (42, 157, 143)
PREDICTED: Color = (230, 111, 40)
SCENE: Color = (96, 125, 180)

KINDS = ("plane", "space", "cameras", "workspace", "plots")
TIMELINES = ("samples_seen", "time")


@dataclass(frozen=True)
class Moment:
    """A place on both timelines of a recording.

    Args:
        samples_seen: how many samples of the partner had been seen, at least 0.
        time: seconds since the start of the motion.

    Raises:
        InputError: a negative count, or a time that is not finite.

    Example:
        >>> Moment(samples_seen=20, time=0.4)
        Moment(samples_seen=20, time=0.4)
    """

    samples_seen: int
    time: float

    def __post_init__(self) -> None:
        if self.samples_seen < 0 or int(self.samples_seen) != self.samples_seen:
            raise InputError(f"Expected samples_seen as a whole number of at least 0, got {self.samples_seen}.")
        if not np.isfinite(self.time):
            raise InputError(f"Expected time in seconds, got {self.time}.")


@dataclass(frozen=True, eq=False)
class Paths:
    """N paths of one entity, drawn alike; `at = None` holds for the whole recording.

    Args:
        values: (N, T, 2) in the plane, in its unit (px), y up, or (N, T, 3) in space, m.
        radius: half the width of the line in points of the screen; thicker lines lie above thinner ones in the plane.
    """

    entity: str
    values: Float64[np.ndarray, "paths steps dims"]
    radius: float
    color: Color
    at: Moment | None = None
    label: str | None = None

    def __post_init__(self) -> None:
        values = shaped_array("values", self.values, ("N", "T", "D"))
        _set(self, entity=checked_entity(self.entity), values=values, color=checked_color(self.color))
        check_positive("radius", self.radius)
        if self.values.shape[-1] not in (2, 3):
            raise ShapeError(
                f"Expected points with 2 or 3 coordinates at {self.entity!r}, got "
                f"{self.values.shape[-1]}. Record other signals with series()."
            )


@dataclass(frozen=True, eq=False)
class Box:
    """An outline parallel to the axes.

    Args:
        lower: (2,) or (3,), the smallest coordinates, in the unit of the paths.
        upper: (2,) or (3,), the largest.
    """

    entity: str
    lower: Float64[np.ndarray, "dims"]
    upper: Float64[np.ndarray, "dims"]
    color: Color
    at: Moment | None = None
    label: str | None = None

    def __post_init__(self) -> None:
        lower, upper = shaped_array("lower", self.lower, ("D",)), shaped_array("upper", self.upper, ("D",))
        if len(lower) not in (2, 3):
            raise ShapeError(f"Expected corners with 2 or 3 coordinates at {self.entity!r}, got {len(lower)}.")
        check_bounds(self.entity, lower, upper, lower.shape)
        _set(self, entity=checked_entity(self.entity), lower=lower, upper=upper, color=checked_color(self.color))


@dataclass(frozen=True, eq=False)
class Curves:
    """C curves over both timelines.

    Args:
        time: (T,), seconds, strictly increasing.
        samples_seen: (T,), whole numbers, strictly increasing.
        values: (T, C), in the plot's unit.
        names: C names for the legend, where curves with one name share an entry.
        colors: C colors.
        width: of the lines, in points of the screen.
    """

    entity: str
    time: Float64[np.ndarray, "steps"]
    samples_seen: Int64[np.ndarray, "steps"]
    values: Float64[np.ndarray, "steps curves"]
    names: tuple[str, ...]
    colors: tuple[Color, ...]
    width: float = 1.5

    def __post_init__(self) -> None:
        values, time = shaped_array("values", self.values, ("T", "C")), shaped_array("time", self.time, ("T",))
        count = shaped_array("samples_seen", self.samples_seen, ("T",))
        if not len(values) == len(time) == len(count):
            raise ShapeError(
                f"Expected one time and one samples_seen for each of the {len(values)} rows at "
                f"{self.entity!r}, got {len(time)} and {len(count)}."
            )
        for name, index in (("time", time), ("samples_seen", count)):
            if bool((np.diff(index) <= 0).any()):
                raise InputError(
                    f"Expected strictly increasing {name} at {self.entity!r}, got a step of {np.diff(index).min():.3g}."
                )
        if not np.array_equal(count, np.round(count)):
            raise InputError(f"Expected samples_seen as whole numbers at {self.entity!r}, got {count.tolist()[:5]}.")
        _set(self, entity=checked_entity(self.entity), values=values, time=time, samples_seen=count.astype(np.int64))
        if not len(self.names) == len(self.colors) == values.shape[1]:
            raise ShapeError(
                f"Expected {values.shape[1]} names and colors at {self.entity!r}, "
                f"got {len(self.names)} and {len(self.colors)}."
            )
        _set(self, names=tuple(self.names), colors=tuple(checked_color(color) for color in self.colors))
        check_positive("width", self.width)


@dataclass(frozen=True)
class Text:
    """A Markdown document."""

    entity: str
    markdown: str
    at: Moment | None = None

    def __post_init__(self) -> None:
        _set(self, entity=checked_entity(self.entity))


@dataclass(frozen=True, eq=False)
class Array:
    """The numbers behind a figure: a tensor with a name for each axis."""

    entity: str
    values: Float64[np.ndarray, "..."]
    names: tuple[str, ...]

    def __post_init__(self) -> None:
        values = as_array("values", self.values)
        if values.size == 0:
            raise ShapeError(f"Expected at least one number at {self.entity!r}, got shape {values.shape}.")
        _set(self, entity=checked_entity(self.entity), values=values)
        check_names("names", self.names, self.values.ndim)


@dataclass(frozen=True)
class Layout:
    """What the viewer shows when the recording is opened.

    Args:
        kind: `plane` (2-D paths beside the plots), `space` (3-D paths beside the plots), `cameras` (3-D scene,
            images of the cameras and plots), `workspace` (surfaces in a large 3-D scene above the colour images, beside
            report and plots) or `plots` (plots and report).
        plots: title with unit for each plot, by the entity under which its curves are.
        timeline: `samples_seen` or `time`, the horizontal axis of the plots and of the slider.
        bounds: ((x smallest, y smallest), (x largest, y largest)) of the plane, y up; None fits what was recorded.
    """

    kind: str
    plots: Mapping[str, str] = field(default_factory=dict)
    timeline: str = "samples_seen"
    bounds: tuple[tuple[float, float], tuple[float, float]] | None = None

    def __post_init__(self) -> None:
        if self.kind not in KINDS:
            raise InputError(f"Expected a kind of layout among {KINDS}, got {self.kind!r}.")
        if self.timeline not in TIMELINES:
            raise InputError(f"Expected a timeline among {TIMELINES}, got {self.timeline!r}.")
        _set(self, plots={checked_entity(entity): title for entity, title in self.plots.items()})


Record = Paths | Box | Curves | Text | Array | Layout


def _set(record: Any, **fields: Any) -> None:
    for key, value in fields.items():
        object.__setattr__(record, key, value)

"""The calls that draw lines and boxes, in the plane or in space."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from eaip_prob.errors import ShapeError
from eaip_prob.recording.checks import Color, as_array
from eaip_prob.recording.recorder import AbstractRecorder
from eaip_prob.recording.records import SCENE, TRUTH, Box, Moment, Paths


class AbstractDrawing(AbstractRecorder):
    """Paths and boxes; derived classes add what cameras saw and what is plotted."""

    def path(
        self,
        entity: str,
        values: Any,
        *,
        radius: float = 1.5,
        color: Color = TRUTH,
        at: Moment | None = None,
        label: str | None = None,
    ) -> None:
        """One path.

        Args:
            entity: name of the path, such as `human/truth`.
            values: (T, 2) in the plane, in its unit (px), y up, or (T, 3) in space, m.
            radius: half the width of the line in points of the screen.
            color: (red, green, blue) or with opacity, 0..255.
            at: since when the path holds, until the next one under this entity; None for the whole recording,
                which hides any other path under the entity.
            label: text drawn at the middle of the path.

        Example:
            >>> from eaip_prob.recording import NullLogger
            >>> NullLogger().path("human/truth", [[0.0, 0.0], [120.0, 80.0]])
        """
        self._record(Paths(entity, _single(values), radius, color, at, label))

    def paths(
        self,
        entity: str,
        values: Any,
        *,
        radius: float = 0.5,
        color: Color = (*TRUTH[:3], 110),
        at: Moment | None = None,
    ) -> None:
        """Several paths drawn alike, such as demonstrations or samples of a posterior.

        Args:
            entity: name of the paths.
            values: (N, T, 2) in the plane, in its unit (px), y up, or (N, T, 3) in space, m.
            radius: half the width of the lines in points of the screen.
            color: (red, green, blue) or with opacity, 0..255.
            at: since when the paths hold; None for the whole recording.

        Example:
            >>> from eaip_prob.recording import NullLogger
            >>> NullLogger().paths("demonstrations", [[[0.0, 0.0], [120.0, 80.0]], [[0.0, 0.0], [130.0, 70.0]]])
        """
        self._record(Paths(entity, values, radius, color, at))

    def box(
        self,
        entity: str,
        lower: Any,
        upper: Any,
        *,
        color: Color = SCENE,
        at: Moment | None = None,
        label: str | None = None,
    ) -> None:
        """An outline parallel to the axes.

        Args:
            entity: name of the box.
            lower: (2,) in the plane, in its unit (px), y up, or (3,) in space, m.
            upper: the opposite corner.
            color: (red, green, blue) or with opacity, 0..255.
            at: since when the box holds; None for the whole recording.
            label: text drawn in the middle.

        Example:
            >>> from eaip_prob.recording import NullLogger
            >>> NullLogger().box("table", [0.0, 0.0, 0.0], [1.2, 0.6, 0.7], label="table")
        """
        self._record(Box(entity, lower, upper, color, at, label))

    def rectangle(
        self, entity: str, width: float, height: float, *, corner: Sequence[float] = (0.0, 0.0), unit: str = "px"
    ) -> None:
        """The outline of a rectangle in the plane, labelled with its size.

        Args:
            entity: name of the rectangle.
            width: along x, in `unit`.
            height: along y (up), in `unit`.
            corner: (x, y) of the lower left corner.
            unit: for the label.

        Example:
            >>> from eaip_prob.recording import NullLogger
            >>> NullLogger().rectangle("object", width=215, height=125)
        """
        upper = (corner[0] + width, corner[1] + height)
        self.box(entity, corner, upper, label=f"{width:g} x {height:g} {unit}")


def _single(values: Any) -> Any:
    array = as_array("values", values)
    if array.ndim != 2:
        raise ShapeError(
            f"Expected values with shape (T, 2) or (T, 3), got {array.shape}. Record several paths with paths()."
        )
    return array[None]

"""Surfaces in space and boxes in images, as values that a run logger stores: checked once here.

Letters: V vertices, F triangles, N boxes.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from jaxtyping import Float64, Int64, UInt8

from eaip_prob.data.frames import Intrinsics
from eaip_prob.errors import InputError, ShapeError
from eaip_prob.recording.checks import Color, as_array, checked_color, checked_entity
from eaip_prob.recording.records import Moment


@dataclass(frozen=True, eq=False)
class Surface:
    """Triangles with a colour each.

    Args:
        vertices: (V, 3), m.
        triangles: (F, 3), indices of vertices.
        colors: (F, 3), RGB.
        smooth: whether light changes gradually over edges, as on cloth; else every triangle is flat.
    """

    entity: str
    vertices: Float64[np.ndarray, "vertices 3"]
    triangles: Int64[np.ndarray, "faces 3"]
    colors: UInt8[np.ndarray, "faces 3"]
    smooth: bool
    at: Moment | None = None

    def __post_init__(self) -> None:
        vertices, triangles = as_array("vertices", self.vertices), as_array("triangles", self.triangles)
        for name, values in (("vertices", vertices), ("triangles", triangles)):
            if values.ndim != 2 or values.shape[1] != 3 or not len(values):
                raise ShapeError(f"Expected {name} with shape (any, 3) at {self.entity!r}, got {values.shape}.")
        if (triangles != np.floor(triangles)).any() or triangles.min() < 0 or triangles.max() >= len(vertices):
            raise InputError(
                f"Expected triangles of vertices 0 to {len(vertices) - 1} at {self.entity!r}, got indices from "
                f"{triangles.min():g} to {triangles.max():g}."
            )
        colors = _face_colors(self.entity, self.colors, len(triangles))
        _set(self, entity=checked_entity(self.entity), vertices=vertices, triangles=triangles.astype(np.int64))
        _set(self, colors=colors)


@dataclass(frozen=True, eq=False)
class ImageBoxes:
    """Upright boxes in the colour image of a camera.

    Args:
        entity: of the camera.
        boxes: (N, 4), centre column, centre row, width and height in the image as taken, px; N may be 0.
        camera: the lens of the colour camera.
        labels: N texts, or none.
    """

    entity: str
    boxes: Float64[np.ndarray, "boxes 4"]
    camera: Intrinsics
    color: Color
    at: Moment | None = None
    labels: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        boxes = as_array("boxes", self.boxes)
        if boxes.ndim != 2 or boxes.shape[1] != 4:
            raise ShapeError(f"Expected boxes with shape (N, 4) at {self.entity!r}, got {boxes.shape}.")
        if not (boxes[:, 2:] > 0).all():
            raise InputError(f"Expected widths and heights above zero at {self.entity!r}, got {boxes[:, 2:].tolist()}.")
        if self.labels and len(self.labels) != len(boxes):
            raise ShapeError(f"Expected {len(boxes)} labels at {self.entity!r}, or none, got {len(self.labels)}.")
        _set(self, entity=checked_entity(self.entity), boxes=boxes, color=checked_color(self.color))


SceneRecord = Surface | ImageBoxes


def _face_colors(entity: str, colors: Any, count: int) -> UInt8[np.ndarray, "faces 3"]:
    """A colour for each triangle, from those or from one for all."""
    given = np.array(colors)
    if given.shape == (3,):
        return np.tile(np.array(checked_color(tuple(given.tolist()))[:3], np.uint8), (count, 1))
    if given.shape != (count, 3):
        raise ShapeError(f"Expected colors with shape ({count}, 3) or one color at {entity!r}, got {given.shape}.")
    if given.dtype != np.uint8:
        raise InputError(f"Expected colors as uint8, 0..255, at {entity!r}, got {given.dtype}.")
    return given


def _set(record: Any, **fields: Any) -> None:
    for key, value in fields.items():
        object.__setattr__(record, key, value)

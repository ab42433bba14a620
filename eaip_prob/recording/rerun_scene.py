"""Surfaces and boxes in images, in rerun's components."""

from __future__ import annotations

from typing import Any

import numpy as np
import rerun as rr
from jaxtyping import Float

from eaip_prob.data.frames import Intrinsics
from eaip_prob.recording.rerun_sensors import COLOR_CAMERA, packed, squared
from eaip_prob.recording.scene_records import ImageBoxes, Surface

IMAGE_BOXES = f"{COLOR_CAMERA}/boxes"

_LINE = 1.5  # points of the screen, half the width
_PIXEL = 0.5  # px; rerun counts from the corner of the first pixel, and we from its centre


def fabric_columns(record: Surface) -> list[Any]:
    """What stays the same while a surface moves: which vertices belong together, and colours."""
    if record.smooth:
        count = len(record.vertices)
        triangles, colors = record.triangles, np.zeros((count, 3), np.uint8)
        colors[record.triangles.ravel()] = np.repeat(record.colors, 3, axis=0)
    else:
        count = 3 * len(record.triangles)
        triangles, colors = np.arange(count).reshape(-1, 3), np.repeat(record.colors, 3, axis=0)
    shape = rr.Mesh3D.columns(triangle_indices=triangles.astype(np.uint32)).partition([len(triangles)])
    return [*shape, *rr.Mesh3D.columns(vertex_colors=packed(colors)).partition([count])]


def vertex_columns(record: Surface) -> list[Any]:
    """Where the vertices are, and the normals without which the viewer would not shade."""
    if record.smooth:
        vertices, normals = record.vertices, vertex_normals(record.vertices, record.triangles)
    else:
        vertices = record.vertices[record.triangles].reshape(-1, 3)
        normals = vertex_normals(vertices, np.arange(len(vertices)).reshape(-1, 3))
    columns = rr.Mesh3D.columns(vertex_positions=vertices.astype(np.float32), vertex_normals=normals.astype(np.float32))
    return [*columns.partition([len(vertices)])]


def vertex_normals(vertices: Float[np.ndarray, "vertices 3"], triangles: np.ndarray) -> Float[np.ndarray, "vertices 3"]:
    """Mean direction of the triangles at each vertex, weighted by their area; 0 where there is none.

    Args:
        vertices: (V, 3), m.
        triangles: (F, 3), indices.
    """
    a, b, c = (vertices[triangles[:, corner]] for corner in range(3))
    faces = np.cross(b - a, c - a)
    normals = np.zeros_like(vertices)
    for corner in range(3):
        np.add.at(normals, triangles[:, corner], faces)
    length = np.linalg.norm(normals, axis=-1, keepdims=True)
    return normals / np.where(length > 0.0, length, 1.0)


def image_box_columns(record: ImageBoxes) -> list[Any]:
    """Boxes around where the straightened image shows what was in the boxes."""
    low, high = straightened_boxes(record.boxes, record.camera)
    count = len(low)
    shape = rr.Boxes2D.columns(centers=(low + high) / 2.0 + _PIXEL, half_sizes=(high - low) / 2.0)
    columns = [
        *shape.partition([count]),
        *rr.Boxes2D.columns(colors=[record.color], radii=[-_LINE]),
    ]
    if record.labels:
        columns += rr.Boxes2D.columns(labels=record.labels).partition([count])
    return columns


def straightened_boxes(
    boxes: Float[np.ndarray, "boxes 4"], camera: Intrinsics
) -> tuple[Float[np.ndarray, "boxes 2"], Float[np.ndarray, "boxes 2"]]:
    """(smallest, largest) column and row of the boxes' corners and edges' middles, in the straightened image.

    Args:
        boxes: (N, 4), centre column, centre row, width and height, px.
        camera: how they were taken.
    """
    across, down = np.meshgrid([-0.5, 0.0, 0.5], [-0.5, 0.0, 0.5])
    grid = np.stack([across.ravel(), down.ravel()], -1)
    pixels = boxes[:, None, :2] + grid * boxes[:, None, 2:]
    rays = camera.unproject(pixels, np.ones(pixels.shape[:-1]))
    straight = squared(camera).project(rays)
    return np.nanmin(straight, axis=1), np.nanmax(straight, axis=1)

"""Triangle meshes from a few shapes: what everything in a simulated scene is made of.

Metres, z up. Every shape is made at the origin in its own frame and placed by `Mesh.moved`. Letters: V
vertices, F faces.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float, Float32, Int32, UInt8

from eaip_prob.errors import InputError, ShapeError

Color = Sequence[float]
Vector = Sequence[float] | Float[np.ndarray, "3"]


@dataclass(frozen=True, eq=False)
class Mesh:
    """Triangles with a colour each; both sides are visible.

    Args:
        vertices: (V, 3), m.
        triangles: (F, 3), indices of vertices.
        color: (F, 3), RGB from 0 to 1.

    Raises:
        ShapeError: arrays of other shapes.
        InputError: no triangle, vertices that are not finite, indices of no vertex, colours outside 0 to 1.

    Example:
        >>> Mesh(np.eye(3), np.array([[0, 1, 2]], np.int32), np.ones((1, 3), np.float32)).area().round(3).tolist()
        [0.866]
    """

    vertices: Float[np.ndarray, "vertices 3"]
    triangles: Int32[np.ndarray, "faces 3"]
    color: Float32[np.ndarray, "faces 3"]

    def __post_init__(self) -> None:
        for name in ("vertices", "triangles", "color"):
            shape = np.shape(getattr(self, name))
            if len(shape) != 2 or shape[1] != 3:
                raise ShapeError(f"Expected {name} with shape (any, 3), got {shape}. Give one row for each.")
        if len(self.triangles) == 0 or len(self.color) != len(self.triangles):
            raise InputError(
                f"Expected at least one triangle and a colour for each, got {len(self.triangles)} triangles and "
                f"{len(self.color)} colours."
            )
        if not np.isfinite(self.vertices).all():
            raise InputError("Expected vertices that are finite, got NaN or infinity. Mend the dimensions.")
        if self.triangles.min() < 0 or self.triangles.max() >= len(self.vertices):
            raise InputError(
                f"Expected triangles of vertices 0 to {len(self.vertices) - 1}, got indices {self.triangles.min()} to "
                f"{self.triangles.max()}."
            )
        if not ((self.color >= 0) & (self.color <= 1)).all():
            raise InputError("Expected colours from 0 to 1, got others. Divide bytes by 255.")

    def moved(self, T_world_mesh: Float[np.ndarray, "4 4"]) -> Mesh:
        """The same mesh elsewhere."""
        return replace(self, vertices=self.vertices @ T_world_mesh[:3, :3].T + T_world_mesh[:3, 3])

    def at(self, x: float = 0.0, y: float = 0.0, z: float = 0.0) -> Mesh:
        """The same mesh shifted, m."""
        return replace(self, vertices=self.vertices + np.array([x, y, z]))

    def area(self) -> Float[np.ndarray, "faces"]:
        """Area of each triangle, m^2."""
        a, b, c = (self.vertices[self.triangles[:, corner]] for corner in range(3))
        return np.linalg.norm(np.cross(b - a, c - a), axis=1) / 2.0

    def extent(self) -> Float[np.ndarray, "2 3"]:
        """Smallest and largest coordinates, m."""
        return np.stack([self.vertices.min(0), self.vertices.max(0)])


def joined(meshes: Sequence[Mesh]) -> Mesh:
    """Several meshes as one.

    Args:
        meshes: at least one.

    Raises:
        InputError: none.

    Example:
        >>> len(joined([box((1, 1, 1), (1, 0, 0)), box((1, 1, 1), (0, 1, 0)).at(x=2.0)]).triangles)
        24
    """
    if not meshes:
        raise InputError("Expected at least one mesh to join, got none.")
    starts = np.cumsum([0] + [len(mesh.vertices) for mesh in meshes[:-1]]).astype(np.int32)
    return Mesh(
        np.concatenate([mesh.vertices for mesh in meshes]),
        np.concatenate([mesh.triangles + start for mesh, start in zip(meshes, starts, strict=True)]),
        np.concatenate([mesh.color for mesh in meshes]),
    )


def box(size: Vector, color: Color) -> Mesh:
    """A box centred at the origin.

    Args:
        size: (3,), along x, y, z, m.
        color: RGB from 0 to 1.

    Example:
        >>> float(box((1.0, 2.0, 3.0), (1, 0, 0)).area().sum())
        22.0
    """
    corners = np.array([[x, y, z] for x in (-0.5, 0.5) for y in (-0.5, 0.5) for z in (-0.5, 0.5)])
    sides = [(0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3)]
    triangles = [triangle for a, b, c, d in sides for triangle in ((a, b, c), (a, c, d))]
    return _colored(corners * np.asarray(size, float), np.array(triangles), color)


def revolved(profile: Float[np.ndarray, "rings 2"], color: Color, sides: int = 16) -> Mesh:
    """The surface that a profile of (radius, height) sweeps around the z axis.

    Args:
        profile: (rings, 2), m; a radius of zero at both ends closes it.
        color: RGB from 0 to 1.
        sides: corners of a ring.

    Example:
        >>> cone = revolved(np.array([[0.0, 0.0], [1.0, 0.0], [0.0, 1.0]]), (1, 1, 1), sides=4)
        >>> cone.extent().round(9).tolist()
        [[-1.0, -1.0, 0.0], [1.0, 1.0, 1.0]]
    """
    angle = 2.0 * np.pi * np.arange(sides) / sides
    circle = np.stack([np.cos(angle), np.sin(angle)], -1)
    rings = [np.column_stack([radius * circle, np.full(sides, height)]) for radius, height in profile]
    return _colored(np.concatenate(rings), _grid_triangles(len(profile), sides, closed=True), color)


def cylinder(radius: float, height: float, color: Color, sides: int = 16) -> Mesh:
    """A closed cylinder around the z axis, from z = 0 up.

    Args:
        radius: m.
        height: m.
        color: RGB from 0 to 1.
        sides: corners of the circle.

    Example:
        >>> cylinder(0.5, 2.0, (1, 1, 1)).extent()[:, 2].tolist()
        [0.0, 2.0]
    """
    return revolved(np.array([[0.0, 0.0], [radius, 0.0], [radius, height], [0.0, height]]), color, sides)


def ellipsoid(radii: Vector, color: Color, sides: int = 20) -> Mesh:
    """An ellipsoid at the origin.

    Args:
        radii: (3,), along x, y, z, m.
        color: RGB from 0 to 1.
        sides: corners of the equator.

    Example:
        >>> ellipsoid((0.1, 0.2, 0.3), (0, 1, 0)).extent().round(9).tolist()[1]
        [0.1, 0.2, 0.3]
    """
    angle = np.linspace(-np.pi / 2.0, np.pi / 2.0, sides // 2 + 1)
    profile = np.column_stack([np.cos(angle), np.sin(angle)])
    profile[[0, -1], 0] = 0.0  # the poles, to the last digit
    sphere = revolved(profile, color, sides)
    return replace(sphere, vertices=sphere.vertices * np.asarray(radii, float))


def tube(start: Vector, end: Vector, radius: float, color: Color, rounded: bool = False) -> Mesh:
    """A cylinder, or with round ends a capsule, between two points.

    Args:
        start: (3,), m.
        end: (3,), m.
        radius: m.
        color: RGB from 0 to 1.
        rounded: whether half a sphere stands out beyond each end.

    Raises:
        InputError: both points are the same.

    Example:
        >>> tube((0, 0, 0), (2, 0, 0), 0.1, (1, 1, 1), rounded=True).extent()[:, 0].round(9).tolist()
        [-0.1, 2.1]
    """
    base = np.asarray(start, float)
    axis = np.asarray(end, float) - base
    length = float(np.linalg.norm(axis))
    if length == 0.0:
        raise InputError(f"Expected a tube between two points, got {base.tolist()} twice. Give another end.")
    if rounded:
        angle = np.linspace(0.0, np.pi / 2.0, 5)
        cap = radius * np.column_stack([np.sin(angle), -np.cos(angle)])
        profile = np.concatenate([cap, cap[::-1] * (1.0, -1.0) + (0.0, length)])
    else:
        profile = np.array([[0.0, 0.0], [radius, 0.0], [radius, length], [0.0, length]])
    T = np.eye(4)
    T[:3, :3], T[:3, 3] = _rotation_with_z(axis / length), base
    return revolved(profile, color, sides=12).moved(T)


def sheet(points: Float[np.ndarray, "rows columns 3"], color: Color) -> Mesh:
    """A surface through a grid of points.

    Args:
        points: (rows, columns, 3), m; at least 2 by 2.
        color: RGB from 0 to 1.

    Example:
        >>> grid = np.stack([*np.meshgrid([0.0, 1.0, 2.0], [0.0, 1.0]), np.zeros((2, 3))], -1)
        >>> float(sheet(grid, (1, 1, 1)).area().sum())
        2.0
    """
    rows, columns = points.shape[:2]
    return _colored(np.reshape(points, (-1, 3)).astype(float), _grid_triangles(rows, columns), color)


def picture(image: UInt8[np.ndarray, "rows columns 3"], width: float, height: float) -> Mesh:
    """A flat picture in the x-y plane, one square for each pixel: x along the rows, y down, centred at the origin.

    Args:
        image: (rows, columns, 3), RGB.
        width: m.
        height: m.

    Example:
        >>> len(picture(np.zeros((2, 3, 3), np.uint8), 0.3, 0.2).triangles)
        12
    """
    rows, columns = image.shape[:2]
    x, y = np.meshgrid(width * np.linspace(-0.5, 0.5, columns + 1), height * np.linspace(-0.5, 0.5, rows + 1))
    flat = sheet(np.stack([x, y, np.zeros_like(x)], -1), (0.0, 0.0, 0.0))
    return replace(flat, color=np.repeat(image.reshape(-1, 3).astype(np.float32) / 255.0, 2, axis=0))


def _grid_triangles(rows: int, columns: int, closed: bool = False) -> np.ndarray:
    row, column = np.meshgrid(np.arange(rows - 1), np.arange(columns if closed else columns - 1), indexing="ij")
    right = (column + 1) % columns
    a, b, c, d = (
        (r * columns + k).ravel() for r, k in ((row, column), (row, right), (row + 1, right), (row + 1, column))
    )
    return np.stack([np.stack([a, b, c], -1), np.stack([a, c, d], -1)], 1).reshape(-1, 3)


def _colored(vertices: np.ndarray, triangles: np.ndarray, color: Color) -> Mesh:
    # A profile that ends on the axis leaves triangles without area, which a ray tracer would test for nothing.
    a, b, c = (vertices[triangles[:, corner]] for corner in range(3))
    solid = np.linalg.norm(np.cross(b - a, c - a), axis=1) > 0.0
    triangles = triangles[solid].astype(np.int32)
    return Mesh(vertices, triangles, np.tile(np.asarray(color, np.float32), (len(triangles), 1)))


def _rotation_with_z(z: np.ndarray) -> np.ndarray:
    across = np.eye(3)[np.argmin(np.abs(z))]
    x = np.cross(across, z)
    x = x / np.linalg.norm(x)
    return np.column_stack([x, np.cross(z, x), z])

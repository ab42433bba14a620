"""Which points of an object lie under a cloth. Letter: P points."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from jaxtyping import Bool, Float

from eaip_prob.errors import InputError, ShapeError
from eaip_prob.simulation.meshes import Mesh
from eaip_prob.simulation.scene import Part, Scene

_OFFSET = 1e-4  # metres along a ray, above the round-off of float32


def surface_points(mesh: Mesh, count: int, generator: np.random.Generator) -> Float[np.ndarray, "points 3"]:
    """(P, 3), points drawn evenly by area from the triangles of a mesh, m.

    Args:
        mesh: of the object, in its place.
        count: P.
        generator: source of randomness.

    Raises:
        InputError: a count below one.

    Example:
        >>> from eaip_prob.simulation.meshes import box
        >>> points = surface_points(box((2.0, 2.0, 2.0), (1, 1, 1)), 5, np.random.default_rng(0))
        >>> np.abs(points).max(1).tolist()
        [1.0, 1.0, 1.0, 1.0, 1.0]
    """
    if count < 1:
        raise InputError(f"Expected a count of at least 1, got {count}.")
    area = mesh.area()
    face = generator.choice(len(area), size=count, p=area / area.sum())
    share = generator.random((count, 2))
    share = np.where(share.sum(1, keepdims=True) > 1.0, 1.0 - share, share)
    a, b, c = (mesh.vertices[mesh.triangles[face, corner]] for corner in range(3))
    return a + share[:, :1] * (b - a) + share[:, 1:] * (c - a)


def covered_points(
    points: Float[np.ndarray, "points 3"], cloth: Mesh, axis: Sequence[float]
) -> Bool[np.ndarray, "points"]:
    """Whether each point has cloth above it and cloth on its outer side, so that a roof alone covers nothing.

    Rays go straight up, and away from the object's vertical axis at the point's own height.

    Args:
        points: (P, 3), of the object's surface, m; keep those above the height down to which a cover should reach.
        cloth: in its place.
        axis: (x, y) of the object, m.

    Raises:
        ShapeError: points or axis of other shapes.

    Example:
        >>> from eaip_prob.simulation.meshes import box
        >>> points = np.array([[0.1, 0.0, 0.2], [0.9, 0.0, 0.2]])
        >>> covered_points(points, box((1.0, 1.0, 1.0), (1, 1, 1)), (0.0, 0.0)).tolist()
        [True, False]
    """
    if np.ndim(points) != 2 or np.shape(points)[1] != 3 or np.shape(axis) != (2,):
        raise ShapeError(f"Expected points (any, 3) and an axis (x, y), got {np.shape(points)} and {np.shape(axis)}.")
    outwards = np.zeros_like(points, dtype=float)
    outwards[:, :2] = points[:, :2] - np.asarray(axis, float)
    distance = np.linalg.norm(outwards, axis=1, keepdims=True)
    # A point on the axis has no outer side of its own; any will do.
    outwards = np.where(distance > _OFFSET, outwards / np.maximum(distance, _OFFSET), [1.0, 0.0, 0.0])
    scene = Scene([Part("cloth", cloth)])
    return _hit(scene, points, np.broadcast_to([0.0, 0.0, 1.0], points.shape)) & _hit(scene, points, outwards)


def _hit(scene: Scene, points: np.ndarray, directions: np.ndarray) -> np.ndarray:
    rays = np.concatenate([points + _OFFSET * directions, directions], 1).astype(np.float32)
    return np.isfinite(scene.cast(rays)["t_hit"])

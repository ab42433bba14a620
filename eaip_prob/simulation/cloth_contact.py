"""What a cloth rests on: a floor, and the convex hull of an object as half-spaces."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Self

import numpy as np
from jaxtyping import Float

from eaip_prob.errors import InputError, ShapeError
from eaip_prob.simulation.meshes import Mesh

_SAME = 1e-4  # metres: planes that differ by less anywhere on the body are one


@dataclass(frozen=True, eq=False)
class Obstacle:
    """A floor, and a convex body if there are planes.

    The hull stands for the object because thin legs and boards would slip between the vertices of a cloth.

    Args:
        floor: height, m.
        planes: (K, 4), unit normals n outwards and offsets o, m: a point x is in the body where n x <= o for all.

    Raises:
        ShapeError: planes of another shape.
        InputError: numbers that are not finite, or normals whose length is not one.

    Example:
        >>> from eaip_prob.simulation.meshes import box
        >>> cube = Obstacle.around(box((1.0, 1.0, 1.0), (1, 1, 1)), floor=-0.5)
        >>> len(cube.planes), cube.depth(np.array([[0.0, 0.3, 0.0], [0.0, 0.8, 0.0]])).round(9).tolist()
        (6, [0.2, -0.3])
        >>> Obstacle(floor=0.0).depth(np.array([0.0, 0.0, 0.25])).tolist()
        -0.25
    """

    floor: float
    planes: Float[np.ndarray, "planes 4"] = field(default_factory=lambda: np.zeros((0, 4)))

    def __post_init__(self) -> None:
        if np.ndim(self.planes) != 2 or np.shape(self.planes)[1] != 4:
            raise ShapeError(
                f"Expected planes with shape (any, 4), got {np.shape(self.planes)}. Give one row for each."
            )
        if not (np.isfinite(self.floor) and np.isfinite(self.planes).all()):
            raise InputError("Expected floor and planes that are finite, got NaN or infinity. Mend the object's place.")
        if len(self.planes) and np.abs(np.linalg.norm(self.planes[:, :3], axis=1) - 1.0).max() > 1e-6:
            raise InputError("Expected normals of length one in planes, got others. Divide each row by that length.")

    @classmethod
    def around(cls, mesh: Mesh, floor: float) -> Self:
        """The convex hull of a mesh, on a floor.

        Args:
            mesh: placed in the world, not flat, m.
            floor: height, m.

        Raises:
            InputError: a mesh without volume.
        """
        from scipy.spatial import ConvexHull, QhullError

        try:
            hull = ConvexHull(mesh.vertices)
        except QhullError as error:
            size = np.ptp(mesh.extent(), axis=0).round(6).tolist()
            raise InputError(f"Expected an object with a volume, got one of {size} m. Give it a thickness.") from error
        planes = hull.equations * [1.0, 1.0, 1.0, -1.0]  # each triangle of the hull has its own, some of them equal
        heights = planes[:, 3:] - planes[:, :3] @ mesh.vertices[hull.vertices].T
        kept: list[int] = []
        for index, height in enumerate(heights):
            if all(np.abs(height - heights[other]).max() > _SAME for other in kept):
                kept.append(index)
        return cls(floor, planes[kept])

    def depth(self, points: Float[np.ndarray, "*batch 3"]) -> Float[np.ndarray, "*batch"]:
        """How deep points are in the floor or in the body, whichever is deeper, m; below zero outside.

        Args:
            points: (..., 3), m.
        """
        under = self.floor - points[..., 2]
        if not len(self.planes):
            return under
        return np.maximum(under, (self.planes[:, 3] - points @ self.planes[:, :3].T).min(-1))

"""The mesh of a bag: a tube of rings whose last ring is sewn together along its middle, as a bin liner's is.

Letters: V vertices, E edges, F triangles.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from jaxtyping import Float, Int64

from eaip_prob.errors import InputError


@dataclass(frozen=True)
class BagMesh:
    """Vertices, edges and triangles of a bag, and the vertices that four hands hold.

    The first ring is the mouth. It runs from the middle of the robot's side by the robot's right hand, the partner's
    left and the partner's right to the robot's left. The last ring is a seam from the robot's side to the partner's.

    Args:
        perimeter: of the mouth, m.
        length: from the mouth to the seam, m.
        spacing: between neighbours, about, m.

    Raises:
        InputError: lengths not above zero, or a spacing above half of the length or an eighth of the perimeter.

    Example:
        >>> mesh = BagMesh(perimeter=4.0, length=1.0, spacing=0.1)
        >>> mesh.num_columns, mesh.num_rows, mesh.num_vertices, mesh.held(width=1.0).tolist()
        (40, 10, 421, [35, 5, 15, 25])
    """

    perimeter: float
    length: float
    spacing: float

    def __post_init__(self) -> None:
        lengths = {name: getattr(self, name) for name in ("perimeter", "length", "spacing")}
        if not all(0.0 < value < np.inf for value in lengths.values()):
            raise InputError(f"Expected lengths of a bag above zero and finite, got {lengths}.")
        if self.spacing > min(self.length / 2, self.perimeter / 8):
            raise InputError(f"Expected a spacing that leaves two rows and eight columns, got {lengths}. Lower it.")

    @property
    def num_columns(self) -> int:
        """Vertices of a ring."""
        return 2 * round(self.perimeter / (2 * self.spacing))

    @property
    def num_rows(self) -> int:
        """Rings before the seam."""
        return round(self.length / self.spacing)

    @property
    def num_vertices(self) -> int:
        """V, of rings and seam."""
        return self.num_rows * self.num_columns + self.num_columns // 2 + 1

    def held(self, width: float) -> Int64[np.ndarray, "handles"]:
        """(4,), the vertices at the robot's left and right and the partner's left and right hand.

        Args:
            width: of the mouth from the robot's hands to the partner's, m; rounded up to whole spacings.

        Raises:
            InputError: no width, or nothing left between the hands of each.
        """
        half, step = self.num_columns // 2, self.perimeter / self.num_columns
        left = int(np.floor(half - width / step + 1e-9))  # for both folds; rounded down, or the hands would pull
        if not 2 <= left < half:
            raise InputError(
                f"Expected a width of the mouth above zero and up to {(half - 2) * step:.3g} m, got {width:.3g} m. "
                "Bring the hands of the robot and of its partner together or further apart, or change the perimeter."
            )
        near, far = left // 2, left - left // 2
        return np.array([self.num_columns - near, near, half - far, half + far])

    @cached_property
    def grid(self) -> Int64[np.ndarray, "rows columns"]:
        """The vertex of each place, row by row; the last row is the seam, whose vertices are there twice."""
        column = np.arange(self.num_columns)
        rings = np.arange(self.num_rows * self.num_columns).reshape(self.num_rows, self.num_columns)
        return np.vstack([rings, rings.size + np.minimum(column, self.num_columns - column)])

    @cached_property
    def triangles(self) -> Int64[np.ndarray, "faces 3"]:
        """(F, 3), vertices."""
        a, d = self.grid[:-1], self.grid[1:]
        b, c = np.roll(a, -1, 1), np.roll(d, -1, 1)
        falling = np.stack([np.stack([a, b, c], -1), np.stack([a, c, d], -1)], 2)
        rising = np.stack([np.stack([a, b, d], -1), np.stack([b, c, d], -1)], 2)
        return np.where(self._rising[..., None, None], rising, falling).reshape(-1, 3)

    @cached_property
    def edges(self) -> tuple[Int64[np.ndarray, "edges 2"], Float[np.ndarray, "edges"]]:
        """(E, 2) vertices and (E,) lengths at rest, m; neighbours in the list share no vertex, for speed."""
        across, down = self.perimeter / self.num_columns, self.length / self.num_rows
        a, d = self.grid[:-1], self.grid[1:]
        b, c = np.roll(a, -1, 1), np.roll(d, -1, 1)
        along = np.stack([a, b], -1)
        seam = np.stack([d[-1], c[-1]], -1)[: self.num_columns // 2]
        diagonal = np.where(self._rising[..., None], np.stack([b, d], -1), np.stack([a, c], -1))
        families = [(np.stack([a, d], -1), down), (along[:, 0::2], across), (along[:, 1::2], across)]
        families += [(seam, across), (diagonal, np.hypot(across, down))]
        pairs = [family.reshape(-1, 2) for family, _ in families]
        rest = [np.full(len(some), size) for some, (_, size) in zip(pairs, families, strict=True)]
        return np.concatenate(pairs), np.concatenate(rest)

    @property
    def _rising(self) -> np.ndarray:
        # Diagonals change direction from place to place, so that the cloth prefers none.
        return np.add.outer(np.arange(self.num_rows), np.arange(self.num_columns)) % 2 == 1

    def straight(
        self, handles: Float[np.ndarray, "handles 3"], held: Int64[np.ndarray, "handles"]
    ) -> Float[np.ndarray, "vertices 3"]:
        """(V, 3): the mouth in straight lines between the handles, and the bag at right angles to it, m.

        Args:
            handles: (4, 3), robot's left and right, partner's left and right hand, m.
            held: (4,), their vertices.
        """
        across = np.cross(handles[2] - handles[0], handles[3] - handles[1])
        away = across / max(float(np.linalg.norm(across)), 1e-9)
        # The mouth from the robot's right hand round to it again.
        ends, corners = [*held[1:], held[0], held[1] + self.num_columns], handles[[1, 2, 3, 0, 1]]
        column = np.arange(self.num_columns)
        column = np.where(column < held[1], column + self.num_columns, column)
        mouth = np.stack([np.interp(column, ends, corners[:, k]) for k in range(3)], -1)
        rows = np.arange(self.num_rows)[:, None, None] * (self.length / self.num_rows)
        seam = np.arange(self.num_columns // 2 + 1)
        return np.concatenate(
            [(mouth + rows * away).reshape(-1, 3), (mouth[seam] + mouth[-seam]) / 2 + self.length * away]
        )

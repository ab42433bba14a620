"""Upright boxes around points, how far off their faces are, and clusters of points on a grid.

What one view gets wrong of a face was measured on rendered Kinect frames with noise: the four training objects, 20
placements each, nothing before them, the true 2-D box, the right camera of the rig at about 2 m (root mean square):

==================  ============  ============  =====
towards the camera  sideways      away from it  top
==================  ============  ============  =====
5 mm                7 and 11 mm   25 mm         7 mm
==================  ============  ============  =====

`FACE_STD` and `HIDDEN_STD` follow these, with some more for feet so thin that pixels miss them. With three cameras,
boxes of the trained detector and a bag at the feet (the 40 demonstrations of the bag task, three looks each), the mean
squared Mahalanobis distance of a place is 0.9 for each of its six numbers, where 1 is expected: 0.4 for the bookshelf
to 2.1 for the stepladder. For four other pieces (36 looks) it is 0.3.

Where the box reaches farther than the points, what lies between is unknown and adds to the face on that side.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float, Int

FACE_STD = 0.012  # metres
HIDDEN_STD = 0.030  # metres, of a face that looks away from the camera
TANGLED_STD = 0.06  # metres, of every side where something else hangs together with the object
TANGLED_TOP_STD = 0.18  # metres, of the top then: a bag is above what it covers
TOUCHED_STD = 0.05  # metres, of every side where something that touches the object was told from it
_STEPS = np.array([step for step in np.ndindex(3, 3, 3) if step > (1, 1, 1)]) - 1  # to half of the voxels around one
_LEAST_STEEP = 0.3  # sine; a flatter view hardly shows the top, whose rear edge is the hidden face's


@dataclass(frozen=True, eq=False)
class UprightBox:
    """A box whose edges run along the world's axes.

    Args:
        place: (6,), centre and edge lengths, m.
        covariance: (6, 6), of both, m^2.

    Example:
        >>> box = UprightBox.between(np.zeros(3), np.ones(3), np.zeros(3), np.array([0.2, 0.0, 0.0]))
        >>> box.place[3:].tolist(), box.covariance[0, [0, 3]].round(3).tolist()  # the far face alone is uncertain
        ([1.0, 1.0, 1.0], [0.01, 0.02])
    """

    place: Float[np.ndarray, "6"]
    covariance: Float[np.ndarray, "6 6"]

    @classmethod
    def between(
        cls,
        low: Float[np.ndarray, "3"],
        high: Float[np.ndarray, "3"],
        low_std: Float[np.ndarray, "3"],
        high_std: Float[np.ndarray, "3"],
    ) -> UprightBox:
        """The box between two corners whose six faces are off independently.

        Args:
            low: (3,), smallest coordinates, m.
            high: (3,), largest coordinates, m.
            low_std: (3,), standard deviations of the smallest, m.
            high_std: (3,), standard deviations of the largest, m.
        """
        eye = np.eye(3)
        place_from_faces = np.block([[eye / 2.0, eye / 2.0], [-eye, eye]])
        faces, variance = np.concatenate([low, high]), np.concatenate([low_std, high_std]) ** 2
        return cls(place_from_faces @ faces, (place_from_faces * variance) @ place_from_faces.T)


class VoxelGrid:
    """Points on a grid of voxels; those that touch, also at a corner, hang together.

    Much faster than clusters by distance, which is what a detector needs for every frame.

    Args:
        points: (N, 3), m.
        voxel: edge of a voxel, m.
        least: points without which a voxel counts as empty.

    Attributes:
        low: (K,), height of the lower side of each voxel, m.

    Example:
        >>> points = np.repeat([[0.0, 0.0, 0.0], [0.04, 0.04, 0.0], [1.0, 0.0, 0.0], [5.0, 0.0, 0.0]], [9, 9, 9, 1], 0)
        >>> VoxelGrid(points).clusters()[[0, 9, 18, 27]].tolist()
        [0, 0, 1, -1]
    """

    def __init__(self, points: Float[np.ndarray, "points 3"], voxel: float = 0.04, least: int = 3) -> None:
        lowest = points.min(0) if len(points) else np.zeros(3)
        # An empty rim around the grid, so that no step leads from one of its sides to the other.
        cells = np.floor((points - lowest) / voxel).astype(np.int64) + 1
        grid = tuple(int(cells[:, axis].max(initial=1)) + 2 for axis in range(3))
        places, self._voxel_of, count = np.unique(
            np.ravel_multi_index(tuple(cells.T), grid), return_inverse=True, return_counts=True
        )
        self._full = count >= least
        _, _, level = np.unravel_index(places, grid)
        self.low = lowest[2] + voxel * (level - 1.0)
        steps = np.asarray(np.ravel_multi_index(tuple(_STEPS.T + 1), grid)) - np.ravel_multi_index((1, 1, 1), grid)
        beside = places + steps[:, None]
        found = np.minimum(np.searchsorted(places, beside), max(len(places) - 1, 0))
        step, here = np.nonzero(places[found] == beside)
        self._links = np.stack([here, found[step, here]])

    def clusters(self, chosen: Bool[np.ndarray, "voxels"] | None = None) -> Int[np.ndarray, "points"]:
        """Number of the cluster of every point, -1 for those in none.

        Args:
            chosen: (K,), voxels that count; the others are as if empty.
        """
        from scipy.sparse import coo_array
        from scipy.sparse.csgraph import connected_components

        full = self._full if chosen is None else self._full & chosen
        labels = np.full(len(full), -1)
        if full.any():
            one, other = self._links[:, full[self._links].all(0)]
            linked = coo_array((np.ones(len(one), bool), (one, other)), shape=(len(full), len(full)))
            labels[full] = np.unique(connected_components(linked, directed=False)[1][full], return_inverse=True)[1]
        return labels[self._voxel_of]


def seen_box(
    points: Float[np.ndarray, "points 3"],
    missing: Float[np.ndarray, "4"],
    poses: Sequence[Float[np.ndarray, "4 4"]],
    floor: float | None,
    tangled: bool = False,
    touched: bool = False,
) -> UprightBox:
    """The box around what cameras see of an object, down to the floor.

    Args:
        points: (N, 3), on the object, in the world, m; more than three.
        missing: (4,), how much farther than the points the detector's box reaches to the left, top, right and bottom, m
            at the object's distance.
        poses: T_world_camera of each camera, the first of that with the detector's box.
        floor: its height, m; None where it was not seen.
        tangled: whether something that the box cuts off hangs together with the object.
        touched: whether something beside the object was told from it by a gap only, or in its upper part only.

    Example:
        >>> points = np.random.default_rng(0).uniform(-0.5, 0.5, (999, 3))
        >>> camera = np.eye(4)
        >>> camera[:3] = [[0, 0, 1, -2], [-1, 0, 0, 0], [0, -1, 0, 0]]  # looks along x
        >>> box = seen_box(points, np.zeros(4), [camera], -0.5)
        >>> box.place[3:].round(1).tolist(), bool(box.covariance[3, 3] > 4 * box.covariance[4, 4])
        ([1.0, 1.0, 1.0], True)
    """
    ordered = np.partition(points, (2, len(points) - 3), axis=0)
    low, high = ordered[2].copy(), ordered[-3].copy()
    views, steep = zip(*(_view(points, pose) for pose in poses), strict=True)
    hidden, right = np.hypot(HIDDEN_STD, missing[1] / max(steep[0], _LEAST_STEEP)), poses[0][:3, 0]
    every = np.array([FACE_STD, TANGLED_STD * tangled, TOUCHED_STD * touched])
    std = []
    for sign in (-1.0, 1.0):
        # Which face the sides of the image belong to depends on where its right is.
        across = np.maximum(-sign * right, 0.0) * missing[0] + np.maximum(sign * right, 0.0) * missing[2]
        away = np.maximum(sign * np.array(views), 0.0).min(0)
        std.append(np.sqrt((every**2).sum() + (away * hidden) ** 2 + across**2))
    std[0][2] = np.hypot(FACE_STD, missing[3])
    std[1][2] = np.sqrt(FACE_STD**2 + missing[1] ** 2 + (TANGLED_TOP_STD * tangled) ** 2)
    if floor is not None:
        low[2], std[0][2] = floor, FACE_STD
    return UprightBox.between(low, high, *std)


def _view(points: np.ndarray, pose: np.ndarray) -> tuple[Float[np.ndarray, "3"], float]:
    """(horizontal direction in which a camera sees points, sine of how steeply it looks down on them)."""
    view = points.mean(0) - pose[:3, 3]
    steep = abs(float(view[2])) / float(np.linalg.norm(view))
    view[2] = 0.0
    return view / max(float(np.linalg.norm(view)), 1e-9), steep

"""Upright boxes around points, how far off their faces are, and clusters of points on a grid.

What one view gets wrong of a face was measured on rendered Kinect frames with noise: the four training objects, 20
placements each, nothing before them, the true 2-D box, the right camera of the rig at about 2 m (root mean square):

==================  ============  ============  =====
towards the camera  sideways      away from it  top
==================  ============  ============  =====
5 mm                7 and 11 mm   25 mm         7 mm
==================  ============  ============  =====

`FACE_STD` and `HIDDEN_STD` follow these. On other placements of the same objects, 12 each, with boxes that are 3 % off,
the mean squared Mahalanobis distance of a place is 0.76 for each of its six numbers, where 1 is expected.

Where the box reaches farther than the points, what lies between is unknown and adds to the face on that side.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int

FACE_STD = 0.008  # metres
HIDDEN_STD = 0.030  # metres, of a face that looks away from the camera
TANGLED_STD = 0.06  # metres, of every side where something else hangs together with the object
TANGLED_TOP_STD = 0.18  # metres, of the top then: a bag is above what it covers
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


def voxel_clusters(
    points: Float[np.ndarray, "points 3"], voxel: float = 0.04, least: int = 3
) -> Int[np.ndarray, "points"]:
    """Number of the cluster of every point, -1 for those in none: voxels that touch, also at a corner, hang together.

    Much faster than clusters by distance, which is what a detector needs for every frame.

    Args:
        points: (N, 3), m.
        voxel: edge of a voxel, m.
        least: points without which a voxel counts as empty.

    Example:
        >>> points = np.repeat([[0.0, 0.0, 0.0], [0.04, 0.04, 0.0], [1.0, 0.0, 0.0], [5.0, 0.0, 0.0]], [9, 9, 9, 1], 0)
        >>> voxel_clusters(points)[[0, 9, 18, 27]].tolist()
        [0, 0, 1, -1]
    """
    from scipy.sparse import coo_array
    from scipy.sparse.csgraph import connected_components
    from scipy.spatial import KDTree

    if not len(points):
        return np.zeros(0, np.int64)
    cells = np.floor((points - points.min(0)) / voxel).astype(np.int64)
    keys, key, count = np.unique(
        np.ravel_multi_index(tuple(cells.T), tuple(cells.max(0) + 1)), return_inverse=True, return_counts=True
    )
    full, labels = np.flatnonzero(count >= least), np.full(len(keys), -1)
    if len(full):
        places = np.column_stack(np.unravel_index(keys[full], tuple(cells.max(0) + 1)))
        pairs = KDTree(places).query_pairs(1.8, output_type="ndarray")  # sqrt(3) is across a corner
        linked = coo_array((np.ones(len(pairs), bool), (pairs[:, 0], pairs[:, 1])), shape=(len(full), len(full)))
        labels[full] = connected_components(linked, directed=False)[1]
    return labels[key]


def one_view_box(
    points: Float[np.ndarray, "points 3"],
    missing: Float[np.ndarray, "4"],
    T_world_camera: Float[np.ndarray, "4 4"],
    floor: float | None,
    tangled: bool,
) -> UprightBox:
    """The box around what one camera sees of an object, down to the floor.

    Args:
        points: (N, 3), on the object, in the world, m; more than three.
        missing: (4,), how much farther than the points the detector's box reaches to the left, top, right and bottom, m
            at the object's distance.
        T_world_camera: (4, 4), of the camera.
        floor: its height, m; None where it was not seen.
        tangled: whether something that the box cuts off hangs together with the object.

    Example:
        >>> points = np.random.default_rng(0).uniform(-0.5, 0.5, (999, 3))
        >>> camera = np.eye(4)
        >>> camera[:3] = [[0, 0, 1, -2], [-1, 0, 0, 0], [0, -1, 0, 0]]  # looks along x
        >>> box = one_view_box(points, np.zeros(4), camera, -0.5, False)
        >>> box.place[3:].round(1).tolist(), bool(box.covariance[3, 3] > 4 * box.covariance[4, 4])
        ([1.0, 1.0, 1.0], True)
    """
    ordered = np.partition(points, (2, len(points) - 3), axis=0)
    low, high = ordered[2].copy(), ordered[-3].copy()
    view = points.mean(0) - T_world_camera[:3, 3]
    steep = abs(float(view[2])) / float(np.linalg.norm(view))
    view[2] = 0.0
    view /= max(float(np.linalg.norm(view)), 1e-9)
    right = T_world_camera[:3, 0]
    hidden = np.hypot(HIDDEN_STD, missing[1] / max(steep, _LEAST_STEEP))
    beside = np.array([FACE_STD, TANGLED_STD * tangled])
    std = []
    for sign in (-1.0, 1.0):
        # Which face the sides of the image belong to depends on where its right is.
        across = np.maximum(-sign * right, 0.0) * missing[0] + np.maximum(sign * right, 0.0) * missing[2]
        std.append(np.sqrt((beside**2).sum() + (np.maximum(sign * view, 0.0) * hidden) ** 2 + across**2))
    std[0][2] = np.hypot(FACE_STD, missing[3])
    std[1][2] = np.sqrt(FACE_STD**2 + missing[1] ** 2 + (TANGLED_TOP_STD * tangled) ** 2)
    if floor is not None:
        low[2], std[0][2] = floor, FACE_STD
    return UprightBox.between(low, high, *std)

"""Whether two calibrated cameras still agree, from what both see: a check, never a calibration.

Coloured ICP (Park, Zhou and Koltun, "Colored Point Cloud Registration Revisited", ICCV 2017) finds the motion that lays
one cloud on the other. It is off by millimetres itself where cameras see opposite sides of thin things, so that its
result says when to calibrate again and is never written over a calibration.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, UInt8
from scipy.spatial.transform import Rotation

from eaip_prob.errors import InputError, ShapeError
from eaip_prob.perception.extrinsics import PoseError

_VOXELS = (0.04, 0.02, 0.01)  # metres, coarse to fine
_LEAST_POINTS = 200
# Good cameras on opposite sides of a bookshelf are told to be apart by 3 mm and 0.2 degrees.
_TOLERANCE = PoseError(0.008, float(np.radians(0.5)))
_LEAST_OVERLAP = 0.3  # share of one cloud that finds a partner in the other


@dataclass(frozen=True)
class Drift:
    """How far two clouds of one scene are apart.

    Args:
        error: of the points' centre (m), and the rotation (rad).
        overlap: share of the first cloud's points that have a partner in the second, 0 to 1.

    Example:
        >>> Drift(PoseError(0.002, 0.0), overlap=0.8).needs_calibration
        False
    """

    error: PoseError
    overlap: float

    @property
    def needs_calibration(self) -> bool:
        """Whether the clouds are farther apart than the check itself may be wrong: 8 mm or 0.5 degrees."""
        return self.error.position > _TOLERANCE.position or self.error.rotation > _TOLERANCE.rotation


def drift(
    points_a: Float[np.ndarray, "points_a 3"],
    colors_a: UInt8[np.ndarray, "points_a 3"],
    points_b: Float[np.ndarray, "points_b 3"],
    colors_b: UInt8[np.ndarray, "points_b 3"],
) -> Drift:
    """How far the clouds of two cameras are apart that should lie on each other, by coloured ICP.

    Args:
        points_a: of one camera, in the world, m.
        colors_a: RGB of each point.
        points_b: of the other camera, in the world, m.
        colors_b: RGB of each point.

    Raises:
        ShapeError: not one colour for each point.
        InputError: too few points, points that are not finite, or clouds that hardly overlap.

    Example:
        >>> rng = np.random.default_rng(1)
        >>> x, y = rng.uniform(0.0, 1.0, (2, 30000))
        >>> points = np.column_stack([x, y, 0.1 * np.sin(9 * x) * np.cos(7 * y)])
        >>> colors = np.column_stack([127 + 120 * np.sin(20 * x), 127 + 120 * np.cos(15 * y), 90 + 0 * x])
        >>> colors = colors.astype(np.uint8)
        >>> moved = drift(points, colors, points + (0.004, 0.0, 0.0), colors)
        >>> bool(abs(moved.error.millimetres - 4.0) < 0.5)
        True
    """
    for name, points, colors in (("a", points_a, colors_a), ("b", points_b, colors_b)):
        _check_cloud(name, points, colors)
    import open3d as o3d

    registration = o3d.pipelines.registration
    motion, overlap = np.eye(4), 0.0
    for voxel in _VOXELS:
        clouds = [_cloud(o3d, points_a, colors_a, voxel), _cloud(o3d, points_b, colors_b, voxel)]
        # open3d's ICP fails with an untyped error where nothing is near
        _check_overlap(registration.evaluate_registration(*clouds, 1.5 * voxel, motion).fitness, voxel)
        found = registration.registration_colored_icp(*clouds, 1.5 * voxel, motion)
        motion, overlap = np.array(found.transformation), float(found.fitness)
    _check_overlap(overlap, _VOXELS[-1])
    centre = points_a.mean(0)
    moved = motion[:3, :3] @ centre + motion[:3, 3] - centre
    angle = float(Rotation.from_matrix(motion[:3, :3]).magnitude())
    return Drift(PoseError(float(np.linalg.norm(moved)), angle), overlap)


def _cloud(o3d, points: np.ndarray, colors: np.ndarray, voxel: float):
    cloud = o3d.geometry.PointCloud(o3d.utility.Vector3dVector(np.ascontiguousarray(points, dtype=float)))
    cloud.colors = o3d.utility.Vector3dVector(colors / 255.0)
    cloud = cloud.voxel_down_sample(voxel)
    cloud.estimate_normals(o3d.geometry.KDTreeSearchParamHybrid(radius=3.0 * voxel, max_nn=30))
    return cloud


def _check_overlap(overlap: float, voxel: float) -> None:
    if overlap < _LEAST_OVERLAP:
        raise InputError(
            f"Expected clouds of one scene, got {overlap:.0%} of their points within {1.5 * voxel:.3f} m of each "
            "other. Give what both cameras see, or calibrate again."
        )


def _check_cloud(name: str, points: np.ndarray, colors: np.ndarray) -> None:
    if np.ndim(points) != 2 or np.shape(points)[1] != 3 or np.shape(colors) != np.shape(points):
        raise ShapeError(
            f"Expected points_{name} (P, 3) and a colour for each, got {np.shape(points)} and {np.shape(colors)}."
        )
    if len(points) < _LEAST_POINTS or not np.isfinite(points).all():
        raise InputError(f"Expected {_LEAST_POINTS} or more finite points in points_{name}, got {len(points)}.")

"""One cloud of points, in the robot's frame, from the frames of several cameras.

Points are merged in voxels found by integer keys in a hash table: a tenth of the time of open3d's filter. What open3d
does well, outliers and clusters, is done by it, on demand.
"""

from __future__ import annotations

import os
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from typing import Any

import numpy as np
from jaxtyping import Bool, Float, Int, UInt8

from eaip_prob.data.frames import RGBDFrame
from eaip_prob.errors import InputError, ShapeError
from eaip_prob.perception._fusing import HALF, crop_points, merge_voxels
from eaip_prob.perception.glove_offset import depth_sigma
from eaip_prob.perception.registration import colors_of

HALF_FRAME = 1.0 / 60.0  # seconds, of a Kinect
Crop = tuple[tuple[float, float], tuple[float, float], tuple[float, float]]
_Seen = tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]  # points, colours, whether they have one, weights


@dataclass(frozen=True, eq=False)
class PointCloud:
    """Points with their colour and how well they are known.

    Args:
        points: (N, 3), in the world, m.
        colors: (N, 3), RGB; black where no colour camera saw the point.
        variance: (N,), of a point along the line of sight, from the noise of the depth alone, m^2.

    Raises:
        ShapeError: numbers of points, colours and variances that differ.

    Example:
        >>> cloud = PointCloud(np.zeros((2, 3)), np.zeros((2, 3), dtype=np.uint8), np.full(2, 1e-6))
        >>> len(cloud)
        2
    """

    points: Float[np.ndarray, "points 3"]
    colors: UInt8[np.ndarray, "points 3"]
    variance: Float[np.ndarray, "points"]

    def __post_init__(self) -> None:
        count = len(self.points)
        if np.shape(self.points) != (count, 3) or np.shape(self.colors) != (count, 3):
            raise ShapeError(
                f"Expected points and colors with shape (N, 3), got {np.shape(self.points)} and "
                f"{np.shape(self.colors)}. Give one colour for every point."
            )
        if np.shape(self.variance) != (count,):
            raise ShapeError(f"Expected variance with shape ({count},), got {np.shape(self.variance)}.")

    def __len__(self) -> int:
        return len(self.points)

    def select(self, index: np.ndarray) -> PointCloud:
        """Some of the points.

        Args:
            index: places, or a mask (N,).
        """
        return PointCloud(self.points[index], self.colors[index], self.variance[index])


def fuse(
    frames: Sequence[RGBDFrame], crop: Crop | None = None, voxel: float = 0.01, apart: float = HALF_FRAME
) -> PointCloud:
    """What all cameras see, one point for every voxel that holds any.

    A voxel's point is the mean of its points, weighted by one over the variance of their depth; its variance is that of
    this mean for independent noise. Colours are averaged over the points that have one.

    Args:
        frames: of one moment.
        crop: (lowest, highest) along x, y and z in the world, m; default everything.
        voxel: edge, m.
        apart: most by which time stamps may differ, s; what moves is in two places in frames that differ by more.

    Raises:
        InputError: no frame, a voxel not above zero, frames of different times, or points a million voxels from the
            origin.

    Example:
        >>> from eaip_prob.data import Intrinsics
        >>> camera = Intrinsics(4, 3, 4.0, 4.0, 1.5, 1.0)
        >>> depth = np.full((3, 4), 2.0, dtype=np.float32)
        >>> color = np.full((3, 4, 3), 90, dtype=np.uint8)
        >>> frame = RGBDFrame(color, depth, depth > 0, camera, T_world_camera=np.eye(4), time=0.0)
        >>> len(fuse([frame, frame])), len(fuse([frame], crop=((-9.0, 0.0), (-9.0, 9.0), (-9.0, 9.0))))
        (12, 6)
    """
    if not frames or not voxel > 0:
        raise InputError(f"Expected at least one frame and a voxel above zero, got {len(frames)} frames, {voxel} m.")
    _check_moment(frames, apart)
    bounds = _bounds(crop)
    # the compiled loops release the interpreter
    with ThreadPoolExecutor(min(max(len(frames), 2), os.cpu_count() or 1)) as pool:
        parts = list(pool.map(lambda frame: _cropped(frame, bounds), frames))
        _check_near(parts, voxel)
        halves = list(pool.map(lambda half: _merged(parts, voxel, half), (0, 1)))
    points, colors, variance = (np.concatenate(arrays) for arrays in zip(*halves, strict=True))
    return PointCloud(points, colors, variance)


def _check_moment(frames: Sequence[RGBDFrame], apart: float) -> None:
    early, late = min(frames, key=lambda frame: frame.time), max(frames, key=lambda frame: frame.time)
    if late.time - early.time > apart:
        raise InputError(
            f"Expected frames of one moment, at most {apart:.3f} s apart, got {early.name!r} at {early.time:.3f} s and "
            f"{late.name!r} at {late.time:.3f} s. Leave out the late one, set the cameras' clocks, or allow more with "
            "apart=SECONDS."
        )


def _bounds(crop: Crop | None) -> np.ndarray:
    bounds = np.array([(-np.inf, np.inf)] * 3 if crop is None else crop, dtype=float)
    if bounds.shape != (3, 2) or not (bounds[:, 0] < bounds[:, 1]).all():
        raise InputError(f"Expected crop as (lowest, highest) along x, y and z, got {crop}.")
    return bounds


def _cropped(frame: RGBDFrame, bounds: np.ndarray) -> _Seen:
    points, places = np.empty((frame.depth.size + 1, 3)), np.empty(frame.depth.size, np.int64)
    depth, valid = np.ascontiguousarray(frame.depth), np.ascontiguousarray(frame.valid)
    pose = np.ascontiguousarray(frame.T_world_camera[:3], dtype=float)
    count = crop_points(depth, valid, frame.intrinsics.rays, pose, bounds, points, places)
    at = places[:count]
    color, seen = colors_of(frame, at)
    weight = 1.0 / depth_sigma(depth.reshape(-1)[at].astype(float)) ** 2
    return points[:count], color, seen, weight


def _check_near(parts: Sequence[_Seen], voxel: float) -> None:
    limit = voxel * HALF
    if any(len(points) and max(points.max(), -points.min()) >= limit for points, *_ in parts):
        raise InputError(f"Expected points within {HALF} voxels of the origin. Crop the space, or use larger voxels.")


def _merged(parts: Sequence[_Seen], voxel: float, half: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Points, colours and variances of one half of the voxels, those whose key says so."""
    total = sum(len(part[0]) for part in parts)
    table = np.full((2 ** total.bit_length(), 2), -1, np.int64)  # as small as it can be: it has to stay in the cache
    sums, count = np.zeros((total, 8)), 0
    for points, colors, seen, weight in parts:
        count = merge_voxels(points, colors, seen, weight, voxel, table, sums, count, half)
    sums = sums[:count]
    color = np.rint(sums[:, 4:7] / np.maximum(sums[:, 7:], 1.0)).astype(np.uint8)
    return sums[:, :3] / sums[:, 3:4], color, 1.0 / sums[:, 3]


def to_open3d(cloud: PointCloud) -> Any:
    """An `open3d.geometry.PointCloud` with the same points and colours.

    Args:
        cloud: points, m.

    Example:
        >>> cloud = PointCloud(np.ones((1, 3)), np.full((1, 3), 51, dtype=np.uint8), np.ones(1))
        >>> np.asarray(to_open3d(cloud).colors).round(3).tolist()
        [[0.2, 0.2, 0.2]]
    """
    import open3d

    made = open3d.geometry.PointCloud(open3d.utility.Vector3dVector(np.asarray(cloud.points, dtype=float)))
    made.colors = open3d.utility.Vector3dVector(cloud.colors / 255.0)
    return made


def from_open3d(cloud: Any, variance: float) -> PointCloud:
    """The points and colours of an `open3d.geometry.PointCloud`.

    Args:
        cloud: open3d's, m; black where it has no colours.
        variance: of each point, which open3d does not keep, m^2.

    Example:
        >>> cloud = PointCloud(np.ones((1, 3)), np.full((1, 3), 51, dtype=np.uint8), np.ones(1))
        >>> from_open3d(to_open3d(cloud), variance=1e-6).colors.tolist()
        [[51, 51, 51]]
    """
    points = np.array(cloud.points)
    colors = np.array(cloud.colors) if cloud.has_colors() else np.zeros_like(points)
    return PointCloud(points, np.rint(255.0 * colors).astype(np.uint8), np.full(len(points), float(variance)))


def inliers(cloud: PointCloud, neighbors: int = 20, ratio: float = 2.0) -> Bool[np.ndarray, "points"]:
    """Points that are no farther from their neighbours than usual (open3d's statistical filter).

    Args:
        cloud: points, m.
        neighbors: how many of the nearest are looked at.
        ratio: standard deviations above the mean distance from which a point is an outlier.

    Example:
        >>> points = np.vstack([np.random.default_rng(0).uniform(size=(99, 3)), [[50.0, 0.0, 0.0]]])
        >>> inliers(PointCloud(points, np.zeros((100, 3), dtype=np.uint8), np.ones(100))).sum()
        np.int64(99)
    """
    kept = np.zeros(len(cloud), dtype=bool)
    if len(cloud):
        kept[to_open3d(cloud).remove_statistical_outlier(neighbors, ratio)[1]] = True
    return kept


def clusters(cloud: PointCloud, distance: float = 0.03, least: int = 10) -> Int[np.ndarray, "points"]:
    """Number of the cluster of every point, -1 for those in none (DBSCAN, by open3d).

    Args:
        cloud: points, m.
        distance: between neighbours, m.
        least: neighbours that a point inside a cluster has.

    Example:
        >>> points = np.repeat([[0.0, 0.0, 0.0], [1.0, 0.0, 0.0]], 12, axis=0)
        >>> clusters(PointCloud(points, np.zeros((24, 3), dtype=np.uint8), np.ones(24)))[[0, -1]].tolist()
        [0, 1]
    """
    if not len(cloud):
        return np.zeros(0, dtype=np.int32)
    return np.asarray(to_open3d(cloud).cluster_dbscan(distance, least))

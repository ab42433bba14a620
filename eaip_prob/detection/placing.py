"""Where in the world what a detector has found stands, from the depth inside its box.

Depth points are projected into the colour image; those near the box are taken, the floor is cut away, and what remains
falls apart into clusters. A cluster is of the object if it stands on the floor and lies in the box for the most part,
or hangs in the air and lies in the box as a whole: arms, a bag, and what is seen behind the object do not.

One view shows the front of an object and its top. What is hidden is not made up: the face that looks away is where the
last point was seen, and its standard deviation says how far off that is (`eaip_prob.detection.placing_box`).
"""

from __future__ import annotations

import numpy as np
from jaxtyping import Bool, Float, Int

from eaip_prob.data.frames import RGBDFrame
from eaip_prob.detection.base import Detections
from eaip_prob.detection.placing_box import UprightBox, one_view_box, voxel_clusters
from eaip_prob.errors import ShapeError

FLOOR_MARGIN = 0.015  # metres above the floor up to which points are its own
STANDING = 0.15  # metres above the floor within which the lowest point of what stands on it is seen
_AROUND = 1.3  # sizes of the box within which points are looked at
_INSIDE = 1.06  # sizes of the box that count as the box, which a detector gets a little wrong
_SHARES = {"stands": 0.5, "hangs": 0.9}  # of a cluster that lies in the box, if it is of the object
_WHOLE = 0.98  # share of the clusters below which the box cuts something off
_GAP = 0.10  # metres, along x and y, between the parts of an object
_LEAST_PART, _LEAST = 20, 60  # points of a part and of an object; fewer say too little
_ALLOWED = 0.03  # share of its size by which the box may reach beyond the points
_FLOOR_CELL = 0.02  # metres; resolution of heights among which the floor is sought
_FLOOR_SHARE = 0.04  # of all points that lie within one such cell, if it is the floor
_STEP, _NEIGHBOURS = 5.5, 3  # widths of a pixel between neighbours on a surface, and how many a pixel has at least
CLUSTER_VOXEL, CLUSTER_PIXELS = 0.04, 7.0  # metres, and widths of a pixel, of which the larger is a voxel of clusters


def placed(detections: Detections, frame: RGBDFrame, floor: float | None = None) -> Detections:
    """The detections with their place in the world and its covariance; NaN where depth does not show the object.

    Args:
        detections: in the colour image of the frame.
        frame: with the depth.
        floor: height of the floor in the world, m; None to find it in the frame (`floor_height`).

    Raises:
        ShapeError: boxes in an image of another size.

    Example:
        >>> from eaip_prob.data.frames import Intrinsics
        >>> camera, far = Intrinsics(4, 3, 4.0, 4.0, 1.5, 1.0), np.zeros((3, 4), np.float32)
        >>> frame = RGBDFrame(np.zeros((3, 4, 3), np.uint8), far, far > 0, camera, np.eye(4), 0.0)
        >>> found = Detections(("chair",), np.array([0.9]), np.array([[2.0, 1.0, 2.0, 2.0]]), (4, 3))
        >>> bool(np.isnan(placed(found, frame).place).all())
        True
    """
    size = (frame.color.shape[1], frame.color.shape[0])
    if tuple(detections.image_size) != size:
        raise ShapeError(f"Expected boxes in the frame's image of {size} px, got {detections.image_size}.")
    place, covariance = np.full((len(detections), 6), np.nan), np.full((len(detections), 6, 6), np.nan)
    if len(detections):
        points, pixels = _points_and_pixels(frame)
        floor = floor_height(points) if floor is None else floor
        for index, box in enumerate(detections.box):
            found = _place(points, pixels, box, floor, frame)
            if found is not None:
                place[index], covariance[index] = found.place, found.covariance
    known = {name: getattr(detections, name) for name in ("labels", "score", "box", "image_size", "box_covariance")}
    return Detections(**known, place=place, place_covariance=covariance)


def floor_height(points: Float[np.ndarray, "points 3"]) -> float | None:
    """Height of the lowest horizontal plane, m; None where there is none.

    That is the lowest of the heights at which 4 % of all points lie within 2 cm, and no fewer than above or below it.

    Args:
        points: (N, 3), in the world, m.

    Example:
        >>> x, y = np.meshgrid(np.arange(9.0), np.arange(9.0))
        >>> table = np.column_stack([x.ravel(), y.ravel(), np.full(81, 0.7)])
        >>> round(floor_height(np.concatenate([table - [0.0, 0.0, 1.6], table])), 3)
        -0.9
    """
    if not len(points):
        return None
    height = points[:, 2]
    count = np.bincount(np.floor((height - height.min()) / _FLOOR_CELL).astype(int))
    beside = np.maximum(np.append(count[1:], 0), np.insert(count[:-1], 0, 0))
    peaks = np.flatnonzero((count >= beside) & (count >= _FLOOR_SHARE * len(points)))
    if not len(peaks):
        return None
    middle = height.min() + (peaks[0] + 0.5) * _FLOOR_CELL
    return float(np.median(height[np.abs(height - middle) < 1.5 * _FLOOR_CELL]))


def joined_parts(
    parts: list[Int[np.ndarray, "members"]], points: Float[np.ndarray, "points 3"], least: int = _LEAST_PART
) -> Int[np.ndarray, "members"]:
    """The largest part and all parts above, below or close beside it: what hides a stretch of an object cuts it in two.

    Args:
        parts: of each, which points.
        points: (N, 3), m.
        least: points of a part that counts.

    Example:
        >>> points = np.array([[0.0, 0, 0], [0.2, 0.2, 0.0], [0.1, 0.1, 0.9], [2.0, 0, 0]])
        >>> joined_parts([np.array([2]), np.array([0, 1]), np.array([3])], points, least=1).tolist()
        [0, 1, 2]
    """
    parts = sorted((part for part in parts if len(part) >= least), key=len, reverse=True)
    if not parts:
        return np.zeros(0, np.int64)
    low, high = points[parts[0], :2].min(0), points[parts[0], :2].max(0)
    taken = parts[:1]
    for part in parts[1:]:
        here = points[part, :2]
        if (np.maximum(low - here.max(0), here.min(0) - high) <= _GAP).all():
            taken.append(part)
            low, high = np.minimum(low, here.min(0)), np.maximum(high, here.max(0))
    return np.concatenate(taken)


def _place(
    points: np.ndarray, pixels: np.ndarray, box: np.ndarray, floor: float | None, frame: RGBDFrame
) -> UprightBox | None:
    away = (np.abs(pixels - box[:2]) / (box[2:] / 2.0)).max(1)
    away[np.isnan(away)] = np.inf  # outside the lens
    ground = -np.inf if floor is None else floor
    near = np.flatnonzero((away <= _AROUND) & (points[:, 2] > ground + FLOOR_MARGIN))
    depth = (points[near] - frame.T_world_camera[:3, 3]) @ frame.T_world_camera[:3, 2]
    pixel = float(np.median(depth)) / frame.intrinsics.fx if len(near) else 0.0
    labels = voxel_clusters(points[near], max(CLUSTER_VOXEL, CLUSTER_PIXELS * pixel))
    parts = [near[labels == index] for index in range(labels.max(initial=-1) + 1)]
    parts = [part for part in parts if _belongs(points[part], away[part] <= _INSIDE, floor)]
    whole = joined_parts(parts, points)
    at = whole[away[whole] <= _INSIDE]
    if len(at) < _LEAST or not _stands(points[at], floor):
        return None
    missing = _missing(points[at], pixels[at], box, frame)
    return one_view_box(points[at], missing, frame.T_world_camera, floor, len(at) < _WHOLE * len(whole))


def _stands(points: np.ndarray, floor: float | None) -> bool:
    return floor is None or bool(points[:, 2].min() < floor + STANDING)


def _belongs(points: np.ndarray, inside: np.ndarray, floor: float | None) -> bool:
    return bool(inside.mean() >= _SHARES["stands" if _stands(points, floor) else "hangs"])


def _missing(points: np.ndarray, pixels: np.ndarray, box: np.ndarray, frame: RGBDFrame) -> Float[np.ndarray, "4"]:
    """How much farther the box reaches than the points, beyond what is allowed; left, top, right, bottom, m."""
    half = box[2:] / 2.0
    gap = np.concatenate([pixels.min(0) - (box[:2] - half), box[:2] + half - pixels.max(0)])
    camera = frame.color_intrinsics or frame.intrinsics
    distance = float(np.median((points - frame.T_world_camera[:3, 3]) @ frame.T_world_camera[:3, 2]))
    return np.maximum(gap - np.tile(_ALLOWED * box[2:], 2), 0.0) * distance / camera.fx


def _points_and_pixels(frame: RGBDFrame) -> tuple[np.ndarray, np.ndarray]:
    """Depth pixels on surfaces as points in the world, m, and where they fall in the colour image, px."""
    shown = _steady(frame)
    depth = frame.depth[shown].astype(float)
    local = np.column_stack([frame.intrinsics.rays[shown] * depth[:, None], depth])
    points = local @ frame.T_world_camera[:3, :3].T + frame.T_world_camera[:3, 3]
    if frame.color_intrinsics is None or frame.T_color_depth is None:
        rows, columns = np.nonzero(shown)
        return points, np.column_stack([columns, rows]).astype(float)
    seen = local @ frame.T_color_depth[:3, :3].T + frame.T_color_depth[:3, 3]
    return points, frame.color_intrinsics.project(seen)


def _steady(frame: RGBDFrame) -> Bool[np.ndarray, "height width"]:
    """Valid pixels with some neighbours at their depth; others lie in the air, between an edge and what is behind."""
    height, width = frame.depth.shape
    depth = np.pad(np.where(frame.valid, frame.depth, np.float32(-1.0)), 1, constant_values=-1.0)
    step = frame.depth * np.float32(_STEP / frame.intrinsics.fx)
    count = np.zeros(frame.depth.shape, np.int8)
    for down, along in ((0, 0), (0, 1), (0, 2), (1, 0), (1, 2), (2, 0), (2, 1), (2, 2)):
        count += np.abs(depth[down : down + height, along : along + width] - frame.depth) < step
    return frame.valid & (count >= _NEIGHBOURS)

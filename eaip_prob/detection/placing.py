"""Where in the world what a detector has found stands, from the depth of all cameras around its box.

Depth points are projected into the colour image; those around the box are taken, the floor is cut away, and what
remains falls apart into clusters. A cluster is of the object if it stands on the floor and lies in the box for the most
part, or hangs in the air and lies in the box as a whole: arms, a bag, and what is seen behind the object do not.

A bag that lies against the object's feet hangs together with it, and reaches far out of the box. Then the cut above the
floor is raised until what is above it ends near the box: the object's upper part, which is taken down to the floor.
Where no cut sets the object free, or what it leaves is narrower than the box because a seat or a table's top went with
the bag, the same is tried in finer voxels, in which more gaps show. Where that does not help either, what lies in the
box is taken, and the covariance says so.

One view shows the front of an object and its top; more cameras show more sides. What none of them shows is not made up:
the face that looks away is where the last point was seen, and its standard deviation says how far off that is
(`eaip_prob.detection.placing_box`).
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from jaxtyping import Float, Int

from eaip_prob.data.frames import RGBDFrame, inverse, pixel_rays
from eaip_prob.detection.base import Detections
from eaip_prob.detection.placing_box import UprightBox, VoxelGrid, seen_box
from eaip_prob.errors import ShapeError

FLOOR_MARGIN = 0.015  # metres above the floor up to which points are its own
STANDING = 0.15  # metres above the floor within which the lowest point of what stands on it is seen
_AROUND, _REACH = 1.7, 1.35  # sizes of the box within which points are looked at, and near which an object ends
_INSIDE = 1.06  # sizes of the box that count as the box, which a detector gets a little wrong
_SHARE, _HANGING_SHARE = 0.5, 0.75  # of a cluster that lies in the box, if it is of the object
_WHOLE = 0.98  # share of an object that ends near the box
_CUTS = (0.1, 0.2, 0.3, 0.4, 0.5, 0.6, 0.7, 0.8)  # metres above the floor, of what a bag at an object may hide
_SLICE = 0.1  # metres, of the lower part in which its feet are told from a bag
_GAP = 0.10  # metres, along x and y, between the parts of an object
_LEAST_VOXEL, _LEAST_PART, _LEAST = 2, 20, 60  # points of a voxel, a part and an object; fewer say too little
_ALLOWED = 0.03  # share of its size by which the box may reach beyond the points
_FLOOR_CELL = 0.02  # metres; resolution of heights among which the floor is sought
_FLOOR_STRIDE = 2  # of the points that are looked at, for the floor
_FLOOR_SHARE = 0.04  # of all points that lie within one such cell, if it is the floor
_STEP, _NEIGHBOURS = 5.5, 3  # widths of a pixel between neighbours on a surface, and how many a pixel has at least
_FINEST = 0.006  # rad between neighbouring pixels that are looked at, about: 1 cm at 2 m
CLUSTER_VOXEL, CLUSTER_PIXELS = 0.04, 7.0  # metres, and widths of a pixel, of which the larger is a voxel of clusters
_FINE_VOXEL, _FINE_PIXELS = 0.025, 4.0  # the same, between an object and a bag that lies against it
_WANTING = 0.05  # metres to a side by which the box may be wider than the object, before finer voxels are tried
_BETTER = 0.01  # metres by which an object in finer voxels is to be closer to the width of the box


def placed(
    detections: Detections, frame: RGBDFrame, floor: float | None = None, others: Sequence[RGBDFrame] = ()
) -> Detections:
    """The detections with their place in the world and its covariance; NaN where depth does not show the object.

    Args:
        detections: in the colour image of the frame.
        frame: with the depth.
        floor: height of the floor in the world, m; None to find it in the frames (`floor_height`).
        others: frames of other cameras at that time, whose depth shows what is hidden in this one.

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
        frames = (frame, *others)
        if floor is None:
            floor = floor_height(np.concatenate([_points(one, -np.inf, _FLOOR_STRIDE) for one in frames]))
        lowest = -np.inf if floor is None else floor + FLOOR_MARGIN
        points = np.concatenate([_points(one, lowest) for one in frames])
        pixels, poses = _pixels(points, frame), [one.T_world_camera for one in frames]
        for index, box in enumerate(detections.box):
            found = _place(points, pixels, box, floor, frame, poses)
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
    points: np.ndarray,
    pixels: np.ndarray,
    box: np.ndarray,
    floor: float | None,
    frame: RGBDFrame,
    poses: Sequence[np.ndarray],
) -> UprightBox | None:
    along, down = (np.abs(pixels[:, axis] - box[axis]) * (2.0 / box[2 + axis]) for axis in (0, 1))
    away = np.maximum(along, down)
    near = np.flatnonzero(away <= _AROUND)  # outside the lens away is NaN
    if not len(near):
        return None
    points, pixels, away = points[near], pixels[near], away[near]
    told = _told_apart(points, pixels, away, box, floor, frame)
    at, touched = (_in_box(points, away, floor, frame), False) if told is None else told
    if not len(at):
        return None
    missing = _missing(points[at], pixels[at], box, frame)
    return seen_box(points[at], missing, poses, floor, tangled=told is None, touched=touched)


def _grid(points: np.ndarray, away: np.ndarray, frame: RGBDFrame, voxel: float, pixels: float) -> VoxelGrid:
    return VoxelGrid(points, max(voxel, pixels * _pixel(points[away <= _INSIDE], frame)), _LEAST_VOXEL)


def _told_apart(
    points: np.ndarray, pixels: np.ndarray, away: np.ndarray, box: np.ndarray, floor: float | None, frame: RGBDFrame
) -> tuple[Int[np.ndarray, "members"], bool] | None:
    """(the object, whether something touches it), in the coarse voxels if they show it as wide as its box."""
    best, least = None, np.inf
    for voxel, widths in ((CLUSTER_VOXEL, CLUSTER_PIXELS), (_FINE_VOXEL, _FINE_PIXELS)):
        grid = _grid(points, away, frame, voxel, widths)
        at, cut = _free(grid, points, away, floor)
        if len(at) < _LEAST:
            continue
        if floor is not None and cut > 0.0:
            at = _with_feet(at, grid, points, away, floor, cut)
        wanting = float(_missing(points[at], pixels[at], box, frame)[[0, 2]].max())
        if wanting < least:
            best, least = (at, cut > 0.0 or voxel < CLUSTER_VOXEL), wanting - _BETTER
        if wanting <= _WANTING:
            break
    return best


def _in_box(points: np.ndarray, away: np.ndarray, floor: float | None, frame: RGBDFrame) -> Int[np.ndarray, "members"]:
    """What lies in the box, of an object that nothing sets free; no points where that is too little."""
    clusters = _grid(points, away, frame, CLUSTER_VOXEL, CLUSTER_PIXELS).clusters()
    at = _parts(clusters, points, away, floor)
    at = at[away[at] <= _INSIDE]
    return at if len(at) >= _LEAST and _stands(points[at], floor) else at[:0]


def _free(
    grid: VoxelGrid, points: np.ndarray, away: np.ndarray, floor: float | None
) -> tuple[Int[np.ndarray, "members"], float]:
    """(the object above the lowest cut that sets it free, m above the floor); no points where none does."""
    for cut in (0.0,) if floor is None else (0.0, *_CUTS):
        ground = None if floor is None else floor + cut
        above = None if ground is None or cut == 0.0 else grid.low >= ground
        at = _parts(grid.clusters(above), points, away, ground)
        if len(at) >= _LEAST and _stands(points[at], ground) and (away[at] <= _REACH).mean() >= _WHOLE:
            return at, cut
    return np.zeros(0, np.int64), 0.0


def _with_feet(
    at: np.ndarray, grid: VoxelGrid, points: np.ndarray, away: np.ndarray, floor: float, cut: float
) -> Int[np.ndarray, "members"]:
    """The upper part of an object with what of the lower one hangs together with nothing else, slice by slice."""
    top = cut
    while top > 0.0:
        bottom = max(top - _SLICE, 0.0)
        labels = grid.clusters((grid.low >= floor + bottom - _SLICE / 2.0) & (grid.low < floor + top))
        parts = [np.flatnonzero(labels == index) for index in range(labels.max(initial=-1) + 1)]
        parts = [part for part in parts if (away[part] <= _REACH).mean() >= _WHOLE]
        at = np.unique(np.concatenate([at, _beside(at, parts, points)]))
        top = bottom
    return at


def _beside(at: np.ndarray, parts: list[np.ndarray], points: np.ndarray) -> Int[np.ndarray, "members"]:
    """The points of those parts that are below a thing or close beside it."""
    low, high = points[at, :2].min(0) - _GAP, points[at, :2].max(0) + _GAP
    inside = [part for part in parts if ((points[part, :2] > low) & (points[part, :2] < high)).all()]
    return np.concatenate([np.zeros(0, np.int64), *inside])


def _parts(
    labels: np.ndarray, points: np.ndarray, away: np.ndarray, ground: float | None
) -> Int[np.ndarray, "members"]:
    """The points of clusters that belong to what is in the box."""
    parts = [np.flatnonzero(labels == index) for index in range(labels.max(initial=-1) + 1)]
    return joined_parts([part for part in parts if _belongs(points[part], away[part], ground)], points)


def _belongs(points: np.ndarray, away: np.ndarray, ground: float | None) -> bool:
    share = (away <= _INSIDE).mean()
    if _stands(points, ground):
        return bool(share >= _SHARE)
    return bool(share >= _HANGING_SHARE and (away <= _REACH).mean() >= _WHOLE)


def _stands(points: np.ndarray, ground: float | None) -> bool:
    return ground is None or bool(points[:, 2].min() < ground + STANDING)


def _pixel(points: np.ndarray, frame: RGBDFrame) -> float:
    """Width of a pixel that is looked at where points are, m."""
    if not len(points):
        return 0.0
    depth = (points - frame.T_world_camera[:3, 3]) @ frame.T_world_camera[:3, 2]
    return float(np.median(depth)) / frame.intrinsics.fx


def _missing(points: np.ndarray, pixels: np.ndarray, box: np.ndarray, frame: RGBDFrame) -> Float[np.ndarray, "4"]:
    """How much farther the box reaches than the points, beyond what is allowed; left, top, right, bottom, m."""
    half = box[2:] / 2.0
    gap = np.concatenate([pixels.min(0) - (box[:2] - half), box[:2] + half - pixels.max(0)])
    camera = frame.color_intrinsics or frame.intrinsics
    distance = float(np.median((points - frame.T_world_camera[:3, 3]) @ frame.T_world_camera[:3, 2]))
    return np.maximum(gap - np.tile(_ALLOWED * box[2:], 2), 0.0) * distance / camera.fx


def _points(frame: RGBDFrame, lowest: float, coarser: int = 1) -> Float[np.ndarray, "points 3"]:
    """Depth pixels on surfaces above a height as points in the world, m; of a fine image some rows and columns only."""
    from eaip_prob.detection._placing_loops import steady_points

    stride = coarser * max(1, int(_FINEST * frame.intrinsics.fx))
    rays, step = pixel_rays(frame.intrinsics, stride), _STEP / frame.intrinsics.fx
    pose = np.ascontiguousarray(frame.T_world_camera, float)
    return steady_points(frame.depth, frame.valid, rays, stride, step, _NEIGHBOURS, pose, lowest)


def _pixels(points: np.ndarray, frame: RGBDFrame) -> Float[np.ndarray, "points 2"]:
    """Where points of the world fall in the colour image, px; NaN outside the lens."""
    T = inverse(frame.T_world_camera)
    T = T if frame.T_color_depth is None else frame.T_color_depth @ T
    return (frame.color_intrinsics or frame.intrinsics).project(points @ T[:3, :3].T + T[:3, 3])

"""A 3-D box from the cloud of all cameras: no training, no colour, and what one camera cannot see another may.

What is not the object goes by these rules, in this order:

1. the floor: points up to `FLOOR_MARGIN` above it;
2. what is outside the workspace: the robot's body and the person, who stand beside it;
3. clusters that reach across the border of the workspace: arms with grippers and gloves, and a bag that they hold;
4. of the clusters left, those that are not above, below or close beside the largest; together they are the object if
   the lowest point is within `STANDING` of the floor.

A bag that touches the object ties it to the border. Then the object is all that is above its lowest 0.4 m, up to the
largest height of an object, and the covariance says that something hangs together with it; colour would not tell a grey
bag from a grey stepladder.

On rendered frames of three Kinects with noise and nothing above the objects, 12 placements each, centres are 2 to 16 mm
off and edges 5 to 31 mm. The class is right in 47 of 48 views of the objects whose shapes are in `conf/detector`, and
in 34 of 48 of four other pieces of furniture of these classes: the shape of one piece says little of its class.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from jaxtyping import Bool, Float, Int

from eaip_prob.data.frames import RGBDFrame, inverse
from eaip_prob.detection.base import CLASSES, AbstractObjectDetector, Detections, frame_of
from eaip_prob.detection.placing import (
    CLUSTER_PIXELS,
    CLUSTER_VOXEL,
    FLOOR_MARGIN,
    STANDING,
    floor_height,
    joined_parts,
)
from eaip_prob.detection.placing_box import UprightBox, VoxelGrid
from eaip_prob.errors import InputError
from eaip_prob.perception.fusion import Crop, fuse

WORKSPACE = ((0.38, 1.6), (-0.9, 0.9), (-1.1, 0.6))  # m; between the robot's pedestal and the person's feet
_VOXEL = 0.01  # m, of the cloud
_BORDER = 0.02  # m from the border of the workspace that count as reaching across it
_BASE, _AROUND = 0.4, 0.1  # m above the floor, and around what is seen there, within which a covered object is sought
_APART = 0.2  # m beside an object within which something that stands on the floor may be a part of it
_TIED_STD, _TIED_TOP_STD = 0.10, 0.20  # m, of the sides and the top of what hangs together with something else
_LEAST_PART, _LEAST = 30, 200  # voxels of a part, and of an object
_SHAPE_STD = np.array([0.10, 0.10, 0.10, 0.05])  # of what `shape_of` says within a class: m, and a share


class PointCloudDetector(AbstractObjectDetector):
    """Finds the one object that stands in the workspace, and names the class whose shape is nearest.

    With d the shape (`shape_of`) less that of a class, over 0.1 m for lengths and 0.05 for the share, the score is
    exp(-d'd / 2) over its sum for all classes. It says how alike classes are, not how likely the answer is right.

    Args:
        shapes: class of the task -> (long side, short side, height, share), as `shape_of` gives them for known objects.
        camera: in whose colour image the box is.
        workspace: (lowest, highest) along x, y and z in the world, m; the floor is inside.
        floor: height of the floor in the world, m; None to find it in the cloud.
        largest_height: of an object, m.
        face_std: standard deviation of each face of the box but the lowest, m.
        box_std: standard deviation of the box's centre and size in the image, share of its width and height.

    Raises:
        InputError: classes that are none of the task, or shapes of another length.

    Example:
        >>> detector = PointCloudDetector({"table": (0.8, 0.5, 0.7, 0.9)})
        >>> detector.detect([])
        Traceback (most recent call last):
        eaip_prob.errors.InputError: Expected a frame of the camera 'right', got frames of []. Set camera=NAME.
    """

    def __init__(
        self,
        shapes: Mapping[str, Sequence[float]],
        camera: str = "right",
        workspace: Crop = WORKSPACE,
        floor: float | None = None,
        largest_height: float = 1.2,
        face_std: float = 0.012,
        box_std: float = 0.03,
    ) -> None:
        if not shapes or set(shapes) - set(CLASSES) or any(np.shape(shape) != (4,) for shape in shapes.values()):
            raise InputError(
                f"Expected shapes as (long side, short side, height, share) of classes of {list(CLASSES)}, got "
                f"{dict(shapes)}."
            )
        if not (largest_height > 0.0 and face_std >= 0.0 and box_std >= 0.0):
            raise InputError(
                f"Expected largest_height above zero, face_std and box_std of at least zero, got {largest_height}, "
                f"{face_std} and {box_std}."
            )
        self.shapes, self.camera, self.workspace, self.floor = dict(shapes), camera, workspace, floor
        self.largest_height, self.face_std, self.box_std = largest_height, face_std, box_std

    def detect(self, frames: Sequence[RGBDFrame]) -> Detections:
        """The object in the workspace, or nothing.

        Args:
            frames: of all cameras that delivered one; more cameras see more of it.

        Raises:
            InputError: the camera of the box is not among them.
        """
        frame = frame_of(frames, self.camera)
        image_size = (frame.color.shape[1], frame.color.shape[0])
        points = fuse(frames, self.workspace, _VOXEL).points
        floor = floor_height(points) if self.floor is None else self.floor
        if floor is None:
            return Detections.none(image_size)
        at, tangled = self._object(points, floor, self._voxel(frames))
        pixels = _pixels(points[at], frame)
        if len(at) < _LEAST or not len(pixels):
            return Detections.none(image_size)
        low, high = np.maximum(pixels.min(0), -0.5), np.minimum(pixels.max(0), np.array(image_size) - 0.5)
        box = np.concatenate([(low + high) / 2.0, high - low])
        if not (box[2:] > 0.0).all():
            return Detections.none(image_size)
        label, score = self._named(shape_of(points[at], floor))
        place = self._boxed(points[at], floor, tangled)
        return Detections(
            (label,),
            np.array([score]),
            box[None],
            image_size,
            np.diag((self.box_std * np.tile(box[2:], 2)) ** 2)[None],
            place.place[None],
            place.covariance[None],
        )

    def _object(self, points: np.ndarray, floor: float, voxel: float) -> tuple[Int[np.ndarray, "members"], bool]:
        """Which points are of the object, and whether something hangs together with it."""
        high = np.flatnonzero(points[:, 2] > floor + FLOOR_MARGIN)
        labels = VoxelGrid(points[high], voxel).clusters()
        parts = [high[labels == index] for index in range(labels.max(initial=-1) + 1)]
        bounds = np.asarray(self.workspace, float)
        tied = [_at_border(points[part], bounds).any() for part in parts]
        at = joined_parts([part for part, held in zip(parts, tied, strict=True) if not held], points, _LEAST_PART)
        if len(at) >= _LEAST and points[at, 2].min() < floor + STANDING:
            low = [part[points[part, 2] < floor + _BASE] for part, held in zip(parts, tied, strict=True) if held]
            if not any(_beside(points[part], points[at], _APART).any() for part in low):
                return at, False
        base = self._base(points, parts, floor)
        covered = _beside(points[high], points[base], _AROUND) & (points[high, 2] < floor + self.largest_height)
        return high[covered], True

    def _voxel(self, frames: Sequence[RGBDFrame]) -> float:
        """Edge of the voxels of clusters, m: larger where the pixels of a camera are."""
        middle = np.asarray(self.workspace, float).mean(1)
        widths = [np.linalg.norm(middle - one.T_world_camera[:3, 3]) / one.intrinsics.fx for one in frames]
        return max(CLUSTER_VOXEL, CLUSTER_PIXELS * float(min(widths)))

    def _base(self, points: np.ndarray, parts: list[np.ndarray], floor: float) -> Int[np.ndarray, "members"]:
        """Near the floor, where no bag reaches before the object is covered."""
        low = [part[points[part, 2] < floor + _BASE] for part in parts]
        return joined_parts([part for part in low if _lowest(points[part]) < floor + STANDING], points, _LEAST_PART)

    def _boxed(self, points: np.ndarray, floor: float, tangled: bool) -> UprightBox:
        ordered = np.partition(points, (2, len(points) - 3), axis=0)
        low, high = ordered[2].copy(), ordered[-3].copy()
        low[2] = floor
        sides = np.full(3, np.hypot(self.face_std, _TIED_STD * tangled))
        low_std, high_std = sides.copy(), sides.copy()
        low_std[2], high_std[2] = self.face_std / 2.0, np.hypot(self.face_std, _TIED_TOP_STD * tangled)
        return UprightBox.between(low, high, low_std, high_std)

    def _named(self, shape: Float[np.ndarray, "4"]) -> tuple[str, float]:
        known = np.array([self.shapes[label] for label in self.shapes], float)
        distance = (((shape - known) / _SHAPE_STD) ** 2).sum(1) / 2.0
        likely = np.exp(distance.min() - distance)
        best = int(likely.argmax())
        return list(self.shapes)[best], float(likely[best] / likely.sum())


def shape_of(points: Float[np.ndarray, "points 3"], floor: float) -> Float[np.ndarray, "4"]:
    """Long and short side of an object's outline on the floor, m, its height, m, and how top-heavy it is.

    The sides are those of the smallest rectangle around the outline. The last is the mean height of the points, a share
    of the object's height: that of a table is near one, that of a shelf half.

    Args:
        points: (N, 3), in the world, m.
        floor: its height, m.

    Example:
        >>> x, y, z = np.meshgrid(np.linspace(0, 2, 9), np.linspace(0, 1, 9), np.linspace(0, 3, 9))
        >>> shape_of(np.column_stack([x.ravel(), y.ravel(), z.ravel()]), 0.0).round(2).tolist()
        [2.0, 1.0, 3.0, 0.5]
    """
    import cv2

    sides = cv2.minAreaRect(points[:, :2].astype(np.float32))[1]
    height = np.partition(points[:, 2], -3)[-3] - floor
    return np.array([max(sides), min(sides), height, (points[:, 2].mean() - floor) / height])


def _beside(
    points: Float[np.ndarray, "points 3"], thing: Float[np.ndarray, "members 3"], gap: float
) -> Bool[np.ndarray, "points"]:
    """Points above or below a thing, or beside it within a gap, m."""
    if not len(thing):
        return np.zeros(len(points), bool)
    low, high = thing[:, :2].min(0) - gap, thing[:, :2].max(0) + gap
    return ((points[:, :2] > low) & (points[:, :2] < high)).all(1)


def _lowest(points: Float[np.ndarray, "points 3"]) -> float:
    return float(points[:, 2].min(initial=np.inf))


def _at_border(points: np.ndarray, bounds: Float[np.ndarray, "3 2"]) -> Bool[np.ndarray, "points"]:
    """Points close to a side or the top of the workspace."""
    low, high = bounds[:, 0] + _BORDER, bounds[:, 1] - _BORDER
    return np.any(points[:, :2] < low[:2], axis=1) | np.any(points > high, axis=1)


def _pixels(points: np.ndarray, frame: RGBDFrame) -> Float[np.ndarray, "points 2"]:
    """Where points of the world fall in the colour image, those that the lens shows, px."""
    T = inverse(frame.T_world_camera)
    camera = frame.color_intrinsics or frame.intrinsics
    T = T if frame.T_color_depth is None else frame.T_color_depth @ T
    pixels = camera.project(points @ T[:3, :3].T + T[:3, 3])
    return pixels[np.isfinite(pixels).all(1)]

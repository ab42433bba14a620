"""Frames that carry the renderer's truth, and a detector that reads it, with as much error as is asked for.

What is found does not depend on calls before it: errors follow from the seed, the camera, the time of the frame and
where its objects are.
"""

from __future__ import annotations

import zlib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields

import numpy as np
from jaxtyping import Bool, Float

from eaip_prob.data.frames import RGBDFrame, inverse
from eaip_prob.detection.base import CLASSES, AbstractObjectDetector, Detections, frame_of
from eaip_prob.errors import InputError, ShapeError
from eaip_prob.simulation.kinect import Kinect, render_rgbd
from eaip_prob.simulation.render import Labels, Lighting, View
from eaip_prob.simulation.scene import Part, Scene

_LEAST_BOX = 1.0  # px


@dataclass(frozen=True, eq=False)
class TrueObject:
    """What is known of an object that was rendered.

    Args:
        label: name of its class.
        box: (4,), centre column, centre row, width and height of all its pixels in the colour image, also those that
            something else hides, px.
        covered: share, from 0 to 1, of these pixels that something else hides.
        place: (6,), centre and edge lengths of the upright box around it in the world, m.

    Example:
        >>> cube = TrueObject("table", np.array([40.0, 20.0, 9.0, 8.0]), 0.25, np.array([1.0, 0, 0, 0.4, 0.4, 0.4]))
        >>> cube.covered
        0.25
    """

    label: str
    box: Float[np.ndarray, "4"]
    covered: float
    place: Float[np.ndarray, "6"]


@dataclass(frozen=True, eq=False)
class LabelledFrame(RGBDFrame):
    """A rendered frame, and which objects it shows; noise that is put on it leaves them as they are.

    Args:
        color: as of `RGBDFrame`, like all that follow.
        depth: as of `RGBDFrame`.
        valid: as of `RGBDFrame`.
        intrinsics: as of `RGBDFrame`.
        T_world_camera: as of `RGBDFrame`.
        time: as of `RGBDFrame`.
        color_intrinsics: as of `RGBDFrame`.
        T_color_depth: as of `RGBDFrame`.
        name: as of `RGBDFrame`.
        objects: those with a pixel in the colour image.

    Example:
        >>> from eaip_prob.data.frames import Intrinsics
        >>> camera, depth = Intrinsics(4, 3, 4.0, 4.0, 1.5, 1.0), np.ones((3, 4), np.float32)
        >>> LabelledFrame(np.zeros((3, 4, 3), np.uint8), depth, depth > 0, camera, np.eye(4), 0.0).objects
        ()
    """

    objects: tuple[TrueObject, ...] = ()


def render_labelled(
    scene: Scene, camera: Kinect, time: float, objects: Mapping[str, str], lighting: Lighting | None = None
) -> tuple[LabelledFrame, Labels]:
    """One frame without noise that knows its objects, and what each pixel of its depth image truly shows.

    Args:
        scene: what is there.
        camera: which unit.
        time: s.
        objects: name of a part -> name of its class; parts that the colour image does not show are left out.
        lighting: as `Lighting()` if None.

    Raises:
        InputError: no part of that name, or a class that is none of the task.

    Example:
        >>> from eaip_prob.data.frames import Intrinsics
        >>> from eaip_prob.simulation import KinectModel, box
        >>> small = Intrinsics(9, 9, 9.0, 9.0, 4.0, 4.0)
        >>> scene = Scene([Part("cube", box((1.0, 1.0, 1.0), (1, 0, 0)).at(z=3.5))])
        >>> unit = Kinect("right", KinectModel(small, small, (-0.05, 0, 0)), np.eye(4))
        >>> frame, _ = render_labelled(scene, unit, 0.0, {"cube": "table"})
        >>> frame.objects[0].label, frame.objects[0].box.tolist(), frame.objects[0].covered
        ('table', [4.0, 4.0, 3.0, 3.0], 0.0)
    """
    unknown = sorted(set(objects.values()) - set(CLASSES))
    if unknown:
        raise InputError(f"Expected classes of the task, {CLASSES}, got {unknown}. Name one of these for each object.")
    frame, labels = render_rgbd(scene, camera, time, lighting)
    found = [true_object(scene, camera.color_view, name, label) for name, label in objects.items()]
    known = {field.name: getattr(frame, field.name) for field in fields(frame)}
    return LabelledFrame(**known, objects=tuple(one for one in found if one is not None)), labels


def true_object(scene: Scene, view: View, name: str, label: str) -> TrueObject | None:
    """What a view should say of a part; None where it shows nothing of it, even with nothing before it.

    Args:
        scene: what is there.
        view: of the colour camera.
        name: of the part.
        label: name of its class.

    Raises:
        InputError: no part of that name.

    Example:
        >>> from eaip_prob.data.frames import Intrinsics
        >>> from eaip_prob.simulation import box
        >>> scene = Scene([Part("cube", box((1.0, 1.0, 1.0), (1, 0, 0)).at(z=3.5))])
        >>> true_object(scene, View(Intrinsics(9, 9, 9.0, 9.0, 4.0, 4.0), np.eye(4)), "cube", "table").place.tolist()
        [0.0, 0.0, 3.5, 1.0, 1.0, 1.0]
    """
    part = scene.parts[scene.index(name)]
    rows, columns = _window(part, view)
    rays = view.rays[rows, columns]
    if not rays.size:
        return None
    alone = np.isfinite(Scene([part]).cast(rays)["t_hit"])
    if not alone.any():
        return None
    shown = scene.cast(rays)["geometry_ids"].view(np.int32) == scene.index(name)
    low, high = part.mesh.extent()
    place = np.concatenate([(low + high) / 2.0, high - low])
    covered = 1.0 - float((shown & alone).sum() / alone.sum())
    return TrueObject(label, _box(alone, rows.start, columns.start), covered, place)


def _window(part: Part, view: View) -> tuple[slice, slice]:
    """Rows and columns that may show a part: all of them where some of it is behind the camera."""
    T, camera = inverse(view.T_world_camera), view.intrinsics
    pixels = camera.project(part.mesh.vertices @ T[:3, :3].T + T[:3, 3])
    if np.isnan(pixels).any():
        return slice(0, camera.height), slice(0, camera.width)
    size = (camera.width, camera.height)
    (left, top) = np.clip(np.floor(pixels.min(0)) - 1, 0, size).astype(int)
    (right, bottom) = np.clip(np.ceil(pixels.max(0)) + 2, 0, size).astype(int)
    return slice(int(top), int(bottom)), slice(int(left), int(right))


def _box(shown: Bool[np.ndarray, "rows columns"], top: int, left: int) -> Float[np.ndarray, "4"]:
    """Around the pixels, whose edges lie half a pixel from their centres."""
    row, column = (np.flatnonzero(shown.any(axis)) for axis in (1, 0))
    width, height = column[-1] - column[0] + 1, row[-1] - row[0] + 1
    return np.array([left + (column[0] + column[-1]) / 2.0, top + (row[0] + row[-1]) / 2.0, width, height])


def _moment(frame: LabelledFrame) -> int:
    """A number that another time, or the same time of another scene, does not share."""
    numbers = [np.array([frame.time + 0.0]), *(np.append(one.box, one.place) for one in frame.objects)]
    return zlib.crc32(np.concatenate(numbers).tobytes())


class OracleDetector(AbstractObjectDetector):
    """Answers what the renderer knows, with errors of known size: a detector of any quality, for studies.

    Args:
        camera: whose frame is read.
        box_std: standard deviation of the box's centre and size, share of its width and height.
        place_std: standard deviation of the place's centre and edge lengths, m; one number or six.
        wrong_class: probability of another class, each of the others alike; the score is one less this.
        drop_out: probability that an object is not found.
        largest_covered: an object of which more than this share is covered is not found.
        seed: of the errors; the same seed gives the same frame the same errors.

    Raises:
        InputError: a share or probability outside 0 to 1, or a standard deviation below zero.
        ShapeError: another number of standard deviations.

    Example:
        >>> from eaip_prob.data.frames import Intrinsics
        >>> camera, depth = Intrinsics(4, 3, 4.0, 4.0, 1.5, 1.0), np.ones((3, 4), np.float32)
        >>> shelf = TrueObject("bookshelf", np.array([2.0, 1.0, 2.0, 2.0]), 0.0, np.array([1, 0, 0, 0.6, 0.3, 0.9]))
        >>> frame = LabelledFrame(
        ...     np.zeros((3, 4, 3), np.uint8), depth, depth > 0, camera, np.eye(4), 0.0, name="right", objects=(shelf,)
        ... )
        >>> OracleDetector().detect([frame]).labels
        ('bookshelf',)
    """

    def __init__(
        self,
        camera: str = "right",
        box_std: float = 0.0,
        place_std: float | Sequence[float] = 0.0,
        wrong_class: float = 0.0,
        drop_out: float = 0.0,
        largest_covered: float = 1.0,
        seed: int = 0,
    ) -> None:
        shares = {"wrong_class": wrong_class, "drop_out": drop_out, "largest_covered": largest_covered}
        if not all(0.0 <= share <= 1.0 for share in shares.values()):
            raise InputError(f"Expected probabilities and shares from 0 to 1, got {shares}.")
        place = np.asarray(place_std, float)
        if place.shape not in ((), (6,)):
            raise ShapeError(f"Expected place_std as one number or six, got the shape {place.shape}.")
        if not (0.0 <= box_std < np.inf and (place >= 0.0).all() and np.isfinite(place).all()):
            raise InputError(f"Expected box_std and place_std of at least zero, got {box_std} and {place_std}.")
        self.camera, self.seed = camera, seed
        self.box_std, self.place_std = box_std, np.broadcast_to(place, 6)
        self.wrong_class, self.drop_out, self.largest_covered = wrong_class, drop_out, largest_covered

    def detect(self, frames: Sequence[RGBDFrame]) -> Detections:
        """The objects of the camera's frame, in its order.

        Args:
            frames: of all cameras that delivered one; the one that is read carries labels.

        Raises:
            InputError: the camera is not among them, or its frame carries no labels.
        """
        frame = frame_of(frames, self.camera)
        if not isinstance(frame, LabelledFrame):
            raise InputError(
                f"Expected a LabelledFrame of the camera {self.camera!r}, got a {type(frame).__name__}. Render it with "
                "render_labelled, or choose a detector that reads images."
            )
        generator = np.random.default_rng([self.seed, zlib.crc32(frame.name.encode()), _moment(frame)])
        # Drawn for every object, so that one that drops out does not change the errors of the next.
        drawn = [(one, self._disturbed(one, generator), generator.random()) for one in frame.objects]
        found = [noisy for one, noisy, luck in drawn if luck >= self.drop_out and one.covered <= self.largest_covered]
        image_size = (frame.color.shape[1], frame.color.shape[0])
        return self._detections(found, image_size) if found else Detections.none(image_size)

    def _disturbed(self, one: TrueObject, generator: np.random.Generator) -> TrueObject:
        box = one.box + self.box_std * np.tile(one.box[2:], 2) * generator.standard_normal(4)
        box[2:] = np.maximum(box[2:], _LEAST_BOX)
        place = one.place + self.place_std * generator.standard_normal(6)
        other = [name for name in CLASSES if name != one.label][generator.integers(len(CLASSES) - 1)]
        label = other if generator.random() < self.wrong_class else one.label
        return TrueObject(label, box, one.covered, place)

    def _detections(self, found: Sequence[TrueObject], image_size: tuple[int, int]) -> Detections:
        count, box = len(found), np.stack([one.box for one in found])
        std = self.box_std * np.tile(box[:, 2:], 2)
        return Detections(
            labels=tuple(one.label for one in found),
            score=np.full(count, 1.0 - self.wrong_class),
            box=box,
            image_size=image_size,
            box_covariance=std[:, :, None] ** 2 * np.eye(4),
            place=np.stack([one.place for one in found]),
            place_covariance=np.tile(np.diag(self.place_std**2), (count, 1, 1)),
        )

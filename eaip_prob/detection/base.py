"""What object detectors answer, and what they have to offer: one class for those that read frames, one for images.

A box is that of the whole object in the colour image, also where something stands before it: centre column, centre
row, width and height in px, as in Sec. 4.2.1 of the paper. Centres of pixels are whole numbers; the edges of a box lie
half a pixel outside the centres of its outermost pixels. The world is the robot's frame, metres.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from jaxtyping import Float, Int, UInt8

from eaip_prob.data.frames import RGBDFrame
from eaip_prob.errors import InputError, ShapeError

CLASSES = ("chair", "stepladder", "table", "bookshelf")  # of the task, in the paper's order
BOX_NAMES = ("center_x", "center_y", "width", "height")
PLACE_NAMES = ("x", "y", "z", "length_x", "length_y", "length_z")


@dataclass(frozen=True, eq=False)
class Detections:
    """Objects found in one image or in the frames of one time, the most certain first.

    Args:
        labels: n names of classes.
        score: (n,), 0 to 1.
        box: (n, 4), centre column, centre row, width and height in the colour image, px.
        image_size: (width, height) of the image the boxes are in, px.
        box_covariance: (n, 4, 4), of the boxes' errors, px^2; None where the detector does not know them.
        place: (n, 6), centre and edge lengths of an upright box in the world, m; NaN rows where it is not known; None
            where the detector never knows it.
        place_covariance: (n, 6, 6), of the places' errors, m^2; NaN where the place is.

    Raises:
        ShapeError: arrays of another shape than the labels say.
        InputError: a score outside 0 to 1, a box without area, or what is not finite.

    Example:
        >>> found = Detections(("chair",), np.array([0.9]), np.array([[480.0, 270.0, 100.0, 200.0]]), (960, 540))
        >>> len(found), found.corners.tolist()
        (1, [[430.0, 170.0, 530.0, 370.0]])
    """

    labels: tuple[str, ...]
    score: Float[np.ndarray, "detections"]
    box: Float[np.ndarray, "detections 4"]
    image_size: tuple[int, int]
    box_covariance: Float[np.ndarray, "detections 4 4"] | None = field(default=None)
    place: Float[np.ndarray, "detections 6"] | None = field(default=None)
    place_covariance: Float[np.ndarray, "detections 6 6"] | None = field(default=None)

    def __post_init__(self) -> None:
        count = len(self.labels)
        shapes = {"score": (), "box": (4,), "box_covariance": (4, 4), "place": (6,), "place_covariance": (6, 6)}
        for name, rest in shapes.items():
            array = getattr(self, name)
            if array is not None and np.shape(array) != (count, *rest):
                raise ShapeError(f"Expected {name} with shape {(count, *rest)}, got {np.shape(array)}.")
        if (self.place is None) != (self.place_covariance is None):
            raise InputError("Expected place and place_covariance together, got one of them. Give both or none.")
        if not ((self.score >= 0.0) & (self.score <= 1.0)).all():
            raise InputError(f"Expected scores from 0 to 1, got {self.score}.")
        if not (np.isfinite(self.box).all() and (self.box[:, 2:] > 0.0).all()):
            raise InputError("Expected boxes (centre column, centre row, width, height) with an area, in px.")

    def __len__(self) -> int:
        return len(self.labels)

    @property
    def corners(self) -> Float[np.ndarray, "detections 4"]:
        """Left, top, right and bottom of each box, px."""
        return np.concatenate([self.box[:, :2] - self.box[:, 2:] / 2.0, self.box[:, :2] + self.box[:, 2:] / 2.0], -1)

    def __getitem__(self, index: Int[np.ndarray, "chosen"] | slice) -> Detections:
        """Some of the detections, in the order asked for."""
        at = np.arange(len(self))[index]
        some = {name: getattr(self, name) for name in ("score", "box", "box_covariance", "place", "place_covariance")}
        chosen: dict[str, Any] = {name: None if array is None else array[at] for name, array in some.items()}
        return Detections(tuple(self.labels[i] for i in at), image_size=self.image_size, **chosen)

    @classmethod
    def none(cls, image_size: tuple[int, int]) -> Detections:
        """Nothing found.

        Args:
            image_size: (width, height), px.
        """
        return cls((), np.zeros(0), np.zeros((0, 4)), image_size)


class AbstractObjectDetector(ABC):
    """Finds objects in the frames of one time.

    A subclass gives `detect`; encoders, experiments and the loop of a task need nothing else.
    """

    @abstractmethod
    def detect(self, frames: Sequence[RGBDFrame]) -> Detections:
        """What is there now, the most certain first.

        Args:
            frames: of all cameras that delivered one; a detector takes what it needs.

        Raises:
            InputError: the camera that the detector reads is not among them.
        """


class AbstractImageDetector(AbstractObjectDetector):
    """Finds objects in a colour image; where the frame has depth, they are placed in the world too.

    A subclass gives `detect_image`.

    Args:
        camera: name of the camera whose colour image is read; the paper's is the right one (Kinect 3 in Fig. 9).
    """

    def __init__(self, camera: str = "right") -> None:
        self.camera = camera

    @abstractmethod
    def detect_image(self, image: UInt8[np.ndarray, "height width 3"]) -> Detections:
        """What an image shows, the most certain first.

        Args:
            image: RGB. Blue and red exchanged cannot be noticed: convert what OpenCV has read.
        """

    def detect(self, frames: Sequence[RGBDFrame]) -> Detections:
        """What the camera's colour image shows, with its place in the world from the depth of all cameras.

        Args:
            frames: of all cameras that delivered one; those of another moment say nothing of places.

        Raises:
            InputError: the camera is not among them.
        """
        from eaip_prob.detection.placing import placed
        from eaip_prob.perception.fusion import HALF_FRAME

        frame = frame_of(frames, self.camera)
        others = [one for one in frames if one is not frame and abs(one.time - frame.time) <= HALF_FRAME]
        return placed(self.detect_image(frame.color), frame, others=others)


def frame_of(frames: Sequence[RGBDFrame], camera: str) -> RGBDFrame:
    """The frame of one camera.

    Args:
        frames: of one time.
        camera: its name.

    Raises:
        InputError: the camera is not among them.

    Example:
        >>> frame_of([], "right")
        Traceback (most recent call last):
        eaip_prob.errors.InputError: Expected a frame of the camera 'right', got frames of []. Set camera=NAME.
    """
    for frame in frames:
        if frame.name == camera:
            return frame
    raise InputError(
        f"Expected a frame of the camera {camera!r}, got frames of {[frame.name for frame in frames]}. Set camera=NAME."
    )


def check_image(image: UInt8[np.ndarray, "height width 3"]) -> None:
    """Refuses what is no RGB image.

    Args:
        image: as given.

    Raises:
        ShapeError: grey, with an alpha channel, or empty.
        InputError: no bytes.

    Example:
        >>> check_image(np.zeros((2, 2, 3), np.uint8))
    """
    if np.ndim(image) != 3 or image.shape[2] != 3 or not image.size:
        raise ShapeError(
            f"Expected image with shape (H, W, 3), RGB, got {np.shape(image)}. Repeat a grey image three times; "
            "leave an alpha channel out."
        )
    if image.dtype != np.uint8:
        raise InputError(f"Expected image of uint8, 0 to 255, got {image.dtype}. Multiply 0 to 1 by 255 and convert.")

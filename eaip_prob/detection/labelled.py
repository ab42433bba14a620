"""Images with one labelled object each: what a detector learns from and is judged by."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float, Int, UInt8

from eaip_prob.detection.base import CLASSES
from eaip_prob.detection.network_input import check_region, part_of
from eaip_prob.errors import InputError, ShapeError

_INSIDE = 0.75  # least share of a box in a part of its image


@dataclass(frozen=True, eq=False)
class LabelledImages:
    """N images of one size, each with the box, the class and the visible pixels of one object.

    A box is that of the whole object, also where something stands before it, cut off at the image's edges.

    Args:
        image: (N, H, W, 3), RGB.
        box: (N, 4), centre column, centre row, width and height, px.
        label: (N,), index of the class in `CLASSES`.
        visible: (N, H, W), pixels that show the object.

    Raises:
        ShapeError: arrays of other shapes than the images say.
        InputError: a label of no class.

    Example:
        >>> box, nowhere = np.array([[8.0, 4.0, 4.0, 4.0]]), np.zeros((1, 9, 16), bool)
        >>> views = LabelledImages(np.zeros((1, 9, 16, 3), np.uint8), box, np.array([2]), nowhere)
        >>> len(views), views.names
        (1, ['table'])
    """

    image: UInt8[np.ndarray, "images height width 3"]
    box: Float[np.ndarray, "images 4"]
    label: Int[np.ndarray, "images"]
    visible: Bool[np.ndarray, "images height width"]

    def __post_init__(self) -> None:
        number, height, width = (*np.shape(self.image), 0, 0, 0)[:3]
        expected = {"image": (height, width, 3), "box": (4,), "label": (), "visible": (height, width)}
        for name, rest in expected.items():
            if np.shape(getattr(self, name)) != (number, *rest):
                raise ShapeError(f"Expected {name} with shape {(number, *rest)}, got {np.shape(getattr(self, name))}.")
        if not np.isin(self.label, np.arange(len(CLASSES))).all():
            raise InputError(f"Expected labels from 0 to {len(CLASSES) - 1}, got {sorted(set(self.label.tolist()))}.")

    def __len__(self) -> int:
        return len(self.image)

    @property
    def names(self) -> list[str]:
        """The class of each image by name."""
        return [CLASSES[label] for label in self.label]

    @property
    def size(self) -> tuple[int, int]:
        """(width, height) of the images, px."""
        return self.image.shape[2], self.image.shape[1]

    def within(self, region: Sequence[float]) -> LabelledImages:
        """A part of all images, without those whose box lies in it by less than three quarters.

        Args:
            region: (left, top, right, bottom), shares of the images' sides.

        Raises:
            InputError: no part of an image.
        """
        check_region(region)
        corner, shown = part_of(np.moveaxis(self.visible, 0, -1), region)
        height, width = shown.shape[:2]
        low, high = self.box[:, :2] - self.box[:, 2:] / 2.0 - corner, self.box[:, :2] + self.box[:, 2:] / 2.0 - corner
        limit = np.array([width, height]) - 0.5
        inside = np.clip(low, -0.5, limit), np.clip(high, -0.5, limit)
        kept = (inside[1] - inside[0]).prod(-1) >= _INSIDE * (high - low).prod(-1)
        box = np.concatenate([(inside[0] + inside[1]) / 2.0, inside[1] - inside[0]], -1)
        left, top = corner
        part = np.s_[kept, top : top + height, left : left + width]
        return LabelledImages(self.image[part], box[kept], self.label[kept], self.visible[part])

    def __getitem__(self, index: Int[np.ndarray, "chosen"] | slice) -> LabelledImages:
        """Some of the images, in the order asked for."""
        return LabelledImages(self.image[index], self.box[index], self.label[index], self.visible[index])

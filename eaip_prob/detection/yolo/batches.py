"""Batches of changed images, with the boxes in them, for training."""

from __future__ import annotations

import numpy as np
import torch
from jaxtyping import Float, Int
from torch import Tensor

from eaip_prob.detection.labelled import LabelledImages
from eaip_prob.detection.yolo.augmentation import Augmentation, recolored
from eaip_prob.detection.yolo.detector import as_tensor
from eaip_prob.detection.yolo.loss import Targets
from eaip_prob.detection.yolo.network import CELL
from eaip_prob.detection.yolo.pasting import cut_out, pasted

_WHOLE = 0.85  # least share of the box's sides that the visible pixels span, of an object that is cut out


class Batches:
    """Labelled images, changed anew each time that they are asked for, with objects of others pasted in.

    Args:
        images: to change.
        scale: px of the network's input in one of an image.
        augmentation: how they are changed.

    Example:
        >>> images = LabelledImages(
        ...     np.full((2, 90, 160, 3), 99, np.uint8), np.tile([80.0, 45.0, 30.0, 40.0], (2, 1)), np.array([0, 3]),
        ...     np.ones((2, 90, 160), bool),
        ... )
        >>> tensor, truth = Batches(images, 0.4, Augmentation()).batch(
        ...     np.array([1, 0]), (64, 32), np.random.default_rng(0)
        ... )
        >>> tensor.shape, truth.label[:1].tolist()
        (torch.Size([2, 3, 32, 64]), [3])
    """

    def __init__(self, images: LabelledImages, scale: float, augmentation: Augmentation) -> None:
        self._images, self._scale, self._augmentation = images, scale, augmentation
        self._whole = np.flatnonzero([_spans(images, index) for index in range(len(images))])

    def batch(
        self, chosen: Int[np.ndarray, "batch"], size: tuple[int, int], generator: np.random.Generator
    ) -> tuple[Tensor, Targets]:
        """Images as the network takes them, and their boxes in cells.

        Args:
            chosen: numbers of images.
            size: (width, height) of all images in the batch, px; multiples of 32.
            generator: of all changes.
        """
        pictures, boxes, labels, owners = [], [], [], []
        for place, index in enumerate(chosen):
            picture, box, label = self._one(int(index), size, generator)
            pictures.append(picture)
            boxes.append(box)
            labels += label
            owners += [place] * len(label)
        limit = np.array([*size, np.inf, np.inf]) - 1e-3  # a centre on the edge belongs to the last cell
        box = np.minimum(np.concatenate(boxes), limit) / CELL
        truth = Targets(torch.tensor(owners), torch.from_numpy(box.astype(np.float32)), torch.tensor(labels))
        return as_tensor(np.stack(pictures)).contiguous(memory_format=torch.channels_last), truth

    def _one(
        self, index: int, size: tuple[int, int], generator: np.random.Generator
    ) -> tuple[np.ndarray, Float[np.ndarray, "boxes 4"], list[int]]:
        images, change = self._images, self._augmentation
        picture, box = change.reframed(
            images.image[index], images.box[index], images.visible[index], size, self._scale, generator
        )
        boxes, labels = box[None], [int(images.label[index])]
        for _ in range(int(generator.integers(change.paste + 1)) if len(self._whole) else 0):
            other = int(generator.choice(self._whole))
            where = pasted(picture, boxes, *self._piece(other, generator), generator)
            if where is not None:
                boxes, labels = np.concatenate([boxes, where[None]]), [*labels, int(images.label[other])]
        return change.lit(picture, generator), boxes, labels

    def _piece(self, index: int, generator: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
        images, change = self._images, self._augmentation
        zoom, stretch = (top ** generator.uniform(-1.0, 1.0) for top in (change.zoom, change.stretch))
        factor = (self._scale * zoom * np.sqrt(stretch), self._scale * zoom / np.sqrt(stretch))
        recolor = generator.random() < change.recolor
        piece, mask = cut_out(
            images.image[index],
            images.box[index],
            images.visible[index],
            factor,
            (lambda image: recolored(image, generator)) if recolor else (lambda image: image),
        )
        return (piece[:, ::-1], mask[:, ::-1]) if generator.random() < 0.5 else (piece, mask)


def _spans(images: LabelledImages, index: int) -> bool:
    rows, columns = np.nonzero(images.visible[index])
    if not len(rows):
        return False
    spans = np.array([np.ptp(columns) + 1, np.ptp(rows) + 1])
    return bool((spans >= _WHOLE * images.box[index, 2:]).all())

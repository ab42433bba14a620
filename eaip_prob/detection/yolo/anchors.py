"""Anchors from the boxes of the training images: k medians under the distance 1 - IoU (Redmon and Farhadi 2017)."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float

from eaip_prob.errors import InputError, ShapeError

_ROUNDS = 100


def shape_iou(
    boxes: Float[np.ndarray, "boxes 2"], anchors: Float[np.ndarray, "anchors 2"]
) -> Float[np.ndarray, "boxes anchors"]:
    """Intersection over union of boxes that share their centre.

    Args:
        boxes: (N, 2), width and height.
        anchors: (A, 2), in the same unit.

    Example:
        >>> shape_iou(np.array([[2.0, 2.0]]), np.array([[2.0, 2.0], [1.0, 4.0]])).round(3).tolist()
        [[1.0, 0.333]]
    """
    common = np.minimum(boxes[:, None], anchors[None]).prod(-1)
    return common / (boxes.prod(-1)[:, None] + anchors.prod(-1)[None] - common)


def anchors_from_boxes(
    boxes: Float[np.ndarray, "boxes 2"], num: int, generator: np.random.Generator
) -> Float[np.ndarray, "anchors 2"]:
    """Widths and heights that the boxes gather around, the smallest area first.

    Args:
        boxes: (N, 2), width and height; the unit of the result.
        num: A, of anchors.
        generator: of the start, which is spread out as in k-means++.

    Raises:
        ShapeError: boxes of another shape.
        InputError: fewer different boxes than anchors, or boxes without area.

    Example:
        >>> boxes = np.array([[1.0, 2.0], [1.1, 2.0], [0.9, 2.0], [8.0, 4.0], [8.0, 5.0], [8.0, 4.5]])
        >>> anchors_from_boxes(boxes, 2, np.random.default_rng(0)).tolist()
        [[1.0, 2.0], [8.0, 4.5]]
    """
    if np.ndim(boxes) != 2 or np.shape(boxes)[1] != 2:
        raise ShapeError(f"Expected boxes with shape (N, 2), width and height, got {np.shape(boxes)}.")
    if not (np.isfinite(boxes).all() and (boxes > 0).all()) or len(np.unique(boxes, axis=0)) < num or num < 1:
        raise InputError(f"Expected at least {max(num, 1)} different boxes with an area, got {len(boxes)} boxes.")
    anchors = _spread_out(boxes, num, generator)
    nearest = np.full(len(boxes), -1)
    for _ in range(_ROUNDS):
        before, nearest = nearest, shape_iou(boxes, anchors).argmax(1)
        if (before == nearest).all():
            break
        groups = [boxes[nearest == index] for index in range(num)]
        anchors = np.stack([np.median(group, 0) if len(group) else anchors[i] for i, group in enumerate(groups)])
    return anchors[np.argsort(anchors.prod(-1))]


def _spread_out(boxes: np.ndarray, num: int, generator: np.random.Generator) -> np.ndarray:
    chosen = boxes[generator.integers(len(boxes))][None]
    while len(chosen) < num:
        far = (1.0 - shape_iou(boxes, chosen).max(1)).clip(0.0)
        chosen = np.concatenate([chosen, boxes[generator.choice(len(boxes), p=far / far.sum())][None]])
    return chosen

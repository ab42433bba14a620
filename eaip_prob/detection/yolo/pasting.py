"""Objects cut out of one labelled image and pasted into another: more boxes to learn from in each image."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from jaxtyping import Bool, Float, UInt8

from eaip_prob.errors import InputError

_CROWDED = 0.15  # of the smaller box, from which two boxes share too much
_TRIES = 4


def pasted(
    target: UInt8[np.ndarray, "rows columns 3"],
    boxes: Float[np.ndarray, "boxes 4"],
    piece: UInt8[np.ndarray, "high wide 3"],
    mask: Bool[np.ndarray, "high wide"],
    generator: np.random.Generator,
) -> Float[np.ndarray, "4"] | None:
    """Writes a piece into an image where it hides little of what is labelled; None where there is no such place.

    Args:
        target: image; written to.
        boxes: (N, 4), centre and size of what is labelled there, from the edge of the first pixel, px.
        piece: cut-out that fills its box.
        mask: pixels of the piece that are of the object.
        generator: of the place.

    Returns:
        (4,), centre and size of the box of the piece.

    Raises:
        InputError: a mask of another size than the piece.

    Example:
        >>> image, piece = np.zeros((40, 60, 3), np.uint8), np.full((10, 8, 3), 255, np.uint8)
        >>> where = pasted(image, np.zeros((0, 4)), piece, np.ones((10, 8), bool), np.random.default_rng(0))
        >>> where[2:].tolist(), int((image > 0).all(-1).sum())
        ([8.0, 10.0], 80)
    """
    if mask.shape != piece.shape[:2]:
        raise InputError(f"Expected a mask with shape {piece.shape[:2]}, got {mask.shape}.")
    (rows, columns), (high, wide) = target.shape[:2], mask.shape
    if high >= rows or wide >= columns:
        return None
    for _ in range(_TRIES):
        left, top = int(generator.integers(columns - wide + 1)), int(generator.integers(rows - high + 1))
        box = np.array([left + wide / 2, top + high / 2, wide, high])
        if not len(boxes) or _shared(box, boxes).max() < _CROWDED:
            target[top : top + high, left : left + wide][mask] = piece[mask]
            return box
    return None


def cut_out(
    image: UInt8[np.ndarray, "height width 3"],
    box: Float[np.ndarray, "4"],
    visible: Bool[np.ndarray, "height width"],
    factor: tuple[float, float],
    change: Callable[[np.ndarray], np.ndarray] = lambda piece: piece,
) -> tuple[UInt8[np.ndarray, "high wide 3"], Bool[np.ndarray, "high wide"]]:
    """What a box shows, at another size, and which pixels of it are of the object.

    Args:
        image: RGB.
        box: (4,), centre column, centre row, width and height, px.
        visible: pixels that show the object.
        factor: on width and height.
        change: of the piece, RGB from 0 to 1.

    Example:
        >>> image, visible = np.full((30, 40, 3), 7, np.uint8), np.ones((30, 40), bool)
        >>> piece, mask = cut_out(image, np.array([19.5, 14.5, 20.0, 10.0]), visible, (0.5, 0.5))
        >>> piece.shape, bool(mask.all())
        ((5, 10, 3), True)
    """
    import cv2

    left, top = np.floor(box[:2] + 0.5 - box[2:] / 2 + 0.5).astype(int)
    right, bottom = np.maximum(np.floor(box[:2] + 0.5 + box[2:] / 2 + 0.5).astype(int), (left + 1, top + 1))
    size = (max(round((right - left) * factor[0]), 1), max(round((bottom - top) * factor[1]), 1))
    method = cv2.INTER_AREA if max(factor) < 1.0 else cv2.INTER_LINEAR
    piece = cv2.resize(image[top:bottom, left:right], size, interpolation=method)
    mask = cv2.resize(visible[top:bottom, left:right].astype(np.float32), size, interpolation=method) > 0.5
    return (255.0 * change(piece.astype(np.float32) / 255.0).clip(0.0, 1.0)).astype(np.uint8), mask


def _shared(box: np.ndarray, boxes: np.ndarray) -> np.ndarray:
    low = np.maximum(box[:2] - box[2:] / 2, boxes[:, :2] - boxes[:, 2:] / 2)
    high = np.minimum(box[:2] + box[2:] / 2, boxes[:, :2] + boxes[:, 2:] / 2)
    return (high - low).clip(0.0).prod(-1) / np.minimum(box[2:].prod(), boxes[:, 2:].prod(-1))

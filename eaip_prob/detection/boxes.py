"""How far boxes overlap, and which of several that do are kept. A box is centre column, centre row, width, height."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float, Int, Shaped


def box_iou(first: Float[np.ndarray, "*batch 4"], second: Float[np.ndarray, "*batch 4"]) -> Float[np.ndarray, "*batch"]:
    """Intersection over union of boxes, pair by pair.

    Args:
        first: (*batch, 4), in any unit.
        second: (*batch, 4), in the same unit; batch axes broadcast.

    Example:
        >>> float(box_iou(np.array([2.0, 1.0, 4.0, 2.0]), np.array([3.0, 1.0, 2.0, 2.0])))
        0.5
    """
    low = np.maximum(first[..., :2] - first[..., 2:] / 2.0, second[..., :2] - second[..., 2:] / 2.0)
    high = np.minimum(first[..., :2] + first[..., 2:] / 2.0, second[..., :2] + second[..., 2:] / 2.0)
    shared = np.maximum(high - low, 0.0).prod(-1)
    return shared / np.maximum(first[..., 2:].prod(-1) + second[..., 2:].prod(-1) - shared, 1e-9)


def suppressed(
    box: Float[np.ndarray, "boxes 4"],
    score: Float[np.ndarray, "boxes"],
    label: Shaped[np.ndarray, "boxes"] | None = None,
    overlap: float = 0.45,
) -> Int[np.ndarray, "kept"]:
    """Places of the boxes that are kept, the best first: none overlaps a better one.

    Args:
        box: (N, 4).
        score: (N,).
        label: (N,), so that only boxes of one label count; all do if None.
        overlap: largest IoU that is no overlap.

    Example:
        >>> box = np.array([[5.0, 5.0, 4.0, 4.0], [5.0, 5.5, 4.0, 4.0], [5.0, 5.5, 4.0, 4.0]])
        >>> suppressed(box, np.array([0.6, 0.9, 0.5]), np.array(["chair", "chair", "table"])).tolist()
        [1, 2]
    """
    left, kept = np.argsort(-score, kind="stable"), []
    while len(left):
        first, left = left[0], left[1:]
        kept.append(first)
        rival = box_iou(box[left], box[first]) > overlap
        left = left[~(rival if label is None else rival & (label[left] == label[first]))]
    return np.array(kept, dtype=np.int64)

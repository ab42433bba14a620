"""Of several looks at an object the one to go by: placed in the world before not placed, then the most certain."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from eaip_prob.detection import Detections


def best_look(looks: Sequence[Detections]) -> Detections:
    """The most certain object of the best look; of no object where none was found.

    Args:
        looks: at least one.

    Example:
        >>> box, far, near = np.array([[9.0, 9.0, 4.0, 4.0]]), np.full((1, 6), np.nan), np.ones((1, 6))
        >>> unplaced = Detections(("chair",), np.array([0.9]), box, (20, 20), None, far, np.full((1, 6, 6), np.nan))
        >>> placed = Detections(("table",), np.array([0.6]), box, (20, 20), None, near, np.eye(6)[None])
        >>> best_look([Detections.none((20, 20)), unplaced, placed]).labels
        ('table',)
    """
    return max(looks, key=_worth)[:1]


def _worth(look: Detections) -> tuple[bool, float]:
    if not len(look):
        return False, -1.0
    return look.place is not None and bool(np.isfinite(look.place[0]).all()), float(look.score[0])

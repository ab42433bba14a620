"""Of several looks at an object the one to go by: well placed in the world before badly or not, then most certain."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from eaip_prob.detection import Detections

WELL_PLACED = 0.10  # m; largest standard deviation of a place, which a bag that hangs together with the object exceeds


def best_look(looks: Sequence[Detections]) -> Detections:
    """The most certain object of the best look; of no object where none was found.

    Args:
        looks: at least one.

    Example:
        >>> box, far, near = np.array([[9.0, 9.0, 4.0, 4.0]]), np.full((1, 6), np.nan), np.ones((1, 6))
        >>> unplaced = Detections(("chair",), np.array([0.9]), box, (20, 20), None, far, np.full((1, 6, 6), np.nan))
        >>> placed = Detections(("table",), np.array([0.6]), box, (20, 20), None, near, 1e-4 * np.eye(6)[None])
        >>> best_look([Detections.none((20, 20)), unplaced, placed]).labels
        ('table',)
    """
    return max(looks, key=_worth)[:1]


def _worth(look: Detections) -> tuple[bool, bool, float]:
    if not len(look):
        return False, False, -1.0
    if look.place is None or look.place_covariance is None or not np.isfinite(look.place[0]).all():
        return False, False, float(look.score[0])
    deviation = np.sqrt(look.place_covariance[0].diagonal())
    return bool((deviation <= WELL_PLACED).all()), True, float(look.score[0])

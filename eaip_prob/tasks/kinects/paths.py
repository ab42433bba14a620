"""Where a covering person's hands are: short scripted motions, each with something that makes tracking hard.

The person faces the robot, so that the left hand is at negative y (world frame: x from the robot to the person, y to
the robot's left, z up). Between way-points hands move with least jerk, and rest at each.

| motion | what happens |
|---|---|
| free | both hands rise, draw the bag over the object and come down |
| touching | the gloves meet, stay together and part |
| crossing | the hands change sides, one passing above the other, and change back |
| shelf | one hand reaches into the object, a shelf that is open towards the person, where no camera sees it |
| bag | one hand lets go of the bag, reaches below its cloth, where no camera sees it, and comes back |
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from eaip_prob.errors import InputError

RATE = 30.0  # frames a second of a Kinect

_Point = tuple[float, float, float]
MOTIONS: Mapping[str, Sequence[tuple[float, _Point, _Point]]] = {  # (s, left hand, right hand), m in the world
    "free": (
        (0.0, (1.35, -0.28, 0.05), (1.35, 0.28, 0.05)),
        (1.2, (1.25, -0.32, 0.50), (1.25, 0.30, 0.45)),
        (2.2, (1.05, -0.34, 0.45), (1.05, 0.33, 0.50)),
        (3.2, (1.10, -0.32, 0.10), (1.10, 0.32, 0.05)),
    ),
    "touching": (
        (0.0, (1.30, -0.25, 0.35), (1.30, 0.25, 0.35)),
        (0.9, (1.25, -0.052, 0.40), (1.25, 0.052, 0.40)),
        (1.5, (1.22, -0.052, 0.45), (1.22, 0.052, 0.45)),
        (2.4, (1.25, -0.28, 0.40), (1.25, 0.28, 0.40)),
    ),
    "crossing": (
        (0.0, (1.30, -0.22, 0.48), (1.28, 0.22, 0.32)),
        (1.2, (1.30, 0.16, 0.50), (1.28, -0.16, 0.28)),
        (2.4, (1.30, -0.22, 0.48), (1.28, 0.22, 0.32)),
    ),
    "shelf": (
        (0.0, (1.38, -0.25, 0.20), (1.35, 0.28, 0.30)),
        (0.8, (1.32, -0.08, -0.18), (1.30, 0.32, 0.30)),
        (1.4, (1.02, -0.04, -0.18), (1.30, 0.32, 0.32)),
        (1.9, (1.02, 0.02, -0.20), (1.30, 0.32, 0.32)),
        (2.5, (1.32, -0.08, -0.18), (1.28, 0.32, 0.32)),
        (3.2, (1.38, -0.25, 0.20), (1.35, 0.28, 0.30)),
    ),
    "bag": (
        (0.0, (1.32, -0.30, 0.35), (1.32, 0.30, 0.35)),
        (0.5, (1.32, -0.30, 0.35), (1.42, 0.26, 0.12)),
        (1.1, (1.32, -0.30, 0.35), (1.05, 0.10, 0.06)),
        (1.6, (1.32, -0.30, 0.36), (1.02, 0.02, 0.08)),
        (2.2, (1.32, -0.30, 0.36), (1.42, 0.26, 0.12)),
        (2.7, (1.32, -0.30, 0.35), (1.36, 0.34, 0.33)),
    ),
}
_LIPS: Mapping[str, tuple[_Point, _Point]] = {
    "shelf": ((1.38, -0.25, 0.20), (1.35, 0.28, 0.30)),
    "bag": ((1.32, -0.30, 0.35), (1.32, 0.30, 0.35)),
}


@dataclass(frozen=True, eq=False)
class HandPath:
    """Both hands over time, the person's left one first.

    Args:
        time: (T,), s.
        position: (T, 2, 3), centres of the gloves in the world, m.
        lip: (2, 3), where the person's edge of the bag stays, m; None while both hands carry it.

    Example:
        >>> HandPath(np.zeros(1), np.zeros((1, 2, 3))).grippers[0, 0].tolist()
        [0.75, 0.3, 0.1]
    """

    time: Float[np.ndarray, "time"]
    position: Float[np.ndarray, "time hands 3"]
    lip: Float[np.ndarray, "sides 3"] | None = None

    @property
    def grippers(self) -> Float[np.ndarray, "time hands 3"]:
        """Where the robot's left and right gripper rest meanwhile, m."""
        return np.tile([[0.75, 0.3, 0.1], [0.75, -0.3, 0.1]], (len(self.time), 1, 1))

    @property
    def lips(self) -> Float[np.ndarray, "time sides 3"]:
        """Where the person's edge of the bag is held, m."""
        return self.position if self.lip is None else np.tile(self.lip, (len(self.time), 1, 1))


def hand_path(motion: str, rate: float = RATE) -> HandPath:
    """The hands of one motion, frame by frame.

    Args:
        motion: one of `MOTIONS`.
        rate: frames a second.

    Raises:
        InputError: an unknown motion, or a rate not above zero.

    Example:
        >>> path = hand_path("crossing")
        >>> path.time.shape, bool(path.position[36, 0, 1] > path.position[36, 1, 1])
        ((73,), True)
    """
    if motion not in MOTIONS:
        raise InputError(f"Expected a motion among {tuple(MOTIONS)}, got {motion!r}.")
    if not rate > 0:
        raise InputError(f"Expected rate above zero, got {rate}. Give frames a second.")
    points = MOTIONS[motion]
    at = np.array([point[0] for point in points])
    hands = np.array([point[1:] for point in points])
    time = np.arange(round(at[-1] * rate) + 1) / rate
    place = np.clip(np.searchsorted(at, time, side="right") - 1, 0, len(at) - 2)
    share = np.clip((time - at[place]) / (at[place + 1] - at[place]), 0.0, 1.0)
    least_jerk = share**3 * (10.0 - 15.0 * share + 6.0 * share**2)
    position = hands[place] + least_jerk[:, None, None] * (hands[place + 1] - hands[place])
    return HandPath(time, position, np.array(_LIPS[motion]) if motion in _LIPS else None)

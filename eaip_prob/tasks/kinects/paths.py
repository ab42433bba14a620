"""Where a covering person's hands are: short scripted motions, each with something that makes tracking hard.

The person faces the robot, so that the left hand is at negative y (world frame: x from the robot to the person, y to
the robot's left, z up). Between way-points hands move with least jerk, and rest at each.

| scenario | what happens |
|---|---|
| free | both hands rise, draw the bag over the object and come down |
| touching | the gloves meet, stay together and part |
| crossing | the hands change sides, one passing above the other, and change back |
| shelf | one hand reaches down behind the object, where little of it is seen, and comes back |
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from eaip_prob.errors import InputError

RATE = 30.0  # frames a second of a Kinect

_Point = tuple[float, float, float]
SCENARIOS: Mapping[str, Sequence[tuple[float, _Point, _Point]]] = {  # (s, left hand, right hand), m in the world
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
        (0.0, (1.35, -0.25, 0.25), (1.35, 0.28, 0.30)),
        (0.9, (1.22, -0.05, -0.45), (1.30, 0.32, 0.30)),
        (1.6, (1.20, -0.02, -0.50), (1.28, 0.32, 0.32)),
        (2.6, (1.35, -0.25, 0.25), (1.35, 0.28, 0.30)),
    ),
}


@dataclass(frozen=True, eq=False)
class HandPath:
    """Both hands over time, the person's left one first.

    Args:
        time: (T,), s.
        position: (T, 2, 3), centres of the gloves in the world, m.

    Example:
        >>> HandPath(np.zeros(1), np.zeros((1, 2, 3))).grippers[0, 0].tolist()
        [0.75, 0.3, 0.1]
    """

    time: Float[np.ndarray, "time"]
    position: Float[np.ndarray, "time hands 3"]

    @property
    def grippers(self) -> Float[np.ndarray, "time hands 3"]:
        """Where the robot's left and right gripper rest meanwhile, m."""
        rest = np.array([[0.75, 0.3, 0.1], [0.75, -0.3, 0.1]])
        return np.broadcast_to(rest, (len(self.time), 2, 3)).copy()


def hand_path(scenario: str, rate: float = RATE) -> HandPath:
    """The hands of one scenario, frame by frame.

    Args:
        scenario: one of `SCENARIOS`.
        rate: frames a second.

    Raises:
        InputError: an unknown scenario, or a rate not above zero.

    Example:
        >>> path = hand_path("crossing")
        >>> path.time.shape, bool(path.position[36, 0, 1] > path.position[36, 1, 1])
        ((73,), True)
    """
    if scenario not in SCENARIOS:
        raise InputError(f"Expected a scenario among {tuple(SCENARIOS)}, got {scenario!r}.")
    if not rate > 0:
        raise InputError(f"Expected rate above zero, got {rate}. Give frames a second.")
    points = SCENARIOS[scenario]
    at = np.array([point[0] for point in points])
    hands = np.array([point[1:] for point in points])
    time = np.arange(round(at[-1] * rate) + 1) / rate
    place = np.clip(np.searchsorted(at, time, side="right") - 1, 0, len(at) - 2)
    share = np.clip((time - at[place]) / (at[place + 1] - at[place]), 0.0, 1.0)
    least_jerk = share**3 * (10.0 - 15.0 * share + 6.0 * share**2)
    return HandPath(time, hands[place] + least_jerk[:, None, None] * (hands[place + 1] - hands[place]))

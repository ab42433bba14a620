"""Where both hands are, as far as cameras can tell."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import torch
from jaxtyping import Bool, Float

from eaip_prob.data.frames import RGBDFrame
from eaip_prob.data.trajectory import Trajectory
from eaip_prob.errors import InputError

HANDS = ("left", "right")


@dataclass(frozen=True, eq=False)
class HandState:
    """Both hands at one time, the left one first.

    Args:
        time: s.
        position: (2, 3), centres of the gloves in the world, m; where a hand is not seen, where it is held.
        covariance: (2, 3, 3), of the position, m^2; it grows while a hand is not seen.
        seen: (2,), whether cameras saw the hand at this time, or so recently that holding it is as good.

    Example:
        >>> covariance = np.tile(1e-4 * np.eye(3), (2, 1, 1))
        >>> state = HandState(0.1, np.zeros((2, 3)), covariance, np.array([True, False]))
        >>> dict(zip(HANDS, state.seen.tolist()))
        {'left': True, 'right': False}
    """

    time: float
    position: Float[np.ndarray, "hands 3"]
    covariance: Float[np.ndarray, "hands 3 3"]
    seen: Bool[np.ndarray, "hands"]


class AbstractHandTracker(ABC):
    """Follows both hands through the frames of one or more cameras.

    What a tracker knows between frames is passed in and returned, so that one tracker serves any number of people.
    """

    @abstractmethod
    def init(self) -> Any:
        """The state before anything was seen."""

    @abstractmethod
    def step(self, frames: Sequence[RGBDFrame], state: Any, time: float | None = None) -> tuple[HandState | None, Any]:
        """(hands, next state) given the frames of the cameras that delivered one now; None until first seen.

        Args:
            frames: of any cameras; none while all fail.
            state: from `init` or the last step.
            time: s, at which the hands are wanted; default that of the latest frame so far, which stands still while
                all cameras fail.
        """


def hands_to_trajectory(states: Sequence[HandState], correlated: bool = True) -> Trajectory:
    """Both hands as one trajectory of six signals: left_x, left_y, left_z, right_x, right_y, right_z, m.

    A hand that was not seen is masked; the noise is what the tracker is unsure of, the two hands apart from each other.

    Args:
        states: T of them, in the order of their time.
        correlated: False leaves out what errors along different axes have in common: the noise of each signal alone,
            with which fitting is several times faster.

    Raises:
        InputError: no state, or time that does not increase (by `Trajectory`).

    Example:
        >>> at = np.array([[0.9, -0.2, 0.1], [0.9, 0.2, 0.1]])
        >>> state = HandState(0.5, at, np.stack([np.eye(3) * 1e-6] * 2), np.array([True, False]))
        >>> motion = hands_to_trajectory([state])
        >>> motion.names[3], motion.mask[0].tolist()
        ('right_x', [True, True, True, False, False, False])
    """
    if not states:
        raise InputError("Expected at least one state of the hands, got none. Leave out frames before both were seen.")
    count = len(states)
    noise = np.zeros((count, 6, 6))
    for i, state in enumerate(states):
        noise[i, :3, :3], noise[i, 3:, 3:] = state.covariance
    if not correlated:
        noise = noise * np.eye(6)
    return Trajectory(
        time=torch.tensor([state.time for state in states], dtype=torch.float64),
        values=torch.as_tensor(np.stack([state.position for state in states]).reshape(count, 6)),
        names=tuple(f"{hand}_{axis}" for hand in HANDS for axis in "xyz"),
        mask=torch.as_tensor(np.stack([state.seen for state in states]).repeat(3, axis=1)),
        noise=torch.as_tensor(noise),
    )

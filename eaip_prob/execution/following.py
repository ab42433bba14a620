"""How the gripper follows a path that changes: a critically damped attractor with limits, and coming to rest.

    e(t) = (1 + r t) exp(-r t) e(0) + t exp(-r t) e'(0),   position = path + e,   r: rate, 1/s

This is the free response of a DMP with beta_y = alpha_y / 4 and r = alpha_y / (2 duration): from the state in which the
gripper is, it meets the path as `DMP.rollout` does. Steps are exact, so that many short ones are one long one.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from eaip_prob.checks import check_positive

HASTE = 0.6  # by how much faster than the clock the time of a gripper that is late runs
_YIELD = 1.0  # s, over which the haste fades when little is left to make up for


@dataclass(frozen=True)
class MotionLimits:
    """What the gripper may do.

    Args:
        speed: m/s.
        acceleration: while it follows a path, m/s^2.
        deceleration: with which it comes to rest, m/s^2; from 0.5 m/s that takes 0.5 s and 0.13 m by default.

    Raises:
        InputError: a limit that is not above zero and finite.

    Example:
        >>> MotionLimits(speed=0.5)
        MotionLimits(speed=0.5, acceleration=2.0, deceleration=1.0)
    """

    speed: float = 1.0
    acceleration: float = 2.0
    deceleration: float = 1.0

    def __post_init__(self) -> None:
        for name in ("speed", "acceleration", "deceleration"):
            check_positive(name, getattr(self, name))

    def keeps(self, velocity: Float[np.ndarray, "times 3"], time: Float[np.ndarray, "times"]) -> bool:
        """Whether velocities, m/s, at these times, s, are within speed and acceleration."""
        change = np.linalg.norm(np.diff(velocity, axis=0), axis=-1)
        slow = np.linalg.norm(velocity, axis=-1).max() <= self.speed
        return bool(slow and (change <= self.acceleration * np.diff(time)).all())


def free_response(
    elapsed: Float[np.ndarray, "*times"] | float, rate: float
) -> tuple[Float[np.ndarray, "*times 2"], Float[np.ndarray, "*times 2"]]:
    """What a distance from the path and its velocity leave: (of the distance, of its velocity).

    Args:
        elapsed: s, at least 0; any shape, of which the results have one axis more.
        rate: of the attractor, 1/s.

    Returns:
        Columns for [distance, its velocity] at the beginning.

    Example:
        >>> distance, velocity = free_response(np.array([1.0, 20.0]), rate=2.0)
        >>> distance.round(3).tolist(), velocity[0].round(3).tolist()
        ([[0.406, 0.135], [0.0, 0.0]], [-0.541, -0.135])
    """
    elapsed = np.asarray(elapsed, dtype=np.float64)
    decay = np.exp(-rate * elapsed)
    distance = np.stack([(1.0 + rate * elapsed) * decay, elapsed * decay], -1)
    velocity = np.stack([-(rate**2) * elapsed * decay, (1.0 - rate * elapsed) * decay], -1)
    return distance, velocity


def lateness(late: float, elapsed: Float[np.ndarray, "*times"], haste: float = HASTE) -> Float[np.ndarray, "*times"]:
    """How late a gripper still is after a while of making up for it along the path, s.

    Its own time runs faster than the clock, by no more than what is left to make up asks for: phase stopping of a
    movement primitive (Ijspeert et al., Neural Computation 25, 2013) the other way round. A gripper that waited thus
    takes the whole path, where one that were drawn to the present point would cut through what the path leads over.

    Args:
        late: at first, s, at least 0.
        elapsed: since then, s.
        haste: by how much faster than the clock its time runs at most, above zero.

    Example:
        >>> lateness(1.2, np.array([0.0, 1.0, 9.0])).round(3).tolist()
        [1.2, 0.6, 0.0]
    """
    steady = haste * _YIELD
    until = max(late - steady, 0.0) / haste
    # Before `until` the exponential is not used, and after a long wait it would overflow.
    straight, fading = late - haste * elapsed, min(late, steady) * np.exp(-np.maximum(elapsed - until, -1.0) / _YIELD)
    return np.where(elapsed < until, straight, fading) if until > 0 else fading


def followed(
    now: Float[np.ndarray, "2 3"],
    path: Float[np.ndarray, "2 2 3"],
    elapsed: float,
    rate: float,
    limits: MotionLimits,
) -> Float[np.ndarray, "2 3"]:
    """Position and velocity a moment later, drawn to a moving point; exact where no limit is met.

    Args:
        now: position, m, and velocity, m/s.
        path: position and velocity of the point, now and then.
        elapsed: s.
        rate: of the attractor, 1/s.
        limits: velocity changes no faster, and is no larger.

    Example:
        >>> still = np.zeros((2, 2, 3))
        >>> followed(np.array([[0.3, 0, 0], [0, 0, 0]]), still, 0.1, 1.25, MotionLimits()).round(3)[:, 0].tolist()
        [0.298, -0.041]
    """
    apart = now - path[0]
    wanted = path[1] + np.stack([response @ apart for response in free_response(elapsed, rate)])
    change = wanted[1] - now[1]
    fast = np.linalg.norm(change) > limits.acceleration * elapsed
    if not fast and np.linalg.norm(wanted[1]) <= limits.speed:
        return wanted
    # Cutting to the speed brings two velocities within it no farther apart: the acceleration stays within its limit.
    velocity = _shortened(now[1] + _shortened(change, limits.acceleration * elapsed), limits.speed)
    return np.stack([now[0] + 0.5 * elapsed * (now[1] + velocity), velocity])


def between(
    time: Float[np.ndarray, "times"],
    path: Float[np.ndarray, "times 3"],
    velocity: Float[np.ndarray, "times 3"],
    at: float,
) -> Float[np.ndarray, "2 3"]:
    """Position and velocity at one time, by the cubic polynomial between two samples; at rest behind the last.

    Args:
        time: (S,), s, increasing; S at least 2.
        path: (S, 3), m.
        velocity: (S, 3), m/s.
        at: s.

    Example:
        >>> between(np.array([0.0, 2.0]), np.eye(2, 3), np.zeros((2, 3)), 1.0).tolist()
        [[0.5, 0.5, 0.0], [-0.75, 0.75, 0.0]]
    """
    if at >= time[-1]:
        return np.stack([path[-1], np.zeros(3)])
    k = max(int(np.searchsorted(time, at, side="right")) - 1, 0)
    step = time[k + 1] - time[k]
    s = max(at - time[k], 0.0) / step
    corners = np.stack([path[k], step * velocity[k], path[k + 1], step * velocity[k + 1]])
    position = np.array([2 * s**3 - 3 * s**2 + 1, s**3 - 2 * s**2 + s, 3 * s**2 - 2 * s**3, s**3 - s**2])
    turning = np.array([6 * s**2 - 6 * s, 3 * s**2 - 4 * s + 1, 6 * s - 6 * s**2, 3 * s**2 - 2 * s])
    return np.stack([position @ corners, turning @ corners / step])


def slowed(now: Float[np.ndarray, "2 3"], elapsed: float, deceleration: float) -> Float[np.ndarray, "2 3"]:
    """Position and velocity a moment later on a straight way to rest.

    Args:
        now: position, m, and velocity, m/s.
        elapsed: s.
        deceleration: m/s^2.

    Example:
        >>> slowed(np.array([[0.0, 0, 0], [0.5, 0, 0]]), 2.0, 1.0)[:, 0].tolist()
        [0.125, 0.0]
    """
    speed = float(np.linalg.norm(now[1]))
    if speed == 0.0:
        return now
    moving = min(elapsed, speed / deceleration)
    left = 0.0 if moving < elapsed else 1.0 - deceleration * moving / speed
    return np.stack([now[0] + now[1] * (moving - 0.5 * deceleration * moving**2 / speed), left * now[1]])


def _shortened(vector: np.ndarray, longest: float) -> np.ndarray:
    """The vector itself, or one along it of the length allowed."""
    length = float(np.linalg.norm(vector))
    return vector if length <= longest else vector * (longest / length)

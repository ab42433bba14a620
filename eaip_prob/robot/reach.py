"""Whether an arm can carry out a motion of its tip: within reach, within the joint limits, and fast enough."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float

from eaip_prob.errors import ShapeError
from eaip_prob.robot._following import REACHED
from eaip_prob.robot._inputs import checked_samples, checked_time
from eaip_prob.robot.inverse import follow
from eaip_prob.robot.kinematics import SerialArm


@dataclass(frozen=True, eq=False)
class MotionCheck:
    """What an arm makes of a motion; T samples, J joints.

    Args:
        joints: (T, J), rad.
        error: (T,), distance of the tip from the path, m.
        reached: (T,), where that is at most 1 mm.
        within_limits: whether no joint angle is beyond its limits.
        speed_share: largest share of a joint's speed limit between two samples; above 1 is too fast.
        reason: why the motion cannot be carried out, as a sentence; None if it can.

    Example:
        >>> MotionCheck(np.zeros((1, 7)), np.zeros(1), np.ones(1, bool), True, 0.0, None).possible
        True
    """

    joints: Float[np.ndarray, "time joints"]
    error: Float[np.ndarray, "time"]
    reached: Bool[np.ndarray, "time"]
    within_limits: bool
    speed_share: float
    reason: str | None

    @property
    def possible(self) -> bool:
        """Whether there is no reason against it."""
        return self.reason is None


def check_motion(
    arm: SerialArm,
    time: Sequence[float] | Float[np.ndarray, "time"],
    path: Float[np.ndarray, "time 3"],
    start: Sequence[float] | Float[np.ndarray, "joints"] | None = None,
    tolerance: float = REACHED,
) -> MotionCheck:
    """Joint angles for a motion of the tip (see `follow`), and what is against it.

    Args:
        arm: that is to move.
        time: (T,), s, increasing.
        path: (T, 3), positions of the tip in the arm's base, m.
        start: (J,), joint angles from where the first sample is sought, rad; the way to it is not judged.
        tolerance: distance up to which a sample is not called out of reach, m; the tip passes by it that near.

    Raises:
        ShapeError: arrays of other shapes, an empty path.
        InputError: NaN or infinity, times that do not increase, a start outside the joint limits.

    Example:
        >>> from eaip_prob.robot import baxter_left_arm
        >>> across = np.column_stack([np.full(50, 0.5), np.linspace(-0.4, 0.4, 50), np.full(50, 0.1)])
        >>> check_motion(baxter_left_arm(), np.linspace(0.0, 5.0, 50), across).possible
        True
        >>> check_motion(baxter_left_arm(), [0.0, 1.0], [[0.5, 0.0, 0.1], [2.0, 0.0, 0.1]]).reason[:44]
        'Sample 1 at 1.00 s, (2.00, 0.00, 0.10) m, is'
    """
    points = checked_samples("path", path, 3, "positions of the tip")
    checked_time(time, len(points))
    return check_joints(arm, time, follow(arm, points, start).joints, points, tolerance)


def check_joints(
    arm: SerialArm,
    time: Sequence[float] | Float[np.ndarray, "time"],
    joints: Float[np.ndarray, "time joints"],
    path: Float[np.ndarray, "time 3"],
    tolerance: float = REACHED,
) -> MotionCheck:
    """The same for joint angles that come from elsewhere: another planner, a recording.

    Args:
        arm: that is to move.
        time: (T,), s, increasing.
        joints: (T, J), rad.
        path: (T, 3), where the tip should be, m.
        tolerance: distance up to which a sample is not called out of reach, m.

    Raises:
        ShapeError: arrays of other shapes, an empty path.
        InputError: NaN or infinity, times that do not increase.

    Example:
        >>> from eaip_prob.robot import baxter_left_arm
        >>> arm = baxter_left_arm()
        >>> still = np.tile(arm.posture, (2, 1))
        >>> round(check_joints(arm, [0.0, 0.1], still + [[0.0], [0.2]], arm.tip(still)).speed_share, 9)
        1.333333333
    """
    points = checked_samples("path", path, 3, "positions of the tip")
    angles = checked_samples("joints", joints, arm.num_joints, "one for each joint")
    if len(points) != len(angles):
        raise ShapeError(f"Expected as many joints as samples of the path, got {len(angles)} and {len(points)}.")
    times = checked_time(time, len(points))
    error = np.linalg.norm(arm.tip(angles) - points, axis=1)
    within = arm.allows(angles)
    shares = np.abs(np.diff(angles, axis=0)) / np.diff(times)[:, None] / np.asarray(arm.speed)
    reason = (
        _out_of_reach(times, points, error, tolerance)
        or _beyond_limits(arm, times, angles, within)
        or _too_fast(arm, times, shares)
    )
    return MotionCheck(angles, error, error <= REACHED, bool(within.all()), float(shares.max(initial=0.0)), reason)


def _out_of_reach(times: np.ndarray, points: np.ndarray, error: np.ndarray, tolerance: float) -> str | None:
    missed = np.flatnonzero(error > tolerance)
    if len(missed) == 0:
        return None
    first, worst = int(missed[0]), int(error.argmax())
    at = ", ".join(f"{value:.2f}" for value in points[first])
    return (
        f"Sample {first} at {times[first]:.2f} s, ({at}) m, is out of reach by {error[first]:.3f} m; {len(missed)} of "
        f"{len(times)} samples are, the worst by {error[worst]:.3f} m at {times[worst]:.2f} s."
    )


def _beyond_limits(arm: SerialArm, times: np.ndarray, joints: np.ndarray, within: np.ndarray) -> str | None:
    outside = np.argwhere(~within)
    if len(outside) == 0:
        return None
    sample, joint = (int(index) for index in outside[0])
    angle = joints[sample, joint]
    return (
        f"Joint {arm.names[joint]} stands at {angle:.3f} rad at {times[sample]:.2f} s (sample {sample}), "
        f"but turns only from {arm.lower[joint]:.3f} to {arm.upper[joint]:.3f} rad."
    )


def _too_fast(arm: SerialArm, times: np.ndarray, shares: np.ndarray) -> str | None:
    if shares.max(initial=0.0) <= 1.0:
        return None
    step, joint = (int(index) for index in np.unravel_index(shares.argmax(), shares.shape))
    share, limit = shares[step, joint], arm.speed[joint]
    return (
        f"Joint {arm.names[joint]} would turn at {share * limit:.2f} rad/s from {times[step]:.2f} to "
        f"{times[step + 1]:.2f} s, {share:.2f} times its limit of {limit:.2f} rad/s."
    )

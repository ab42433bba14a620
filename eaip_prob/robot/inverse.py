"""From a path of the tip to joint angles that lead the tip along it; how the tool is turned is left free.

Compiled with numba at the first call (a few seconds), then cached on disk.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from jaxtyping import Bool, Float

from eaip_prob.errors import InputError
from eaip_prob.robot._following import REACHED, best_path, follow_path
from eaip_prob.robot._inputs import checked_samples, checked_vector
from eaip_prob.robot.kinematics import SerialArm

NUM_SEEDS = 6


@dataclass(frozen=True, eq=False)
class JointPath:
    """Joint angles along a path; T samples, J joints.

    Args:
        joints: (T, J), rad, always within the joint limits.
        error: (T,), distance of the tip from the path, m.
        reached: (T,), where that is at most 1 mm. Elsewhere the tip is as near as it was brought.

    Example:
        >>> JointPath(np.zeros((1, 7)), np.zeros(1), np.ones(1, bool)).joints.shape
        (1, 7)
    """

    joints: Float[np.ndarray, "time joints"]
    error: Float[np.ndarray, "time"]
    reached: Bool[np.ndarray, "time"]


def follow(
    arm: SerialArm,
    path: Float[np.ndarray, "time 3"],
    start: Sequence[float] | Float[np.ndarray, "joints"] | None = None,
) -> JointPath:
    """Joint angles that lead the tip along a path, by damped least squares from sample to sample.

    Of all joint angles that put the tip in place it takes those near the sample before, drawn to the arm's posture by
    (1 - exp(-way / 0.5 m)) for the way of the tip; joints at their limits stay there. Without a start, it sets
    out near the posture; where samples are missed or a step is long (0.1 s at full speed), it tries other starts and
    keeps the path that reaches most samples; of those the one that misses least, or whose longest step is shortest.
    A sample that is missed is sought from the posture too: a joint path that jumps there is too fast, not out of reach.

    Args:
        arm: whose tip.
        path: (T, 3), positions in the arm's base, m.
        start: (J,), joint angles from where the first sample is sought, rad; those before this path, for one that goes
            on. None tries several.

    Raises:
        ShapeError: a path or start of another shape, an empty path.
        InputError: NaN or infinity, a start outside the joint limits.

    Example:
        >>> from eaip_prob.robot import baxter_left_arm
        >>> arm = baxter_left_arm()
        >>> across = np.column_stack([np.full(50, 0.5), np.linspace(-0.4, 0.4, 50), np.full(50, 0.1)])
        >>> moved = follow(arm, across)
        >>> bool(moved.reached.all()), bool(np.abs(arm.tip(moved.joints) - across).max() < 1e-5)
        (True, True)
    """
    points = checked_samples("path", path, 3, "positions of the tip")
    joints, error = np.empty((len(points), arm.num_joints)), np.empty(len(points))
    if start is None:
        best_path(arm.constants, points, _seeds(arm).copy(), joints, error)
    else:
        follow_path(arm.constants, points, _checked_start(arm, start), joints, error)
    return JointPath(joints, error, error <= REACHED)


def _checked_start(arm: SerialArm, start: Sequence[float] | np.ndarray) -> np.ndarray:
    values = checked_vector("start", start, arm.num_joints, "one for each joint")
    outside = np.flatnonzero(~arm.allows(values, slack=1e-3))
    if len(outside):
        i = int(outside[0])
        raise InputError(
            f"Expected a start within the joint limits, got {values[i]:.4f} rad for {arm.names[i]}, which turns from "
            f"{arm.lower[i]:.4f} to {arm.upper[i]:.4f} rad. Clip what was measured, or leave out the start."
        )
    return np.clip(values, arm.lower, arm.upper)


@lru_cache(maxsize=8)
def _seeds(arm: SerialArm) -> np.ndarray:
    """(N, J): the posture, then joint angles spread evenly over the limits.

    An additive recurrence with the root of x^(J + 1) = x + 1 leaves no gaps in any number of dimensions (Roberts, The
    unreasonable effectiveness of quasirandom sequences, 2018).
    """
    root = 1.5
    for _ in range(60):
        root = (1.0 + root) ** (1.0 / (arm.num_joints + 1))
    steps = root ** -np.arange(1.0, arm.num_joints + 1)
    share = (0.5 + np.arange(NUM_SEEDS - 1)[:, None] * steps) % 1.0
    lower, upper = np.asarray(arm.lower), np.asarray(arm.upper)
    return np.concatenate([np.asarray(arm.posture)[None], lower + share * (upper - lower)])

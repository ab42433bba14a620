"""The arm as a line, for drawing it."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from jaxtyping import Float

from eaip_prob.robot._inputs import checked_rows
from eaip_prob.robot.kinematics import SerialArm


def link_points(
    arm: SerialArm, joints: Sequence[float] | Float[np.ndarray, "*batch joints"]
) -> Float[np.ndarray, "*batch points 3"]:
    """Corners of the line from the shoulder to the tip, in the arm's base, m; a link that is bent has one inside.

    Baxter's arm has nine: the mount, two for the shoulder, two for the elbow, two for the wrist, hand, and tip.

    Args:
        arm: whose links.
        joints: (*batch, J), rad.

    Raises:
        ShapeError: another number of joints.
        InputError: NaN or infinity.

    Example:
        >>> from eaip_prob.robot import baxter_left_arm
        >>> arm = baxter_left_arm()
        >>> link_points(arm, arm.posture).shape
        (9, 3)
    """
    q = checked_rows("joints", joints, arm.num_joints, "one for each joint")
    poses = arm.frames(q)
    points = [poses[..., 0, :3, 3]]
    for i in range(arm.num_joints):
        if arm.d[i] != 0.0:
            points.append(poses[..., i, :3, 3] + arm.d[i] * poses[..., i, :3, 2])
        if arm.a[i] != 0.0:
            points.append(poses[..., i + 1, :3, 3])
    if np.any(np.asarray(arm.T_flange_tip)[:3, 3] != 0.0):
        points.append(arm.tip(q))
    return np.stack(points, -2)

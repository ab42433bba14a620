"""Baxter's two arms, from the figures that its maker published.

Source: Rethink Robotics, baxter_common (BSD-3). Joint origins, angle limits and speed limits are those of
baxter_description/urdf/baxter.urdf, rewritten as Denavit-Hartenberg rows. What the tools reach is measured from the
frame of the hand, along its z axis: `NO_FINGERS` is the frame `left_gripper` of that file, the others the frame
`left_gripper_tip` of rethink_ee_description/urdf/electric_gripper (0.025 + 0.02 m and the length of the fingers).
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from jaxtyping import Float

from eaip_prob.robot._inputs import checked_rows
from eaip_prob.robot.kinematics import SerialArm

JOINTS = ("s0", "s1", "e0", "e1", "w0", "w1", "w2")
_QUARTER = np.pi / 2
_D = (0.27035, 0.0, 0.36442, 0.0, 0.37429, 0.0, 0.229525)
_A = (0.069, 0.0, 0.069, 0.0, 0.010, 0.0, 0.0)
_ALPHA = (-_QUARTER, _QUARTER, -_QUARTER, _QUARTER, -_QUARTER, _QUARTER, 0.0)
_THETA0 = (0.0, _QUARTER, 0.0, 0.0, 0.0, 0.0, 0.0)
_LOWER = (-1.70167993878, -2.147, -3.05417993878, -0.05, -3.059, -1.57079632679, -3.059)
_UPPER = (1.70167993878, 1.047, 3.05417993878, 2.618, 3.059, 2.094, 3.059)
_SPEED = (1.5, 1.5, 1.5, 1.5, 4.0, 4.0, 4.0)
_MIRROR = np.array([-1.0, 1.0, -1.0, 1.0, -1.0, 1.0, -1.0])

NO_FINGERS = 0.025  # m
STANDARD_FINGERS = 0.12  # m
EXTENDED_FINGERS = 0.1577  # m

NEUTRAL = (0.0, -0.55, 0.0, 0.75, 0.0, 1.26, 0.0)  # rad; `move_to_neutral` of Rethink's baxter_interface, limb.py
CARRYING = (0.6, 0.7, -0.9, 2.2, -1.1, 1.6, 0.0)  # rad, of the left arm: elbow low and behind, see docs/api/robot.md


def baxter_left_arm(
    tool: float = EXTENDED_FINGERS, posture: Sequence[float] | Float[np.ndarray, "7"] = CARRYING
) -> SerialArm:
    """Baxter's left arm with an electric gripper; base frame: x forward, y to the robot's left, z up.

    Args:
        tool: how far the tip is beyond the frame of the hand, m; NO_FINGERS, STANDARD_FINGERS or another length.
        posture: joint angles to which the arm tends, rad; NEUTRAL or others.

    Raises:
        ShapeError: another number of joint angles.
        InputError: a posture beyond the joint limits, numbers that are not finite.

    Example:
        >>> baxter_left_arm().tip(NEUTRAL).round(3).tolist()
        [0.646, 0.841, 0.063]
    """
    return _arm("left", 1.0, tool, posture)


def baxter_right_arm(
    tool: float = EXTENDED_FINGERS, posture: Sequence[float] | Float[np.ndarray, "7"] | None = None
) -> SerialArm:
    """Baxter's right arm, the left one seen in a mirror between both.

    Args:
        tool: how far the tip is beyond the frame of the hand, m.
        posture: joint angles to which the arm tends, rad; None for CARRYING, mirrored.

    Raises:
        ShapeError: another number of joint angles.
        InputError: a posture beyond the joint limits, numbers that are not finite.

    Example:
        >>> baxter_right_arm().tip(NEUTRAL).round(3).tolist()
        [0.646, -0.841, 0.063]
    """
    return _arm("right", -1.0, tool, mirrored(CARRYING) if posture is None else posture)


def mirrored(joints: Sequence[float] | Float[np.ndarray, "*batch 7"]) -> Float[np.ndarray, "*batch 7"]:
    """Joint angles that hold the other arm as in a mirror between both, rad.

    Args:
        joints: (*batch, 7), of one of Baxter's arms, rad.

    Example:
        >>> mirrored(np.array([0.1, 0.2, 0.3, 0.4, 0.5, 0.6, 0.7])).tolist()
        [-0.1, 0.2, -0.3, 0.4, -0.5, 0.6, -0.7]
    """
    return checked_rows("joints", joints, 7, "one for each joint") * _MIRROR


def _arm(side: str, sign: float, tool: float, posture: Sequence[float] | np.ndarray) -> SerialArm:
    names = tuple(f"{side}_{joint}" for joint in JOINTS)
    T_base_mount, T_flange_tip = _mount(sign), np.eye(4)
    T_flange_tip[2, 3] = tool
    return SerialArm(names, _D, _A, _ALPHA, _THETA0, _LOWER, _UPPER, _SPEED, posture, T_base_mount, T_flange_tip)


def _mount(sign: float) -> np.ndarray:
    """The joints `torso_arm_mount` and `s0`: the arms are mounted at 45 degrees, written 0.7854 rad in the file."""
    turn = sign * 0.7854
    c, s = np.cos(turn), np.sin(turn)
    pose = np.eye(4)
    pose[:2, :2] = [[c, -s], [s, c]]
    pose[:3, 3] = np.array([0.024645, sign * 0.219645, 0.118588]) + np.array([c * 0.055695, s * 0.055695, 0.011038])
    return pose

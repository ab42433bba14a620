"""The robot's arms: where their links are, which joint angles follow a path, and whether a motion is possible."""

from eaip_prob.robot.baxter import (
    CARRYING,
    EXTENDED_FINGERS,
    NEUTRAL,
    NO_FINGERS,
    STANDARD_FINGERS,
    baxter_left_arm,
    baxter_right_arm,
    mirrored,
)
from eaip_prob.robot.collision import ArmSpheres
from eaip_prob.robot.inverse import JointPath, follow
from eaip_prob.robot.kinematics import SerialArm
from eaip_prob.robot.outline import link_points
from eaip_prob.robot.reach import MotionCheck, check_joints, check_motion

__all__ = [
    "CARRYING",
    "EXTENDED_FINGERS",
    "NEUTRAL",
    "NO_FINGERS",
    "STANDARD_FINGERS",
    "ArmSpheres",
    "JointPath",
    "MotionCheck",
    "SerialArm",
    "baxter_left_arm",
    "baxter_right_arm",
    "check_joints",
    "check_motion",
    "follow",
    "link_points",
    "mirrored",
]

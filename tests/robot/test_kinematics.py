from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from eaip_prob.errors import InputError, ShapeError
from eaip_prob.robot import (
    CARRYING,
    NEUTRAL,
    NO_FINGERS,
    baxter_left_arm,
    baxter_right_arm,
    link_points,
    mirrored,
)

# baxter_description/urdf/baxter.urdf, left arm: (rpy, xyz) of each joint's origin, limits and speed of those that turn.
URDF = [
    ((0, 0, 0.7854), (0.024645, 0.219645, 0.118588), None),
    ((0, 0, 0), (0.055695, 0, 0.011038), (-1.70167993878, 1.70167993878, 1.5)),
    ((-1.57079632679, 0, 0), (0.069, 0, 0.27035), (-2.147, 1.047, 1.5)),
    ((1.57079632679, 0, 1.57079632679), (0.102, 0, 0), (-3.05417993878, 3.05417993878, 1.5)),
    ((-1.57079632679, -1.57079632679, 0), (0.069, 0, 0.26242), (-0.05, 2.618, 1.5)),
    ((1.57079632679, 0, 1.57079632679), (0.10359, 0, 0), (-3.059, 3.059, 4.0)),
    ((-1.57079632679, -1.57079632679, 0), (0.01, 0, 0.2707), (-1.57079632679, 2.094, 4.0)),
    ((1.57079632679, 0, 1.57079632679), (0.115975, 0, 0), (-3.059, 3.059, 4.0)),
    ((0, 0, 0), (0, 0, 0.11355), None),
    ((0, 0, 0), (0, 0, 0), None),
    ((0, 0, 0), (0, 0, 0.025), None),
]


def turned(axis: int, angle: float) -> np.ndarray:
    c, s = np.cos(angle), np.sin(angle)
    T = np.eye(4)
    one, two = [(1, 2), (2, 0), (0, 1)][axis]
    T[one, one], T[one, two], T[two, one], T[two, two] = c, -s, s, c
    return T


def urdf_poses(joints: np.ndarray) -> list[np.ndarray]:
    """Poses of the links in the base, one for each row of URDF: parent @ origin @ turn about z."""
    T, poses, angles = np.eye(4), [], iter(joints)
    for (roll, pitch, yaw), xyz, limits in URDF:
        origin = turned(2, yaw) @ turned(1, pitch) @ turned(0, roll)
        origin[:3, 3] = xyz
        T = T @ origin @ (turned(2, next(angles)) if limits else np.eye(4))
        poses.append(T)
    return poses


def drawn(arm, *batch, seed=0):
    return np.random.default_rng(seed).uniform(arm.lower, arm.upper, (*batch, 7))


def test_the_gripper_is_where_the_published_joint_tree_has_it():
    arm = baxter_left_arm(NO_FINGERS)
    for joints in drawn(arm, 20):
        T_base_gripper = urdf_poses(joints)[-1]
        np.testing.assert_allclose(arm.frames(joints)[-1] @ arm.T_flange_tip, T_base_gripper, atol=1e-10)
        np.testing.assert_allclose(arm.tip(joints), T_base_gripper[:3, 3], atol=1e-10)


def test_limits_are_the_published_ones():
    limits = np.array([row[2] for row in URDF if row[2]])
    for arm in (baxter_left_arm(), baxter_right_arm()):
        np.testing.assert_array_equal(np.column_stack([arm.lower, arm.upper, arm.speed]), limits)
    assert baxter_right_arm().names[3] == "right_e1"


def test_jacobian_is_the_derivative_of_the_tip():
    arm, step = baxter_left_arm(), 1e-6
    joints = drawn(arm, 2, 3)
    moved = [(arm.tip(joints + step * e) - arm.tip(joints - step * e)) / (2 * step) for e in np.eye(7)]
    np.testing.assert_allclose(arm.jacobian(joints), np.stack(moved, -1), atol=1e-8)


def test_a_batch_is_its_members():
    arm = baxter_right_arm()
    joints = drawn(arm, 2, 3)
    assert arm.frames(joints).shape == (2, 3, 8, 4, 4)
    for index in np.ndindex(2, 3):
        np.testing.assert_array_equal(arm.frames(joints)[index], arm.frames(joints[index]))
        np.testing.assert_allclose(arm.tip(joints)[index], arm.tip(joints[index]), atol=1e-15)


def test_the_right_arm_mirrors_the_left():
    left, right = baxter_left_arm(), baxter_right_arm()
    joints = drawn(left, 10)
    np.testing.assert_allclose(right.tip(mirrored(joints)), left.tip(joints) * [1, -1, 1], atol=1e-12)
    np.testing.assert_allclose(right.posture, mirrored(CARRYING))
    assert baxter_left_arm().tip(NEUTRAL)[1] > 0.5  # the left arm is on the robot's left


@pytest.mark.parametrize("field", ["lower", "speed", "d"])
def test_nothing_can_be_written_into_an_arm(field):
    with pytest.raises(ValueError, match="read-only"):
        getattr(baxter_left_arm(), field)[0] = 0.0


def test_the_line_for_drawing_goes_through_the_joints_of_the_tree():
    arm = baxter_left_arm(NO_FINGERS)
    joints = drawn(arm, 5)
    points = link_points(arm, joints)
    assert points.shape == (5, 9, 3)
    for q, line in zip(joints, points, strict=True):
        poses = urdf_poses(q)
        for row, place in {1: 0, 2: 2, 4: 4, 6: 6, 8: 7, 10: 8}.items():
            np.testing.assert_allclose(line[place], poses[row][:3, 3], atol=1e-10)
    bends = np.linalg.norm(np.diff(points, axis=1), axis=-1)
    np.testing.assert_allclose(bends, np.tile(bends[0], (5, 1)), atol=1e-12)  # links are rigid


def test_an_arm_without_tool_ends_at_its_flange():
    arm = replace(baxter_left_arm(), T_flange_tip=np.eye(4))
    joints = drawn(arm)
    np.testing.assert_allclose(link_points(arm, joints)[-1], arm.tip(joints), atol=1e-12)
    assert link_points(arm, joints).shape == (8, 3)


@pytest.mark.parametrize(
    ("change", "error", "message"),
    [
        ({"d": (0.1, 0.2)}, ShapeError, r"Expected d with shape \(\*batch, 7\)"),
        ({"alpha": np.zeros((2, 7))}, ShapeError, r"Expected alpha with shape \(7,\)"),
        ({"a": [np.nan] * 7}, InputError, "Expected finite numbers in a, got nan"),
        ({"lower": (2.0,) * 7}, InputError, "Expected lower below upper limits"),
        ({"speed": (0.0,) * 7}, InputError, "speeds above zero"),
        ({"posture": (3.0,) * 7}, InputError, "Expected the posture within the joint limits"),
        ({"T_flange_tip": np.eye(3)}, ShapeError, "Expected T_flange_tip with shape"),
        ({"T_base_mount": 2 * np.eye(4)}, InputError, "T_base_mount"),
    ],
)
def test_an_arm_that_cannot_be_is_refused(change, error, message):
    with pytest.raises(error, match=message):
        replace(baxter_left_arm(), **change)


@pytest.mark.parametrize("method", ["frames", "tip", "jacobian"])
def test_joints_that_cannot_be_are_refused(method):
    arm = baxter_left_arm()
    with pytest.raises(ShapeError, match=r"Expected joints with shape \(\*batch, 7\).*got \(2, 6\)"):
        getattr(arm, method)(np.zeros((2, 6)))
    with pytest.raises(InputError, match=r"Expected finite numbers in joints, got inf at index \(0, 3\)"):
        getattr(arm, method)(np.array([[0, 0, 0, np.inf, 0, 0, 0]]))
    with pytest.raises(InputError, match="Expected joints as numbers"):
        getattr(arm, method)("bent")

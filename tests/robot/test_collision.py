from __future__ import annotations

import numpy as np
import pytest

from eaip_prob.errors import InputError, ShapeError
from eaip_prob.robot import NEUTRAL, NO_FINGERS, ArmSpheres, baxter_left_arm, baxter_right_arm, mirrored

ARM, SPHERES = baxter_left_arm(), ArmSpheres.baxter()

# Cylinders of the collision model in baxter.urdf as (link in `frames`, middle, axis, radius, length), in the frames of
# `SerialArm`: z of link 4 runs along the forearm, z of links 6 and 7 along the wrist, y of 4 and 6 along the hinges.
PUBLISHED = {
    "lower_elbow": (4, (0, 0, 0), 1, 0.06, 0.10),
    "upper_forearm": (4, (0, 0, 0.10359 - 0.044), 2, 0.06, 0.088),
    "upper_forearm_visual": (4, (0, 0, 0.088 + 0.136), 2, 0.06, 0.272),
    "lower_forearm": (6, (0, 0, 0), 1, 0.06, 0.10),
    "wrist": (6, (0, 0, 0.115975), 2, 0.06, 0.165),
    "hand": (7, (0, 0, -0.0232), 2, 0.04, 0.0464),
}


def on_cylinder(middle, axis, radius, length):
    """Points on the side and on both rims, in the frame of the link."""
    angle, along = np.meshgrid(np.linspace(0, 2 * np.pi, 24), np.linspace(-length / 2, length / 2, 15))
    around = [radius * np.cos(angle).ravel(), radius * np.sin(angle).ravel()]
    columns = [*around[:axis], along.ravel(), *around[axis:]]
    return np.column_stack(columns) + middle


def signed_distance(points, joints):
    centers = SPHERES.centers(ARM, joints)
    return (np.linalg.norm(points[:, None] - centers, axis=-1) - SPHERES.radii).min(1)


@pytest.mark.parametrize("name", PUBLISHED)
def test_spheres_hold_the_published_outline(name):
    link, *cylinder = PUBLISHED[name]
    joints = np.array([0.3, -0.4, 0.5, 1.1, -0.6, 0.9, 0.2])
    pose = ARM.frames(joints)[link]
    points = on_cylinder(*cylinder) @ pose[:3, :3].T + pose[:3, 3]
    assert signed_distance(points, joints).max() < 1e-9


def test_spheres_reach_from_the_elbow_to_the_tip_and_not_far_beyond():
    joints = np.array(NEUTRAL)
    frames, tip = ARM.frames(joints), ARM.tip(joints)
    line = np.concatenate(
        [np.linspace(a, b, 30) for a, b in [(frames[4, :3, 3], frames[5, :3, 3]), (frames[6, :3, 3], tip)]]
    )
    assert signed_distance(line, joints).max() < 0.0
    beyond = tip + 0.05 * frames[7, :3, 2]
    upper_arm = frames[2, :3, 3]
    assert signed_distance(np.stack([beyond, upper_arm]), joints).min() > 0.0
    assert SPHERES.radii.max() < 0.09


def test_centers_of_a_batch_and_of_the_other_arm():
    joints = np.random.default_rng(0).uniform(ARM.lower, ARM.upper, (2, 3, 7))
    centers = SPHERES.centers(ARM, joints)
    assert centers.shape == (2, 3, len(SPHERES.radii), 3)
    np.testing.assert_allclose(centers[1, 2], SPHERES.centers(ARM, joints[1, 2]), atol=1e-15)
    other = SPHERES.centers(baxter_right_arm(), mirrored(joints))
    np.testing.assert_allclose(other, centers * [1, -1, 1], atol=1e-12)


def test_spheres_do_not_hang_on_the_tool():
    bare = SPHERES.centers(baxter_left_arm(NO_FINGERS), np.array(NEUTRAL))
    np.testing.assert_array_equal(bare, SPHERES.centers(ARM, np.array(NEUTRAL)))


@pytest.mark.parametrize(
    ("links", "offsets", "radii", "error", "message"),
    [
        ([0, 1], np.zeros((2, 3)), [0.1], ShapeError, "Expected radii with shape"),
        ([0], np.zeros((2, 3)), [0.1, 0.1], ShapeError, r"Expected links \(n,\)"),
        ([0], np.zeros((1, 2)), [0.1], ShapeError, "Expected offsets with shape"),
        ([0], np.zeros((1, 3)), [0.0], InputError, "Expected radii above zero"),
        ([-1], np.zeros((1, 3)), [0.1], InputError, "links from 0 on"),
    ],
)
def test_spheres_that_cannot_be_are_refused(links, offsets, radii, error, message):
    with pytest.raises(error, match=message):
        ArmSpheres(np.array(links), offsets, np.array(radii))


def test_an_arm_with_too_few_links_is_refused():
    spheres = ArmSpheres(np.array([8]), np.zeros((1, 3)), np.array([0.1]))
    with pytest.raises(InputError, match="Expected an arm with 8 joints or more, got 7"):
        spheres.centers(ARM, np.array(NEUTRAL))

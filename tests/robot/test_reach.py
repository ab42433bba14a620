from __future__ import annotations

import numpy as np
import pytest

from eaip_prob.errors import InputError, ShapeError
from eaip_prob.robot import NEUTRAL, baxter_left_arm, check_joints, check_motion, follow

ARM = baxter_left_arm()
ACROSS = np.column_stack([np.full(40, 0.5), np.linspace(-0.3, 0.4, 40), np.full(40, 0.0)])


def test_a_motion_within_reach_is_possible_if_there_is_time():
    slow = check_motion(ARM, np.linspace(0.0, 8.0, 40), ACROSS)
    assert slow.possible and slow.reason is None and slow.within_limits and slow.reached.all()
    fast = check_motion(ARM, np.linspace(0.0, 0.2, 40), ACROSS)
    np.testing.assert_allclose(fast.speed_share, 40.0 * slow.speed_share)
    assert not fast.possible and fast.reached.all()


def test_the_joint_that_is_too_fast_is_named_with_its_speed():
    joints = np.tile(NEUTRAL, (4, 1))
    joints[2:, 4] += 0.9  # left_w0, 4 rad/s
    joints[3:, 1] += 0.1  # left_s1, 1.5 rad/s
    check = check_joints(ARM, [0.0, 0.2, 0.35, 0.7], joints, ARM.tip(joints))
    assert check.speed_share == pytest.approx(0.9 / 0.15 / 4.0)
    assert check.reason == (
        "Joint left_w0 would turn at 6.00 rad/s from 0.20 to 0.35 s, 1.50 times its limit of 4.00 rad/s."
    )


def test_the_sample_out_of_reach_is_named_with_its_time():
    path = ACROSS.copy()
    path[30:32, 0] = 1.9
    check = check_motion(ARM, np.linspace(0.0, 3.9, 40), path)
    assert np.flatnonzero(~check.reached).tolist() == [30, 31]
    far = check.error[30]
    assert check.reason is not None
    assert check.reason.startswith(
        f"Sample 30 at 3.00 s, (1.90, 0.24, 0.00) m, is out of reach by {far:.3f} m; 2 of 40"
    )


def test_joints_beyond_their_limits_are_named():
    joints = np.tile(NEUTRAL, (3, 1))
    joints[1, 3] = 2.7
    check = check_joints(ARM, [0.0, 5.0, 9.0], joints, ARM.tip(joints))
    assert not check.within_limits
    assert check.reason == (
        "Joint left_e1 stands at 2.700 rad at 5.00 s (sample 1), but turns only from -0.050 to 2.618 rad."
    )


def test_a_motion_is_checked_from_the_start_that_is_given():
    start = follow(ARM, ACROSS, NEUTRAL).joints[0]
    check = check_motion(ARM, np.linspace(0.0, 8.0, 40), ACROSS, start)
    np.testing.assert_array_equal(check.joints, follow(ARM, ACROSS, start).joints)


def test_a_single_sample_has_no_speed():
    check = check_motion(ARM, [0.0], ACROSS[:1])
    assert (check.possible, check.speed_share) == (True, 0.0)


@pytest.mark.parametrize(
    ("time", "path", "error", "message"),
    [
        (np.linspace(0, 1, 39), ACROSS, ShapeError, r"Expected time with shape \(\*batch, 40\)"),
        (np.zeros((40, 40)), ACROSS, ShapeError, r"Expected time with shape \(40,\)"),
        ([0.0, 0.5, 0.5], ACROSS[:3], InputError, "got 0.5 s and then 0.5 s at sample 2"),
        ([0.0, np.nan, 0.5], ACROSS[:3], InputError, "finite numbers in time"),
        ([], ACROSS[:0], ShapeError, "at least one sample"),
    ],
)
def test_bad_input_is_refused(time, path, error, message):
    with pytest.raises(error, match=message):
        check_motion(ARM, time, path)


def test_as_many_joints_as_samples():
    with pytest.raises(ShapeError, match="Expected as many joints as samples of the path, got 2 and 3"):
        check_joints(ARM, [0.0, 1.0, 2.0], np.zeros((2, 7)), ACROSS[:3])

from __future__ import annotations

from dataclasses import replace
from time import perf_counter

import numpy as np
import pytest

from eaip_prob.errors import InputError, ShapeError
from eaip_prob.robot import NEUTRAL, baxter_left_arm, baxter_right_arm, follow, mirrored

ARM = baxter_left_arm()


def arc(num: int = 50) -> np.ndarray:
    """Over an object from the robot's right to its left, (num, 3), m."""
    share = np.linspace(0.0, 1.0, num)
    return np.column_stack([0.42 + 0.05 * share, -0.45 + share, -0.2 + 0.45 * np.sin(np.pi * share)])


def shares(arm, joints: np.ndarray, step: float) -> np.ndarray:
    return np.abs(np.diff(joints, axis=0)).max(0) / step / arm.speed


def test_what_the_arm_can_do_is_found_again():
    rng = np.random.default_rng(3)
    tips = ARM.tip(rng.uniform(ARM.lower, ARM.upper, (200, 7)))
    found = [follow(ARM, tip[None]) for tip in tips]
    assert all(one.reached[0] for one in found)
    back = ARM.tip(np.concatenate([one.joints for one in found]))
    assert np.abs(back - tips).max() < 1e-3
    np.testing.assert_allclose(np.linalg.norm(back - tips, axis=1), [one.error[0] for one in found], atol=1e-9)


def test_what_the_arm_can_do_is_found_from_one_start_as_well():
    rng = np.random.default_rng(3)
    tips = ARM.tip(rng.uniform(ARM.lower, ARM.upper, (600, 7)))
    assert np.mean([follow(ARM, tip[None], NEUTRAL).reached[0] for tip in tips]) > 0.995


def test_points_out_of_reach_are_approached_as_far_from_one_start_as_from_many():
    below = np.array([[x, y, z] for x in (0.35, 0.5, 0.6) for y in np.arange(-0.65, 0.66, 0.1) for z in (-0.65, -0.55)])
    warm, cold = (np.array([follow(ARM, p[None], start).error[0] for p in below]) for start in (NEUTRAL, None))
    assert (cold > 1e-3).mean() > 0.4 and (cold[cold > 1e-3] < 0.01).any()
    assert all(follow(ARM, p[None]).reached[0] == (miss <= 1e-3) for p, miss in zip(below, cold, strict=True))
    assert np.abs(warm - cold).max() < 3e-3


@pytest.mark.parametrize("arm", [ARM, baxter_right_arm()], ids=["left", "right"])
def test_a_path_is_followed_within_the_limits_and_without_jumps(arm):
    path = arc() * [1, -1 if arm is not ARM else 1, 1]
    found = follow(arm, path)
    assert found.reached.all() and found.error.max() < 1e-5
    np.testing.assert_allclose(arm.tip(found.joints), path, atol=1e-5)
    assert arm.allows(found.joints, slack=0.0).all()
    assert shares(arm, found.joints, 0.2).max() < 0.5


def test_the_mirrored_path_moves_the_other_arm_like_in_a_mirror():
    left, right = follow(ARM, arc(), NEUTRAL), follow(baxter_right_arm(), arc() * [1, -1, 1], mirrored(NEUTRAL))
    np.testing.assert_allclose(right.joints, mirrored(left.joints), atol=1e-6)


def test_a_path_that_goes_on_starts_where_the_arm_is():
    whole = follow(ARM, arc())
    rest = follow(ARM, arc()[20:], whole.joints[19])
    assert np.abs(rest.joints[0] - whole.joints[19]).max() < 0.1
    np.testing.assert_allclose(rest.joints, whole.joints[20:], atol=0.02)


def test_joints_depend_on_the_way_not_on_how_often_it_is_sampled():
    few, many = follow(ARM, arc(50), NEUTRAL), follow(ARM, arc(491), NEUTRAL)
    np.testing.assert_allclose(few.joints, many.joints[::10], atol=0.02)


def test_a_tip_that_rests_lets_the_joints_rest():
    still = follow(ARM, np.tile(ARM.tip(NEUTRAL), (30, 1)), NEUTRAL)
    np.testing.assert_allclose(still.joints, np.tile(NEUTRAL, (30, 1)), atol=1e-6)


def test_the_arm_tends_to_its_posture():
    low, high = (replace(ARM, posture=(0.0, -0.5, e0, 1.5, 0.0, 0.8, 0.0)) for e0 in (-1.5, 1.5))
    there = np.array([[0.6, 0.3, 0.1]])
    assert follow(low, there).joints[0, 2] < -0.5 < 0.5 < follow(high, there).joints[0, 2]
    to_and_fro = np.concatenate([arc(), arc()[::-1]])
    ends = [follow(arm, to_and_fro, NEUTRAL).joints[-1, 2] for arm in (low, high)]
    assert ends[0] < ends[1] - 0.5


def test_without_a_start_the_arm_settles_as_near_to_its_posture_as_the_first_sample_lets_it():
    first = np.array([[0.34, -0.5, -0.15]])
    settled = follow(ARM, first).joints[0]
    offsets = np.random.default_rng(0).normal(scale=0.3, size=(200, 7))
    others = [follow(ARM, first, np.clip(settled + one, ARM.lower, ARM.upper)).joints[0] for one in offsets]
    slowness = 1.0 / np.sqrt(ARM.speed)  # in which steps are measured
    distances = np.linalg.norm((np.stack(others) - ARM.posture) * slowness, axis=1)
    assert np.linalg.norm((settled - ARM.posture) * slowness) < distances.min() + 0.02


@pytest.mark.parametrize("across", [0.2, 0.3, 0.4, 0.5])
def test_other_starts_settle_near_the_posture_too(across):
    far_apart = np.array([[0.34, -0.5, -0.15], [0.34, -0.5 + across, 0.0]])  # no calm step: all starts are tried
    assert follow(ARM, far_apart).joints[0, 1] == pytest.approx(1.0, abs=0.1)


def test_a_joint_at_its_limit_leaves_the_way_to_the_others():
    tight = replace(ARM, lower=np.minimum(ARM.posture, ARM.lower * 0.4) - 1e-3, upper=np.maximum(ARM.posture, 1.0))
    path = arc()[25:40]
    found = follow(tight, path)
    at_limit = (np.abs(found.joints - tight.lower) < 1e-9) | (np.abs(found.joints - tight.upper) < 1e-9)
    assert found.reached.all() and at_limit.any()
    assert tight.allows(found.joints, slack=0.0).all()


@pytest.mark.parametrize("start", [None, NEUTRAL])
def test_points_out_of_reach_are_told_and_approached(start):
    path = np.array([[0.5, 0.2, 0.0], [3.0, 0.3, 0.4], [1e200, 0.0, 0.0], [0.5, 0.2, 0.0]])
    found = follow(ARM, path, start)
    assert found.reached.tolist() == [True, False, False, True]
    assert ARM.allows(found.joints).all()
    # No farther than with all links in a line, from the mount of the arm.
    links = [0.27035, 0.069, np.hypot(0.36442, 0.069), np.hypot(0.37429, 0.010), 0.229525 + 0.1577]
    assert np.linalg.norm(path[1] - ARM.T_base_mount[:3, 3]) - sum(links) < found.error[1] < 1.8


def test_error_beyond_reach_is_the_least_there_is():
    # The point lies below the shoulder where the arm is straight: random restarts find nothing nearer.
    from scipy.optimize import least_squares

    point, rng = np.array([0.5, -0.45, -0.55]), np.random.default_rng(0)
    starts = rng.uniform(ARM.lower, ARM.upper, (6, 7))
    bounds = (ARM.lower, ARM.upper)
    fits = [least_squares(lambda q: ARM.tip(q) - point, q, ARM.jacobian, bounds=bounds).cost for q in starts]
    assert abs(follow(ARM, point[None]).error[0] - np.sqrt(2 * min(fits))) < 2e-3


def test_of_several_ways_the_one_with_the_shortest_longest_step_is_taken():
    rng = np.random.default_rng(5)
    for _ in range(15):
        ends = ARM.tip(rng.uniform(ARM.lower, ARM.upper, (2, 7)))
        best, from_posture = follow(ARM, ends), follow(ARM, ends, follow(ARM, ends[:1]).joints[0])
        if best.reached.all() and from_posture.reached.all():
            assert shares(ARM, best.joints, 1.0).max() <= shares(ARM, from_posture.joints, 1.0).max() + 1e-6


def test_nothing_given_is_written_into():
    path, start = arc(), np.array(NEUTRAL)
    follow(ARM, path, start)
    np.testing.assert_array_equal(path, arc())
    np.testing.assert_array_equal(start, NEUTRAL)
    first, second = follow(ARM, path), follow(ARM, path)
    np.testing.assert_array_equal(first.joints, second.joints)


@pytest.mark.parametrize(
    ("path", "start", "error", "message"),
    [
        (np.zeros((0, 3)), None, ShapeError, "at least one sample"),
        (np.zeros(3), None, ShapeError, r"Expected path with shape \(T, 3\)"),
        (np.zeros((4, 2)), None, ShapeError, r"Expected path with shape \(\*batch, 3\)"),
        (np.array([[0.5, np.nan, 0.1]]), None, InputError, r"finite numbers in path, got nan at index \(0, 1\)"),
        (arc(), np.zeros(6), ShapeError, "Expected start"),
        (arc(), np.zeros((2, 7)), ShapeError, r"Expected start with shape \(7,\), one for each joint, got \(2, 7\)"),
        (arc(), (0, 0, 0, -0.5, 0, 0, 0), InputError, "got -0.5000 rad for left_e1, which turns from -0.0500"),
    ],
)
def test_bad_input_is_refused(path, start, error, message):
    with pytest.raises(error, match=message):
        follow(ARM, path, start)


@pytest.mark.slow
def test_it_is_quick():
    start = follow(ARM, arc()).joints[0]

    def median(given):
        times = []
        for _ in range(30):
            begin = perf_counter()
            follow(ARM, arc(), given)
            times.append(perf_counter() - begin)
        return np.median(times)

    # 0.07 ms and 0.2 ms of processor time; the bounds leave room for a machine that others use.
    assert median(start) < 1e-3
    assert median(None) < 5e-3

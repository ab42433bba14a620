from __future__ import annotations

import functools

import glove_world as world
import numpy as np
import pytest

from eaip_prob.errors import InputError
from eaip_prob.perception.gloves import GloveTracker
from eaip_prob.perception.hands import hands_to_trajectory

RADIUS = 0.06
CHI2 = 7.815  # 95 % of a squared Mahalanobis distance with three degrees of freedom


def reach(t):
    return np.array([[0.9 + 0.5 * t, -0.3 + 0.3 * t, 0.1 + 0.4 * t], [0.8, 0.3 - 0.2 * t, 0.2]])


def touch(t):
    aside = max(RADIUS, 0.2 - 0.6 * min(t, 0.7 - t))
    return np.array([[0.9, -aside, 0.1], [0.9, aside, 0.1]])


def cross(t):
    """Hands that pass each other, one 2.2 radii above the other, and end on each other's side."""
    across = 0.25 - 0.7 * t
    return np.array([[0.9, -across, 0.1 + 1.1 * RADIUS], [0.9, across, 0.1 - 1.1 * RADIUS]])


def follow(path, count, names=("overhead",), radius=RADIUS, more=(), late=0.0, tracker=None, hide=None):
    """(errors (T, 2), squared Mahalanobis distances (T, 2), states) of `count` frames at 30 Hz."""
    generator, tracker = np.random.default_rng(0), tracker or GloveTracker(radius)
    state, found = tracker.init(), []
    for k in range(count):
        frames = []
        for i, name in enumerate(names):
            time = (k + late * i) / 30.0
            spheres = world.gloves(*path(time), radius, more)
            if hide and hide(time):
                spheres = spheres[:1] + spheres[2:]
            frames.append(world.frame(name, spheres, time, generator, scale=0.5))
        hands, state = tracker.step(frames, state)
        found.append(hands)
    seen = [hands for hands in found if hands is not None]
    away = np.array([hands.position - path(hands.time) for hands in seen])
    squares = np.array(
        [
            [a @ np.linalg.solve(c, a) for a, c in zip(*pair, strict=True)]
            for pair in zip(away, [hands.covariance for hands in seen], strict=True)
        ]
    )
    return np.linalg.norm(away, axis=-1), squares, found


@pytest.mark.parametrize("radius", [0.045, 0.06])
def test_errors_stay_within_two_millimetres(radius):
    errors, squares, _ = follow(reach, 8, ("overhead", "left"), radius)
    assert np.median(errors) < 2e-3 and errors.max() < 6e-3 and (squares < CHI2).mean() >= 0.9


@pytest.mark.parametrize("name", ["left", "right"])
def test_one_camera_is_enough(name):
    errors, squares, _ = follow(reach, 8, (name,))
    assert np.median(errors) < 6e-3 and (squares < CHI2).mean() >= 0.9


@pytest.mark.parametrize("path", [touch, cross])
def test_hands_that_meet_are_not_swapped(path):
    errors, squares, found = follow(path, 22)
    assert len(errors) == 22 and errors.max() < 0.02 and np.median(errors) < 3e-3
    assert (squares < CHI2).mean() >= 0.9 and all(hands.seen.all() for hands in found)


def test_left_hand_is_on_the_persons_left():
    facing, away = GloveTracker(RADIUS), GloveTracker(RADIUS, to_left=(0.0, 1.0, 0.0))
    frames = [world.frame("overhead", world.gloves(*reach(0.0), RADIUS), 0.0, scale=0.5)]
    one, other = facing.step(frames, facing.init())[0], away.step(frames, away.init())[0]
    assert one.position[0, 1] < 0 < one.position[1, 1]
    np.testing.assert_array_equal(one.position, other.position[::-1])


def still_then_away(t):
    """The right hand moves on by 12 cm while it is hidden."""
    return np.array([[0.9, -0.3, 0.1], [0.9, 0.3 - 0.6 * np.clip(t - 0.3, 0.0, 0.2), 0.2]])


def test_hidden_hand_is_held_for_three_frames_then_not_seen():
    errors, squares, found = follow(still_then_away, 18, hide=lambda t: 0.29 < t < 0.49)
    seen = np.array([hands.seen[1] for hands in found])
    assert seen.tolist() == [True] * 12 + [False] * 3 + [True] * 3
    assert (squares < CHI2).all() and errors[-3:].max() < 3e-3 and errors[14, 1] > 0.05
    spread = [np.trace(hands.covariance[1]) for hands in found]
    assert spread[8] < spread[10] < spread[12] < spread[14] > 100 * spread[-1]
    held = [hands.position[1] for hands in found[12:15]]
    np.testing.assert_array_equal(held[0], held[2])


def test_covariance_of_a_hidden_hand_ends_at_its_reach():
    tracker, state = GloveTracker(RADIUS, reach=0.3), GloveTracker(RADIUS).init()
    hands = None
    for time in (0.0, 1.0, 2.0, 3.0):
        spheres = world.gloves(*reach(0.0), RADIUS)[: 2 if time == 0 else 1]
        hands, state = tracker.step([world.frame("overhead", spheres, time, scale=0.5)], state)
    np.testing.assert_allclose(hands.covariance[1], 0.09 * np.eye(3), atol=1e-12)


def far_away(t):
    return np.array([[0.9, -0.3, 0.1], [0.9, 0.4 if t < 0.2 else 0.1, 0.2]])


def test_hand_beyond_the_gate_is_taken_once_it_stays():
    errors, _, found = follow(far_away, 17, hide=lambda t: 0.15 < t < 0.35)
    assert errors[11:14, 1].min() > 0.2 and errors[15:].max() < 5e-3
    assert all(hands.seen[0] for hands in found)


GREEN_THINGS = [((1.3, 0.1, -0.3), 0.16, world.GREEN), ((0.7, 0.0, 0.1), 0.018, world.GREEN)]


def test_too_large_and_too_small_green_things_are_no_hands():
    errors, _, found = follow(reach, 6, ("left", "overhead"), more=GREEN_THINGS)
    assert len(errors) == 6 and errors.max() < 6e-3


def test_green_ball_that_never_moves_is_no_hand():
    errors, _, found = follow(reach, 10, more=[((1.2, 0.0, -0.2), RADIUS, world.GREEN)])
    assert len(found) - len(errors) < 5 and errors.max() < 6e-3


def test_cameras_out_of_step_each_count_at_their_own_time():
    errors, squares, _ = follow(reach, 8, ("left", "overhead", "right"), late=0.6)
    assert errors.max() < 6e-3 and (squares < CHI2).mean() >= 0.9


@functools.cache
def at(time, name="overhead"):
    return world.frame(name, world.gloves(*reach(time), RADIUS), time, scale=0.5)


def test_late_frame_is_left_out():
    tracker = GloveTracker(RADIUS)
    first, state = tracker.step([at(0.1)], tracker.init())
    again, after = tracker.step([at(0.0)], state)
    np.testing.assert_array_equal(first.position, again.position)
    assert after is state


def test_dropped_frames_leave_a_gap_and_no_more():
    tracker = GloveTracker(RADIUS)
    state = tracker.init()
    for time in (0.0, 0.0333, 0.0667, 0.1667, 0.2):
        hands, state = tracker.step([at(time)], state)
    assert np.linalg.norm(hands.position - reach(0.2), axis=1).max() < 6e-3


def test_clocks_that_disagree_are_an_error():
    tracker = GloveTracker(RADIUS)
    with pytest.raises(InputError, match="clocks"):
        tracker.step([at(0.0), at(0.5, "left")], tracker.init())


def test_state_is_not_changed():
    tracker = GloveTracker(RADIUS)
    _, state = tracker.step([at(0.0)], tracker.init())
    before = (state.mean.copy(), state.covariance.copy(), state.last_seen.copy())
    tracker.step([at(0.0333)], state)
    for kept, now in zip(before, (state.mean, state.covariance, state.last_seen), strict=True):
        np.testing.assert_array_equal(kept, now)


def test_trajectory_has_the_masks_and_the_noise():
    _, _, found = follow(still_then_away, 14, hide=lambda t: t > 0.25)
    motion = hands_to_trajectory(found)
    assert motion.names == ("left_x", "left_y", "left_z", "right_x", "right_y", "right_z")
    assert motion.mask[:, :3].all() and not motion.mask[-1, 3:].any() and motion.mask[0].all()
    np.testing.assert_array_equal(motion.values[0, 3:], found[0].position[1])
    np.testing.assert_array_equal(motion.noise[5, 3:, 3:], found[5].covariance[1])
    assert not motion.noise[:, :3, 3:].any()
    with pytest.raises(InputError, match="at least one state"):
        hands_to_trajectory([])


@pytest.mark.parametrize("name", ["radius", "gate", "speed"])
def test_arguments_are_above_zero(name):
    with pytest.raises(InputError, match=name):
        GloveTracker(**{"radius": 0.05, name: 0.0})


def test_hidden_hand_does_not_jump_to_a_ball_that_never_moved():
    ball = ((0.8, 0.05, 0.2), RADIUS, world.GREEN)
    _, _, found = follow(reach, 25, more=[ball], hide=lambda t: t > 0.59)
    assert found[17].seen.all() and not found[-1].seen[1]
    assert np.linalg.norm(found[-1].position[1] - ball[0]) > 0.08


def test_hands_go_on_three_frames_and_are_held_while_all_cameras_fail():
    tracker = GloveTracker(radius=RADIUS)
    state = tracker.init()
    for step in range(6):
        _, state = tracker.step([at(step / 30)], state)
    before = state.mean.copy()
    said = [tracker.step([], state, time)[0] for time in np.arange(5, 20) / 30 + 1e-6]
    assert [one.seen.all() for one in said] == [True] * 4 + [False] * 11
    assert [round(30 * one.time) for one in said] == list(range(5, 20))
    held = np.stack([one.position for one in said[4:]])
    np.testing.assert_allclose(held, np.broadcast_to(held[0], held.shape), atol=1e-12)
    np.testing.assert_allclose(said[3].position, before[:, :3] + before[:, 3:] * 3 / 30, atol=1e-6)
    spread = [one.covariance[0].trace() for one in said]
    # the speed that hands may have, and what is known of the last one, over ten and a half frames
    speeds = 0.5**2 + (before[0, 3:] ** 2).mean()
    assert np.all(np.diff(spread) > 0) and spread[-1] / 3 == pytest.approx(speeds * (10.5 / 30) ** 2, rel=0.1)
    assert np.array_equal(state.mean, before)
    assert np.array_equal(tracker.step([], state)[0].position, before[:, :3])


def test_a_time_that_is_asked_for_leaves_the_next_frames_alone():
    tracker = GloveTracker(radius=RADIUS)
    plain = asked = tracker.init()
    for step in range(5):
        _, plain = tracker.step([at(step / 30)], plain)
        _, asked = tracker.step([at(step / 30)], asked, time=step / 30 + 0.1)
    assert np.array_equal(plain.mean, asked.mean) and plain.time == asked.time

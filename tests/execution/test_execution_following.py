from __future__ import annotations

import numpy as np
import pytest
from scipy.linalg import expm

from eaip_prob.errors import InputError
from eaip_prob.execution.following import MotionLimits, followed, free_response, lateness, slowed

WIDE = MotionLimits(speed=50.0, acceleration=500.0)


def test_free_response_is_the_matrix_exponential():
    rate, elapsed = 1.7, np.array([[0.0, 0.3], [1.1, 4.0]])
    distance, velocity = free_response(elapsed, rate)
    for at in np.ndindex(2, 2):
        exact = expm(np.array([[0.0, 1.0], [-(rate**2), -2.0 * rate]]) * elapsed[at])
        np.testing.assert_allclose([distance[at], velocity[at]], exact, atol=1e-12)


def test_many_short_steps_are_one_long_one():
    rng = np.random.default_rng(0)
    now, still = rng.normal(size=(2, 3)), np.stack([rng.normal(size=3), np.zeros(3)])
    once = followed(now, np.stack([still, still]), 2.0, 1.3, WIDE)
    for _ in range(40):
        now = followed(now, np.stack([still, still]), 0.05, 1.3, WIDE)
    np.testing.assert_allclose(now, once, atol=1e-12)


@pytest.mark.parametrize("late", [0.0, 0.3, 0.6, 4.0, 5000.0])
def test_lateness_is_made_up_for_at_a_limited_haste(late):
    elapsed, slow = np.linspace(0.0, 9.0, 9001), [late]
    for _ in elapsed[1:]:
        slow.append(slow[-1] - 0.001 * min(0.6, slow[-1] / 1.0))
    np.testing.assert_allclose(lateness(late, elapsed), slow, atol=2e-3)


def test_a_moving_point_is_followed_without_delay():
    path = np.array([[[0.0, 0, 0], [0.4, 0, 0]], [[0.2, 0, 0], [0.4, 0, 0]]])
    np.testing.assert_allclose(followed(path[0], path, 0.5, 1.0, WIDE), path[1], atol=1e-15)


@pytest.mark.parametrize("seed", range(5))
def test_limits_are_kept_whatever_is_asked_for(seed):
    rng, limits, elapsed = np.random.default_rng(seed), MotionLimits(0.6, 1.5), 0.04
    now = np.zeros((2, 3))
    for _ in range(200):
        after = followed(now, 3.0 * rng.normal(size=(2, 2, 3)), elapsed, 2.0, limits)
        assert np.linalg.norm(after[1]) <= 0.6 + 1e-12
        assert np.linalg.norm(after[1] - now[1]) <= 1.5 * elapsed + 1e-12
        assert np.linalg.norm(after[0] - now[0]) <= 0.6 * elapsed + 1e-12
        now = after


def test_speed_and_acceleration_are_each_a_limit():
    gentle, path = MotionLimits(0.6, 1.5), np.zeros((2, 2, 3))
    path[:, 1, 0] = 0.6, 0.64
    after = followed(path[0], path, 0.1, 1.0, gentle)
    np.testing.assert_allclose(after[:, 0], [0.06, 0.6], atol=1e-12)
    path[:, 1, 0] = 0.0, 0.4
    after = followed(path[0], path, 0.1, 1.0, gentle)
    np.testing.assert_allclose(after[:, 0], [0.0075, 0.15], atol=1e-12)


@pytest.mark.parametrize("elapsed", [0.1, 0.5, 0.8, 30.0])
def test_slowing_down_is_uniform(elapsed):
    velocity, deceleration = np.array([0.3, 0.0, -0.4]), 0.8
    moving = min(elapsed, 0.5 / deceleration)
    way = 0.5 * moving - 0.5 * deceleration * moving**2
    position, after = slowed(np.stack([np.ones(3), velocity]), elapsed, deceleration)
    np.testing.assert_allclose(position, 1.0 + way * velocity / 0.5, atol=1e-15)
    np.testing.assert_allclose(np.linalg.norm(after), 0.5 - deceleration * moving, atol=1e-15)


def test_slowed_in_steps_stands_where_one_step_ends_and_stays():
    now = np.array([[0.0, 0.0, 0.0], [0.3, -0.2, 0.6]])
    once = slowed(now, 3.0, 1.0)
    for _ in range(90):
        now = slowed(now, 1.0 / 30.0, 1.0)
    np.testing.assert_allclose(now, once, atol=1e-12)
    assert (now[1] == 0.0).all()
    assert np.linalg.norm(now[0]) == pytest.approx(0.49 / 2.0)


def test_keeps_looks_at_speed_and_at_acceleration():
    limits, time = MotionLimits(speed=0.5, acceleration=1.0), np.array([0.0, 0.1, 0.2])
    calm = np.array([[0.4, 0, 0], [0.45, 0, 0], [0.5, 0, 0]])
    assert limits.keeps(calm, time)
    assert not limits.keeps(1.2 * calm, time)
    assert not limits.keeps(calm * [[1], [-0.2], [1]], time)


@pytest.mark.parametrize("name", ["speed", "acceleration", "deceleration"])
@pytest.mark.parametrize("value", [0.0, -1.0, float("nan")])
def test_limits_are_above_zero(name, value):
    with pytest.raises(InputError, match=f"Expected {name} above zero"):
        MotionLimits(**{name: value})

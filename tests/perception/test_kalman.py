from __future__ import annotations

import numpy as np
import pytest

from eaip_prob.errors import InputError
from eaip_prob.perception import kalman


def test_two_half_steps_are_one_step():
    mean, spread = np.arange(6.0), np.diag([1.0, 2, 3, 4, 5, 6]) * 1e-3
    whole = kalman.predict(mean, spread, 0.2, density=3.0)
    half = kalman.predict(*kalman.predict(mean, spread, 0.1, density=3.0), 0.1, density=3.0)
    np.testing.assert_allclose(whole[0], half[0], atol=1e-12)
    np.testing.assert_allclose(whole[1], half[1], atol=1e-12)


def test_time_does_not_run_backwards():
    with pytest.raises(InputError, match="not below zero"):
        kalman.predict(np.zeros(6), np.eye(6), -0.1, density=1.0)


def test_update_is_conditioning_a_gaussian():
    generator = np.random.default_rng(0)
    root = generator.normal(size=(6, 6))
    spread, noise, mean = root @ root.T, np.diag([0.3, 0.2, 0.1]), generator.normal(size=6)
    position = generator.normal(size=3)
    precision = np.linalg.inv(spread)
    precision[:3, :3] += np.linalg.inv(noise)
    expected = np.linalg.inv(precision)
    shift = np.linalg.inv(spread) @ mean + np.concatenate([np.linalg.inv(noise) @ position, np.zeros(3)])
    updated, covariance = kalman.update(mean, spread, position, noise)
    np.testing.assert_allclose(covariance, expected, atol=1e-8)
    np.testing.assert_allclose(updated, expected @ shift, atol=1e-8)


def test_filter_is_as_unsure_as_it_is_wrong():
    generator = np.random.default_rng(1)
    noise, squares = np.diag([1e-4, 4e-4, 1e-4]), []
    for _ in range(200):
        truth = np.concatenate([np.zeros(3), 0.5 * generator.normal(size=3)])
        measured = truth[:3] + np.sqrt(np.diag(noise)) * generator.normal(size=3)
        mean, spread = kalman.start(measured, noise, speed=0.5)
        for _ in range(10):
            truth, drift = kalman.predict(truth, np.zeros((6, 6)), 0.05, density=2.0)
            truth = truth + np.linalg.cholesky(drift) @ generator.normal(size=6)
            measured = truth[:3] + np.sqrt(np.diag(noise)) * generator.normal(size=3)
            mean, spread = kalman.update(*kalman.predict(mean, spread, 0.05, density=2.0), measured, noise)
        squares.append((truth - mean) @ np.linalg.solve(spread, truth - mean))
    assert abs(np.mean(squares) - 6.0) < 3.0 * np.sqrt(12.0 / 200)

r"""A point in space that moves with nearly constant velocity, followed by a Kalman filter.

State: (position, velocity), six numbers, m and m/s. Letters: P covariance of the state, R of a measured position,
S = H P H^T + R of the innovation, K = P H^T S^-1 the gain, q spectral density of the acceleration.
"""

from __future__ import annotations

import numpy as np
from jaxtyping import Float

from eaip_prob.errors import InputError

_POSITION = slice(0, 3)
_VELOCITY = slice(3, 6)


def start(
    position: Float[np.ndarray, "3"], covariance: Float[np.ndarray, "3 3"], speed: float
) -> tuple[Float[np.ndarray, "6"], Float[np.ndarray, "6 6"]]:
    """(mean, covariance) of something at rest as far as anybody knows.

    Args:
        position: (3,), m.
        covariance: (3, 3), of the position, m^2.
        speed: standard deviation of each component of its velocity, m/s.

    Example:
        >>> mean, spread = start(np.array([1.0, 0.0, 0.5]), np.eye(3) * 1e-4, speed=0.5)
        >>> mean.tolist(), spread.diagonal().round(4).tolist()
        ([1.0, 0.0, 0.5, 0.0, 0.0, 0.0], [0.0001, 0.0001, 0.0001, 0.25, 0.25, 0.25])
    """
    spread = np.zeros((6, 6))
    spread[_POSITION, _POSITION] = covariance
    spread[_VELOCITY, _VELOCITY] = speed**2 * np.eye(3)
    return np.concatenate([position, np.zeros(3)]), spread


def predict(
    mean: Float[np.ndarray, "6"], covariance: Float[np.ndarray, "6 6"], step: float, density: float
) -> tuple[Float[np.ndarray, "6"], Float[np.ndarray, "6 6"]]:
    r"""(mean, covariance) a while later, under white acceleration.

    F = [[I, D I], [0, I]], Q = q [[D^3 / 3 I, D^2 / 2 I], [D^2 / 2 I, D I]] with D the step
    (Bar-Shalom, Li and Kirubarajan, Estimation with Applications to Tracking and Navigation, 2001, Sec. 6.2.2).

    Args:
        mean: (6,), m and m/s.
        covariance: (6, 6).
        step: s, not below zero; two steps of one half equal one.
        density: q, of the acceleration, m^2/s^3.

    Raises:
        InputError: time that runs backwards.

    Example:
        >>> mean, spread = predict(np.array([0.0, 0, 0, 1, 0, 0]), np.eye(6) * 1e-4, step=0.1, density=2.0)
        >>> mean[:3].tolist()
        [0.1, 0.0, 0.0]
    """
    if not step >= 0:
        raise InputError(f"Expected a step of time not below zero, got {step:g} s. Leave out frames that come late.")
    transition = np.eye(6)
    transition[_POSITION, _VELOCITY] = step * np.eye(3)
    noise = density * np.array([[step**3 / 3, step**2 / 2], [step**2 / 2, step]])
    return transition @ mean, transition @ covariance @ transition.T + np.kron(noise, np.eye(3))


def update(
    mean: Float[np.ndarray, "6"],
    covariance: Float[np.ndarray, "6 6"],
    position: Float[np.ndarray, "3"],
    noise: Float[np.ndarray, "3 3"],
) -> tuple[Float[np.ndarray, "6"], Float[np.ndarray, "6 6"]]:
    """(mean, covariance) once a position was measured; (I - K H) P (I - K H)^T + K R K^T (Joseph).

    Args:
        mean: (6,), m and m/s.
        covariance: (6, 6).
        position: (3,), m.
        noise: (3, 3), R, m^2.

    Example:
        >>> mean, spread = start(np.zeros(3), np.eye(3), speed=1.0)
        >>> mean, spread = update(mean, spread, np.array([1.0, 0.0, 0.0]), np.eye(3))
        >>> mean[0].round(9), spread[0, 0].round(9)
        (np.float64(0.5), np.float64(0.5))
    """
    innovation = covariance[_POSITION, _POSITION] + noise
    gain = np.linalg.solve(innovation, covariance[_POSITION]).T
    left = np.eye(6)
    left[:, _POSITION] -= gain
    updated = left @ covariance @ left.T + gain @ noise @ gain.T
    return mean + gain @ (position - mean[_POSITION]), 0.5 * (updated + updated.T)


def negative_log_likelihood(
    mean: Float[np.ndarray, "6"],
    covariance: Float[np.ndarray, "6 6"],
    position: Float[np.ndarray, "3"],
    noise: Float[np.ndarray, "3 3"],
) -> float:
    """d^T S^-1 d + log det S of a measured position, d its innovation; the constant is left out.

    Args:
        mean: (6,), m and m/s.
        covariance: (6, 6).
        position: (3,), m.
        noise: (3, 3), R, m^2.

    Example:
        >>> mean, spread = start(np.zeros(3), np.eye(3) * 0.5, speed=1.0)
        >>> negative_log_likelihood(mean, spread, np.array([0.0, 2.0, 0.0]), np.eye(3) * 0.5)
        4.0
    """
    factor = np.linalg.cholesky(covariance[_POSITION, _POSITION] + noise)
    whitened = np.linalg.solve(factor, position - mean[_POSITION])
    return float(whitened @ whitened + 2.0 * np.log(factor.diagonal()).sum())

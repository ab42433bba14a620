"""The core operations done the plain way, in numpy: what `core.py` compares the package with.

Letters: N motions, T samples, D signals, B weights of one signal, K weights of an agent (h human, r robot).
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from jaxtyping import Float


def encode(
    design: Float[np.ndarray, "time basis"], values: Float[np.ndarray, "motions time signals"], ridge: float
) -> Float[np.ndarray, "motions signals basis"]:
    """Least squares with one solve for all motions and signals; the ridge is relative to the diagonal."""
    gram = design.T @ design
    encoder = np.linalg.solve(gram + ridge * np.diag(gram.diagonal()), design.T)
    return values.swapaxes(-1, -2) @ encoder.T


def condition(
    mean: Float[np.ndarray, " weights"],
    covariance: Float[np.ndarray, "weights weights"],
    design: Float[np.ndarray, "time basis"],
    values: Float[np.ndarray, "time signals"],
    deviation: Float[np.ndarray, " signals"],
) -> tuple[Float[np.ndarray, " robot"], Float[np.ndarray, "robot robot"]]:
    """(mean, covariance) of the robot's weights from rows (D T, K_h) written out, in observation space."""
    from scipy.linalg import cho_factor, cho_solve

    rows = np.kron(np.eye(values.shape[1]), design)
    human = rows.shape[1]
    cross = covariance[human:, :human] @ rows.T
    innovation = rows @ covariance[:human, :human] @ rows.T + np.diag(np.repeat(deviation**2, len(design)))
    gain = cho_solve(cho_factor(innovation, lower=True), cross.T).T
    residual = values.T.ravel() - rows @ mean[:human]
    return mean[human:] + gain @ residual, covariance[human:, human:] - gain @ cross.T


def predict(
    prior: tuple[np.ndarray, np.ndarray],
    seen: tuple[np.ndarray, np.ndarray, np.ndarray],
    design: Float[np.ndarray, "times basis"],
    residual: Float[np.ndarray, " signals"],
) -> tuple[Float[np.ndarray, "times signals"], Float[np.ndarray, "times signals"]]:
    """(mean, variance) of the robot's positions: `condition`, then read through a design."""
    mean, covariance = condition(*prior, *seen)
    num_signals, num_basis = len(residual), design.shape[1]
    blocks = covariance.reshape(num_signals, num_basis, num_signals, num_basis)
    own = blocks[np.arange(num_signals), :, np.arange(num_signals)]
    variance = np.einsum("tb,dbc,tc->td", design, own, design, optimize=True)
    return design @ mean.reshape(num_signals, num_basis).T, variance + residual


def rollout(
    weights: Float[np.ndarray, "*batch signals basis"],
    forcing: Float[np.ndarray, "steps forcing"],
    duration: float,
    alpha: float,
    beta: float,
) -> Float[np.ndarray, "*batch steps signals"]:
    """A DMP integrated by Euler steps over its phase, all motions at once; weights are [w, g, y0, v0]."""
    force, goal = weights[..., :-3] @ forcing.T, weights[..., -3]
    position, speed = weights[..., -2], weights[..., -1] * duration
    step = 1.0 / (len(forcing) - 1)
    path = np.empty((*position.shape, len(forcing)))
    for k in range(len(forcing)):
        path[..., k] = position
        push = alpha * (beta * (goal - position) - speed) + force[..., k]
        position, speed = position + step * speed, speed + step * push
    return path.swapaxes(-1, -2)


def dtw_step(
    sample: Float[np.ndarray, " signals"], reference: Float[np.ndarray, "reference signals"], last: Sequence[float]
) -> tuple[int, float, list[float]]:
    """(end index, cost, next column) of open-end alignment after one more sample; `last` is empty before the first."""
    distances = np.sqrt(((reference - sample) ** 2).sum(1)).tolist()
    column = [distances[0] + (last[0] if last else 0.0)]
    for j in range(1, len(distances)):
        before = min(column[-1], last[j], last[j - 1]) if last else column[-1]
        column.append(distances[j] + before)
    cost = min(column)
    return column.index(cost), cost, column


def dtw(
    query: Float[np.ndarray, "query signals"], reference: Float[np.ndarray, "reference signals"]
) -> tuple[int, float]:
    """(end index, cost) of open-end alignment after the last sample."""
    end_index, cost, column = 0, 0.0, []
    for sample in query:
        end_index, cost, column = dtw_step(sample, reference, column)
    return end_index, cost

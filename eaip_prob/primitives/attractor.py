"""The spring-damper behind a DMP as a linear response, tabulated once and read at any phase.

By phase s, with x = exp(-alpha_x s), Eq. 1 is linear in everything that a motion can choose:

    y'' = alpha_y (beta_y (g - y) - y') + phi(x)^T w

Particular response: columns [w, g] from rest at zero. Homogeneous response: columns [y0, v0], v0 by phase. Steps of the
table are exact in the attractor (matrix exponential) and use Gauss-Legendre nodes for the forcing; between nodes a
quintic Hermite polynomial through position, velocity and acceleration is accurate to about 1e-12 of the amplitude.
"""

from __future__ import annotations

import functools
from dataclasses import dataclass

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor

from eaip_prob.primitives.basis import forcing_basis

_STEPS_PER_PHASE = 256


@dataclass(frozen=True)
class AttractorParameters:
    """Constants of Eq. 1 and 2: see `DMP`."""

    num_basis: int
    limit: float
    alpha_y: float
    beta_y: float
    alpha_x: float
    overlap: float


@dataclass(frozen=True, eq=False)
class Response:
    """Every column of the response as a polynomial of degree five on each of equal intervals of [0, limit].

    Args:
        limit: last phase of the table.
        table: (6 intervals, columns), coefficients of the powers 0..5 of the share of each interval that has passed;
            columns [w, g] then [y0, v0].
    """

    limit: float
    table: Float[Tensor, "coefficients columns"]

    def at(self, phase: Float[Tensor, "*batch"], order: int = 0) -> Float[Tensor, "*batch columns"]:
        """Position (order 0) or derivative by phase (order 1); outside the table it is read at its ends, at rest."""
        num_intervals = self.table.shape[0] // 6
        inside = phase.clamp(0.0, self.limit)
        scaled = (inside * (num_intervals / self.limit)).flatten()
        interval = scaled.floor().clamp_max(num_intervals - 1)
        powers = torch.arange(order, 6)
        factor = (scaled - interval)[:, None] ** (powers - order)
        if order == 1:
            factor = factor * powers * (num_intervals / self.limit)
        row = 6 * interval.long()[:, None] + powers
        columns = torch.nn.functional.embedding_bag(row, self.table, per_sample_weights=factor, mode="sum")
        columns = columns.unflatten(0, phase.shape)
        return columns if order == 0 else torch.where((phase == inside)[..., None], columns, 0.0)


# Rows: powers 0..5 of a quintic on [0, 1]; columns: position, velocity, acceleration at 0, the same at 1.
_HERMITE = np.array(
    [
        [1.0, 0.0, 0.0, 0.0, 0.0, 0.0],
        [0.0, 1.0, 0.0, 0.0, 0.0, 0.0],
        [0.0, 0.0, 0.5, 0.0, 0.0, 0.0],
        [-10.0, -6.0, -1.5, 10.0, -4.0, 0.5],
        [15.0, 8.0, 1.5, -15.0, 7.0, -1.0],
        [-6.0, -3.0, -0.5, 6.0, -3.0, 0.5],
    ]
)


@functools.lru_cache(maxsize=32)
def attractor_response(parameters: AttractorParameters) -> Response:
    """The table of responses of a DMP; kept, as one primitive is evaluated many times."""
    alpha, beta = parameters.alpha_y, parameters.beta_y
    num_steps = max(2, int(np.ceil(_STEPS_PER_PHASE * parameters.limit)))
    step = parameters.limit / num_steps
    system = np.array([[0.0, 1.0], [-alpha * beta, -alpha]])
    phases = np.arange(num_steps + 1) * step
    states = np.zeros((num_steps + 1, 2, parameters.num_basis + 3))
    states[0, :, -2:] = np.eye(2)
    transition = _exponential(system, step)
    push = _impulses(parameters, system, phases[:-1], step)
    for k in range(num_steps):
        states[k + 1] = transition @ states[k] + push[k]
    acceleration = system[1] @ states + np.pad(_forcing(parameters, phases), ((0, 0), (0, 2)))
    nodes = np.concatenate([states, acceleration[:, None, :]], axis=1) * step ** np.arange(3)[:, None]
    table = _HERMITE @ np.concatenate([nodes[:-1], nodes[1:]], axis=1)
    return Response(parameters.limit, torch.from_numpy(table.reshape(-1, table.shape[-1])))


def free_response(phase: Float[Tensor, "*batch"], alpha_y: float, beta_y: float) -> Float[Tensor, "*batch 2"]:
    """Columns [y0, v0] of the attractor without goal or forcing, any phase (v0 by phase) after the start.

    Example:
        >>> free_response(torch.tensor([0.0, 3.0], dtype=torch.float64), 25.0, 6.25).abs().round(decimals=6)
        tensor([[1., 0.],
                [0., 0.]], dtype=torch.float64)
    """
    system = phase.new_tensor([[0.0, 1.0], [-alpha_y * beta_y, -alpha_y]])
    return torch.linalg.matrix_exp(system * phase.clamp_min(0.0)[..., None, None])[..., 0, :]


def _forcing(parameters: AttractorParameters, phase: np.ndarray) -> np.ndarray:
    """Columns [phi(x), alpha_y beta_y] of the forcing of [w, g] (Eq. 13)."""
    p = parameters
    basis = forcing_basis(torch.from_numpy(phase), p.num_basis, p.limit, p.alpha_x, p.overlap).numpy()
    return np.concatenate([basis, np.full((*phase.shape, 1), p.alpha_y * p.beta_y)], axis=-1)


def _impulses(parameters: AttractorParameters, system: np.ndarray, starts: np.ndarray, step: float) -> np.ndarray:
    """Integral of exp(A (step - u)) [0, f(start + u)] over each step, by five Gauss-Legendre nodes."""
    nodes, weights = np.polynomial.legendre.leggauss(5)
    result = np.zeros((len(starts), 2, parameters.num_basis + 3))
    for node, weight in zip(0.5 * step * (nodes + 1.0), 0.5 * step * weights, strict=True):
        column = _exponential(system, step - node)[:, 1]
        result[:, :, :-2] += weight * column[None, :, None] * _forcing(parameters, starts + node)[:, None, :]
    return result


def _exponential(system: np.ndarray, time: float) -> np.ndarray:
    from scipy.linalg import expm

    return expm(system * time)

"""Demonstrations as weights: one clock for all agents, motions at rest after their end."""

from __future__ import annotations

from dataclasses import dataclass

import torch
from jaxtyping import Float
from torch import Tensor

from eaip_prob.data.resampling import held
from eaip_prob.data.trajectory import Trajectory
from eaip_prob.phase.base import PhaseEstimate
from eaip_prob.primitives.base import AbstractPrimitive, Boundary, initial_boundary

_ROUND_OFF = 1e-9


@dataclass(frozen=True, eq=False)
class EncodedAgent:
    """Demonstrations of one agent as weights.

    Args:
        weights: (N, K).
        residual: (D,), variance of what the primitive cannot represent, per signal, in its units squared.
        boundary: (N, D), starts of the motions.
    """

    weights: Float[Tensor, "demonstrations weights"]
    residual: Float[Tensor, "signals"]
    boundary: Boundary


def encode(primitive: AbstractPrimitive, trajectory: Trajectory, phase: PhaseEstimate, limit: float) -> EncodedAgent:
    """Weights of complete motions on the clock's phase, with the last value held up to the clock's limit.

    Args:
        primitive: spanning [0, limit].
        trajectory: (N, T, D), complete motions.
        phase: (N,) with J = 1, the clock of each demonstration.
        limit: last phase of the clock.
    """
    duration = phase.duration[..., 0]
    rest = held(trajectory, phase.time[..., 0] + limit * duration)
    paths = phase.at(rest.time)[..., 0, :]
    rest, paths = _within(rest, paths, limit)
    weights = primitive.encode(rest, paths, duration)
    boundary = initial_boundary(trajectory)
    seen_paths = phase.at(trajectory.time)[..., 0, :]
    error = primitive.decode(weights, seen_paths, duration, boundary) - trajectory.values
    count = trajectory.mask.sum((0, 1)).clamp_min(1)
    squared = torch.where(trajectory.mask, error.square(), 0.0).sum((0, 1))
    # A signal that is reproduced exactly (always zero) still needs a density: its round-off stands in.
    power = trajectory.values.square().sum((0, 1)) / count
    floor = _ROUND_OFF**2 * torch.where(power > 0, power, 1.0)
    return EncodedAgent(weights, torch.maximum(squared / count, floor), boundary)


def _within(trajectory: Trajectory, paths: Tensor, limit: float) -> tuple[Trajectory, Tensor]:
    """Drops samples behind the limit; a clock shared by all motions keeps a rectangular, unmasked batch."""
    inside = paths <= limit + _ROUND_OFF
    if paths.ndim == 1:
        count = int(inside.sum())
        return trajectory.first(count), paths[:count].clamp_max(limit)
    mask = trajectory.mask & inside[..., None]
    return Trajectory(trajectory.time, trajectory.values, trajectory.names, mask, trajectory.noise), paths.clamp_max(
        limit
    )

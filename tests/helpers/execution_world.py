"""Motions of the robot's gripper over an object, as predictions."""

from __future__ import annotations

import numpy as np
import torch

from eaip_prob.data.trajectory import Trajectory
from eaip_prob.execution import Obstacle, known_path
from eaip_prob.forecast import Prediction
from eaip_prob.primitives import AbstractPrimitive

SIGNALS = ("x", "y", "z")
DURATION = 10.0
START = np.array([0.45, -0.6, -0.15])


def smooth(share: np.ndarray) -> np.ndarray:
    return share**3 * (10.0 - 15.0 * share + 6.0 * share**2)


def path(height: float = 0.5, duration: float = DURATION) -> tuple[np.ndarray, np.ndarray]:
    """(time, positions) of a sweep to the left that rises by `height` on its way."""
    time = np.linspace(0.0, duration, 120)
    share = smooth(time / duration)
    rise = height * np.sin(np.pi * share) ** 2
    return time, START + np.column_stack([0.05 * share, 1.2 * share, rise])


def sweep(
    height: float = 0.5,
    std: float | tuple[float, ...] = 0.0,
    duration: float = DURATION,
    names: tuple[str, ...] = SIGNALS,
    primitive: AbstractPrimitive | None = None,
) -> Prediction:
    time, positions = path(height, duration)
    order = [SIGNALS.index(name) for name in names if name in SIGNALS]
    motion = Trajectory(torch.from_numpy(time), torch.from_numpy(positions[:, order]), names)
    return known_path(motion, std, primitive)


def box(top: float, std: float = 0.0, width: float = 0.4) -> Obstacle:
    """An object in the middle of the sweep."""
    height = top + 0.93
    return Obstacle(np.array([0.95, 0.0, top - height / 2, 0.4, width, height]), std**2 * np.eye(6))

"""Movement primitives: trajectories of one agent as weights, and back, affine in the weights.

    y(t) = design(phase(t)) @ w + offset

Phase is 0 at the start and 1 at the end that the clock expects; the bases span [0, limit], behind which the goal is
held. Weights of an agent are signal-major: all weights of the first signal, then those of the second.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass, replace
from typing import ClassVar, Self

import torch
from jaxtyping import Float
from torch import Tensor

from eaip_prob.checks import as_float64, check_finite, check_positive
from eaip_prob.data.trajectory import Trajectory
from eaip_prob.errors import ShapeError


@dataclass(frozen=True, eq=False)
class Boundary:
    """Where a motion starts, for primitives whose weights do not hold it.

    Args:
        start: (*batch, D), position at phase 0.
        velocity: (*batch, D), units per second at phase 0.

    Example:
        >>> Boundary(start=[0.1, 0.2], velocity=[0.0, 0.0]).start
        tensor([0.1000, 0.2000], dtype=torch.float64)
    """

    start: Float[Tensor, "*batch signals"]
    velocity: Float[Tensor, "*batch signals"]

    def __post_init__(self) -> None:
        object.__setattr__(self, "start", as_float64("start", self.start))
        object.__setattr__(self, "velocity", as_float64("velocity", self.velocity))


@dataclass(frozen=True)
class AbstractPrimitive(ABC):
    """One signal's weights to positions and velocities, and an encoder.

    A subclass gives `num_weights`, `rows` and `encode`; in return it gets `design`, `decode`, `velocity`, and
    works with every evidence, clock and joint model.

    Args:
        limit: last phase that the bases span, dimensionless; behind it the goal is held.
    """

    limit: float
    weights_are_positions: ClassVar[bool] = False  # whether each weight is a position of the signal near one phase

    @property
    @abstractmethod
    def num_weights(self) -> int:
        """Weights of one signal."""

    @abstractmethod
    def rows(
        self,
        phase: Float[Tensor, "*#batch time"],
        duration: Float[Tensor, "*#batch"],
        boundary: Boundary | None,
        order: int,
    ) -> tuple[Float[Tensor, "*#batch time basis"], Float[Tensor, "*#batch #signals #time"]]:
        """(matrix, offset) of the positions (order 0), or of their derivative by phase (order 1).

        Args:
            phase: values outside [0, limit] are held at the nearer end.
            duration: time in which the phase grows by 1, seconds.
            boundary: start of the motion; None where the weights hold it.
            order: 0 or 1.
        """

    @abstractmethod
    def encode(
        self, trajectory: Trajectory, phase: Float[Tensor, "*#batch time"], duration: Tensor | float
    ) -> Float[Tensor, "*batch weights"]:
        """Weights (*batch, D B) that reproduce the seen samples best.

        Args:
            trajectory: complete motions, batched.
            phase: of each sample.
            duration: time in which the phase grows by 1, seconds.
        """

    @property
    def needs_boundary(self) -> bool:
        """Whether positions also need a `Boundary`, because the weights do not hold the start."""
        return False

    def spanning(self, limit: float) -> Self:
        """The same primitive with bases over [0, limit]."""
        return replace(self, limit=check_positive("limit", limit))

    def gram(
        self, num_signals: int, duration: Tensor | float = 1.0, num_phases: int = 200
    ) -> Float[Tensor, "weights weights"]:
        """(K, K) matrix with w^T gram w the mean square of the positions that weights w decode to, over [0, limit].

        Args:
            num_signals: D.
            duration: time in which the phase grows by 1, seconds; a start velocity in the weights counts with it.
            num_phases: points over which the mean is taken.
        """
        phase = torch.linspace(0.0, self.limit, num_phases, dtype=torch.float64)
        rest = torch.zeros(1, dtype=torch.float64)
        matrix, _ = self.design(phase, duration, Boundary(rest, rest) if self.needs_boundary else None)
        return torch.block_diag(*[matrix.mT @ matrix / num_phases] * num_signals)

    def design(
        self, phase: Tensor, duration: Tensor | float = 1.0, boundary: Boundary | None = None
    ) -> tuple[Float[Tensor, "*#batch time basis"], Float[Tensor, "*#batch #signals #time"]]:
        """(matrix, offset) with positions = matrix @ weights + offset, per signal.

        Args:
            phase: (*batch, T), dimensionless.
            duration: (*batch,), time in which the phase grows by 1, seconds.
            boundary: start of the motion, where `needs_boundary`.
        """
        return self.rows(_checked(phase), as_float64("duration", duration), boundary, 0)

    def decode(
        self,
        weights: Float[Tensor, "*batch weights"],
        phase: Float[Tensor, "*#batch time"],
        duration: Tensor | float = 1.0,
        boundary: Boundary | None = None,
    ) -> Float[Tensor, "*batch time signals"]:
        """Positions (*batch, T, D) at the given phases, in the signals' units."""
        matrix, offset = self.design(phase, duration, boundary)
        return _applied(self.per_signal(weights), matrix, offset)

    def velocity(
        self,
        weights: Float[Tensor, "*batch weights"],
        phase: Float[Tensor, "*#batch time"],
        duration: Tensor | float,
        boundary: Boundary | None = None,
    ) -> Float[Tensor, "*batch time signals"]:
        """Velocities (*batch, T, D) in units per second: the derivative by phase over `duration`."""
        duration = as_float64("duration", duration)
        matrix, offset = self.rows(_checked(phase), duration, boundary, 1)
        rate = 1.0 / duration[..., None, None]
        return _applied(self.per_signal(weights) * rate, matrix, offset * rate)

    def per_signal(self, weights: Float[Tensor, "*batch weights"]) -> Float[Tensor, "*batch signals basis"]:
        """Weights with their own signal axis.

        Raises:
            ShapeError: the number of weights is no multiple of `num_weights`.
        """
        weights = as_float64("weights", weights)
        if weights.ndim == 0 or weights.shape[-1] == 0 or weights.shape[-1] % self.num_weights:
            raise ShapeError(
                f"Expected weights in multiples of {self.num_weights} (one set a signal), got {tuple(weights.shape)}."
            )
        return weights.unflatten(-1, (-1, self.num_weights))


def _checked(phase: Tensor) -> Float[Tensor, "*batch time"]:
    phase = as_float64("phase", phase)
    if phase.ndim == 0:
        raise ShapeError("Expected phase with shape (*batch, T), got a single number. Use phase[None].")
    check_finite("phase", phase)
    return phase


def _applied(weights: Tensor, matrix: Tensor, offset: Tensor) -> Float[Tensor, "*batch time signals"]:
    path = weights @ matrix.mT
    # Adding nothing would cost a second pass over the batch.
    return (path + offset if bool(offset.any()) else path).mT


def initial_boundary(trajectory: Trajectory, num_samples: int = 5) -> Boundary:
    """Start and velocity of each signal from its first seen samples.

    The position of the first seen sample, and the slope of a straight line through the first `num_samples` seen ones
    (a difference of two samples would carry the sensor's noise undamped). A signal never seen starts at 0, at rest.

    Args:
        trajectory: values (*batch, T, D).
        num_samples: samples of the slope, fewer where fewer were seen.

    Returns:
        (*batch, D) start, in the signals' units, and velocity, in units per second.

    Example:
        >>> reach = Trajectory(time=[0.0, 0.5, 1.0], values=[[3.0], [4.0], [5.0]])
        >>> boundary = initial_boundary(reach)
        >>> boundary.start.tolist(), boundary.velocity.tolist()
        ([3.0], [2.0])
    """
    mask = trajectory.mask
    order = mask.cumsum(-2)
    early = (mask & (order <= num_samples)).to(torch.float64)
    time = (trajectory.time - trajectory.time[..., :1]).expand(mask.shape[:-1])[..., None]
    count = early.sum(-2).clamp_min(1.0)
    centred = (time - ((early * time).sum(-2) / count)[..., None, :]) * early
    spread = centred.square().sum(-2)
    slope = (centred * trajectory.values).sum(-2) / spread.clamp_min(1e-300)
    start = (trajectory.values * (mask & (order == 1))).sum(-2)
    return Boundary(start, torch.where(spread > 0, slope, 0.0))

"""A clock that does not know the duration: many durations side by side, weighted by what is seen."""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass
from typing import Self

import torch
from jaxtyping import Float
from torch import Tensor

from eaip_prob.data.demonstrations import DemonstrationSet
from eaip_prob.data.environment import EnvironmentFeatures
from eaip_prob.data.trajectory import Trajectory
from eaip_prob.errors import InputError
from eaip_prob.phase.base import AbstractPhaseEstimator, PhaseEstimate, check_durations, require_fitted

_REACH = 2.4  # standard deviations of log T on either side


@dataclass(frozen=True, eq=False)
class MarginalClock(AbstractPhaseEstimator):
    """J durations on an even grid of log T, log T normal as in the demonstrations.

    Demonstrations are encoded with time over their own duration, so that tempo does not blur their shape; online each
    duration is a hypothesis, and the evidence of the samples seen decides between them. Right where people are faster
    or slower all along; where only parts of a motion vary, `ElapsedClock` is the safer one.

    Args:
        num_durations: J, at least 3. The grid should be finer than what the samples tell about the duration: 25 for a
            coefficient of variation of 10 %.
        mean: of log T (s); None until fitted.
        deviation: standard deviation of log T; None until fitted.

    Raises:
        InputError: fewer than three durations.
    """

    num_durations: int = 25
    mean: float | None = None
    deviation: float | None = None

    def __post_init__(self) -> None:
        if self.num_durations < 3:
            raise InputError(f"Expected at least 3 durations, got {self.num_durations}. One duration is ElapsedClock.")

    def fit(self, demonstrations: DemonstrationSet, agent: str) -> Self:
        """Mean and standard deviation of log T."""
        log_duration = check_durations(demonstrations.trajectories(agent)).log()
        deviation = float(log_duration.std()) if len(log_duration) > 1 else 0.0
        return dataclasses.replace(self, mean=float(log_duration.mean()), deviation=deviation)

    def encoding(self, trajectory: Trajectory, environment: EnvironmentFeatures | None = None) -> PhaseEstimate:
        """Time over each motion's own duration."""
        return PhaseEstimate.linear(trajectory.time, check_durations(trajectory))

    def estimate(self, trajectory: Trajectory, environment: EnvironmentFeatures | None = None) -> PhaseEstimate:
        """Elapsed time over each duration, weighted by the normal density of its logarithm."""
        require_fitted(self.mean, "MarginalClock")
        assert self.mean is not None and self.deviation is not None
        grid, log_weight = duration_grid(self.num_durations)
        duration = torch.exp(self.mean + self.deviation * grid)
        elapsed = (trajectory.time - trajectory.time[..., :1])[..., None, :]
        return PhaseEstimate(trajectory.time, elapsed / duration[:, None], log_weight, duration)


def duration_grid(num_durations: int) -> tuple[Float[Tensor, "durations"], Float[Tensor, "durations"]]:
    """(standard deviations of log T from its mean, log weights under a normal density, normalised)."""
    grid = torch.linspace(-_REACH, _REACH, num_durations, dtype=torch.float64)
    return grid, torch.log_softmax(-0.5 * grid.square(), 0)

"""A clock that does not know the duration: many durations side by side, weighted by what is seen."""

from __future__ import annotations

import dataclasses
import math
from dataclasses import dataclass
from typing import Self

import torch
from jaxtyping import Float
from torch import Tensor

from eaip_prob.checks import check_positive
from eaip_prob.data.demonstrations import DemonstrationSet
from eaip_prob.data.environment import EnvironmentFeatures
from eaip_prob.data.trajectory import Trajectory
from eaip_prob.errors import InputError
from eaip_prob.phase.base import AbstractPhaseEstimator, PhaseEstimate, check_durations, require_fitted

REACH = 2.4  # standard deviations of log T on either side


@dataclass(frozen=True, eq=False)
class MarginalClock(AbstractPhaseEstimator):
    """J durations on an even grid of log T, log T normal as in the demonstrations.

    Demonstrations are encoded with time over their own duration, so that tempo does not blur their shape; online each
    duration is a hypothesis, and the evidence of the samples seen decides between them. Right where people are faster
    or slower all along; where only parts of a motion vary, `ElapsedClock` is the safer one.

    Args:
        num_durations: J, at least 3. The grid should be finer than what the samples tell about the duration: 25 for a
            coefficient of variation of 10 %.
        reach: standard deviations of log T to either side of the mean that the grid spans. People faster or slower than
            anybody who demonstrated need more than the default.
        student: whether log T is Student's t of as many degrees of freedom as there are groups less one, which is what
            is known of a new person where the deviation is that of a few; else it is normal.
        mean: of log T (s); None until fitted.
        deviation: standard deviation of log T; None until fitted.
        freedom: degrees of freedom of log T, found by `fit`; infinite for the normal density.

    Raises:
        InputError: fewer than three durations, or a reach not above zero.
    """

    num_durations: int = 25
    reach: float = REACH
    student: bool = False
    mean: float | None = None
    deviation: float | None = None
    freedom: float = math.inf

    def __post_init__(self) -> None:
        check_grid(self.num_durations, self.reach)

    def fit(self, demonstrations: DemonstrationSet, agent: str) -> Self:
        """Mean and standard deviation of log T."""
        log_duration = check_durations(demonstrations.trajectories(agent)).log()
        deviation = float(log_duration.std()) if len(log_duration) > 1 else 0.0
        freedom = degrees_of_freedom(demonstrations, self.student)
        return dataclasses.replace(self, mean=float(log_duration.mean()), deviation=deviation, freedom=freedom)

    def encoding(self, trajectory: Trajectory, environment: EnvironmentFeatures | None = None) -> PhaseEstimate:
        """Time over each motion's own duration."""
        return PhaseEstimate.linear(trajectory.time, check_durations(trajectory))

    def estimate(self, trajectory: Trajectory, environment: EnvironmentFeatures | None = None) -> PhaseEstimate:
        """Elapsed time over each duration, weighted by the normal density of its logarithm."""
        require_fitted(self.mean, "MarginalClock")
        assert self.mean is not None and self.deviation is not None
        grid, log_weight = duration_grid(self.num_durations, self.reach, self.freedom)
        duration = torch.exp(self.mean + self.deviation * grid)
        elapsed = (trajectory.time - trajectory.time[..., :1])[..., None, :]
        return PhaseEstimate(trajectory.time, elapsed / duration[:, None], log_weight, duration)


def check_grid(num_durations: int, reach: float) -> None:
    """Refuses a grid of durations that is none.

    Args:
        num_durations: J.
        reach: in standard deviations.

    Raises:
        InputError: fewer than three durations, or a reach not above zero.

    Example:
        >>> check_grid(25, 2.4)
    """
    if num_durations < 3:
        raise InputError(f"Expected at least 3 durations, got {num_durations}. One duration is ElapsedClock.")
    check_positive("reach", reach)


def degrees_of_freedom(demonstrations: DemonstrationSet, student: bool) -> float:
    """Of the density of log T: groups less one, at least one, for Student's t; else infinite.

    Args:
        demonstrations: with a group for each person.
        student: whether the density is Student's t.
    """
    return float(max(1, len(set(demonstrations.groups)) - 1)) if student else math.inf


def duration_grid(
    num_durations: int, reach: float = REACH, freedom: float = math.inf
) -> tuple[Float[Tensor, "durations"], Float[Tensor, "durations"]]:
    """(standard deviations of log T from its mean, log weights under its density, normalised).

    Args:
        num_durations: J.
        reach: of the grid to either side.
        freedom: degrees of freedom of Student's t; infinite for the normal density.

    Example:
        >>> grid, log_weight = duration_grid(3, reach=2.0)
        >>> grid.tolist(), (log_weight[1] - log_weight[0]).item()
        ([-2.0, 0.0, 2.0], 2.0)
    """
    grid = torch.linspace(-reach, reach, num_durations, dtype=torch.float64)
    squares = grid.square()
    density = -0.5 * squares if math.isinf(freedom) else -0.5 * (freedom + 1.0) * (squares / freedom).log1p()
    return grid, torch.log_softmax(density, 0)

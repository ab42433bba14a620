"""A clock that knows of the duration what the environment tells, and leaves the rest open."""

from __future__ import annotations

import dataclasses
import math
from dataclasses import dataclass, field
from typing import Self

import torch

from eaip_prob.data.demonstrations import DemonstrationSet
from eaip_prob.data.environment import EnvironmentFeatures, check_scenes
from eaip_prob.data.trajectory import Trajectory
from eaip_prob.phase.base import AbstractPhaseEstimator, PhaseEstimate, check_durations, require_fitted
from eaip_prob.phase.expected import ExpectedClock
from eaip_prob.phase.marginal import REACH, MarginalClock, check_grid, degrees_of_freedom, duration_grid

_LEAST_DEVIATION = 1e-3


@dataclass(frozen=True, eq=False)
class ExpectedMarginalClock(AbstractPhaseEstimator):
    """J durations around the one that the environment lets one expect, weighted by what is seen of the motion.

    The hypotheses of `MarginalClock` with the mean of `ExpectedClock`; the standard deviation of log T about it is that
    of groups left out. Right where the environment explains the tempo in part, and the rest of it stretches a motion
    as a whole.

    Args:
        num_durations: J, at least 3.
        reach: standard deviations of log T to either side of the expectation that the durations span.
        student: whether log T about the expectation is Student's t (`MarginalClock`); else it is normal.
        expected: says what to expect; fitted by `fit`.
        deviation: standard deviation of log T about the expectation; None until fitted.
        freedom: degrees of freedom, found by `fit`; infinite for the normal density.

    Raises:
        InputError: fewer than three durations, or a reach not above zero.
    """

    num_durations: int = 25
    reach: float = REACH
    student: bool = False
    expected: ExpectedClock = field(default_factory=ExpectedClock)
    deviation: float | None = None
    freedom: float = math.inf

    def __post_init__(self) -> None:
        check_grid(self.num_durations, self.reach)

    def fit(self, demonstrations: DemonstrationSet, agent: str) -> Self:
        """The expectation, and the standard deviation of log T about it."""
        log_duration = check_durations(demonstrations.trajectories(agent)).log()
        expected = self.expected.fit(demonstrations, agent)
        spread = float(log_duration.std()) if len(log_duration) > 1 else 0.0
        deviation = max(_LEAST_DEVIATION, spread * math.sqrt(max(0.0, 1.0 - expected.explained)))
        freedom = degrees_of_freedom(demonstrations, self.student)
        return dataclasses.replace(self, expected=expected, deviation=deviation, freedom=freedom)

    def without_environment(self) -> MarginalClock:
        """The same hypotheses around the mean of log T."""
        return MarginalClock(self.num_durations, self.reach, self.student)

    def encoding(self, trajectory: Trajectory, environment: EnvironmentFeatures | None = None) -> PhaseEstimate:
        """Time over each motion's own duration."""
        return PhaseEstimate.linear(trajectory.time, check_durations(trajectory))

    def estimate(self, trajectory: Trajectory, environment: EnvironmentFeatures | None = None) -> PhaseEstimate:
        """Elapsed time over each duration, weighted by the normal density of its logarithm.

        Raises:
            NotFittedError: before `fit`.
            InputError: other features than those of the demonstrations.
            ShapeError: another number of environments than of motions.
        """
        if environment is not None:
            check_scenes(environment, trajectory.batch_shape)
        deviation = require_fitted(self.deviation, "ExpectedMarginalClock")
        grid, log_weight = duration_grid(self.num_durations, self.reach, self.freedom)
        duration = torch.exp(self.expected.log_duration(environment)[..., None] + deviation * grid)
        elapsed = (trajectory.time - trajectory.time[..., :1])[..., None, :]
        log_weight = log_weight.expand(duration.shape)
        return PhaseEstimate(trajectory.time, elapsed / duration[..., None], log_weight, duration)

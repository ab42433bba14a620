"""Clocks that count real time: one constant duration, or each motion's own."""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass
from typing import ClassVar, Self

import torch
from torch import Tensor

from eaip_prob.checks import check_positive
from eaip_prob.data.demonstrations import DemonstrationSet
from eaip_prob.data.environment import EnvironmentFeatures
from eaip_prob.data.trajectory import Trajectory
from eaip_prob.errors import InputError
from eaip_prob.phase.base import AbstractPhaseEstimator, PhaseEstimate, check_durations, require_fitted


@dataclass(frozen=True, eq=False)
class ElapsedClock(AbstractPhaseEstimator):
    """Time since the first sample over a constant duration exp(mean log T).

    How much faster or slower a person is than expected stays in the covariance of the weights, where it is
    linear-Gaussian like all else. `limit` is the longest demonstration on this clock.

    Args:
        duration: the constant, seconds; None until fitted, or given to keep it.

    Raises:
        InputError: a duration that is not positive and finite.

    Example:
        The geometric mean of 1 s and 4 s is 2 s.

        >>> from eaip_prob.data.demonstrations import Demonstration
        >>> reaches = [Trajectory(time=[0.0, end], values=[[0.0], [1.0]]) for end in (1.0, 4.0)]
        >>> clock = ElapsedClock().fit(DemonstrationSet([Demonstration(human=reach) for reach in reaches]), "human")
        >>> round(clock.duration, 6), round(clock.limit, 6)
        (2.0, 2.0)
    """

    duration: float | None = None

    def __post_init__(self) -> None:
        if self.duration is not None:
            check_positive("duration", self.duration)

    def fit(self, demonstrations: DemonstrationSet, agent: str) -> Self:
        """The geometric mean duration of the demonstrations, unless it was given."""
        durations = check_durations(demonstrations.trajectories(agent))
        duration = float(durations.log().mean().exp()) if self.duration is None else self.duration
        fitted = dataclasses.replace(self, duration=duration)
        object.__setattr__(fitted, "limit", max(1.0, float(durations.max()) / duration))
        return fitted

    def encoding(self, trajectory: Trajectory, environment: EnvironmentFeatures | None = None) -> PhaseEstimate:
        """Elapsed time over the constant; the true duration is not used."""
        return self.estimate(trajectory, environment)

    def estimate(self, trajectory: Trajectory, environment: EnvironmentFeatures | None = None) -> PhaseEstimate:
        """Elapsed time over the constant."""
        duration = require_fitted(self.duration, "ElapsedClock")
        return PhaseEstimate.linear(trajectory.time, torch.tensor(duration, dtype=torch.float64))


@dataclass(frozen=True, eq=False)
class KnownPhase(AbstractPhaseEstimator):
    """Each motion's own duration, which nobody knows online: for studies.

    A prediction is given `phase=known_phase(observed, duration)`.

    Example:
        >>> reach = Trajectory(time=[3.0, 4.0, 5.0], values=[[0.0], [0.5], [1.0]])
        >>> KnownPhase().encoding(reach).paths.tolist()
        [[0.0, 0.5, 1.0]]
    """

    needs_duration: ClassVar[bool] = True

    def fit(self, demonstrations: DemonstrationSet, agent: str) -> Self:
        """Checks that every motion has a duration; nothing is learnt."""
        check_durations(demonstrations.trajectories(agent))
        return self

    def encoding(self, trajectory: Trajectory, environment: EnvironmentFeatures | None = None) -> PhaseEstimate:
        """Time over the motion's own duration."""
        return PhaseEstimate.linear(trajectory.time, check_durations(trajectory))

    def estimate(self, trajectory: Trajectory, environment: EnvironmentFeatures | None = None) -> PhaseEstimate:
        """Refused: the beginning of a motion does not hold its duration."""
        raise InputError(
            "Expected the true durations for the known phase. Call predict(observed, environment, "
            "phase=known_phase(observed, duration)), or use phase=elapsed where the duration is unknown."
        )


def known_phase(trajectory: Trajectory, duration: Tensor | float) -> PhaseEstimate:
    """The phase of motions whose true duration is told.

    Args:
        trajectory: the samples seen, batched.
        duration: (*batch,), seconds.

    Example:
        >>> seen = Trajectory(time=[0.0, 0.5], values=[[0.0], [1.0]])
        >>> known_phase(seen, 2.0).paths.tolist()
        [[0.0, 0.25]]
    """
    return PhaseEstimate.linear(trajectory.time, torch.as_tensor(duration, dtype=torch.float64))

"""The clock that expects the duration from the environment."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Self

import torch
from jaxtyping import Float
from torch import Tensor

from eaip_prob.checks import check_positive, check_type
from eaip_prob.data.demonstrations import DemonstrationSet
from eaip_prob.data.environment import EnvironmentFeatures, check_scenes
from eaip_prob.data.feature_map import AbstractFeatureMap
from eaip_prob.data.features import QuadraticFeatures, RawFeatures
from eaip_prob.data.trajectory import Trajectory
from eaip_prob.errors import InputError
from eaip_prob.phase.base import AbstractPhaseEstimator, PhaseEstimate, check_durations, require_fitted
from eaip_prob.phase.elapsed import ElapsedClock
from eaip_prob.phase.log_duration import HeldOut, LogDurationRegression
from eaip_prob.slope import Slope


@dataclass(frozen=True, eq=False)
class ExpectedClock(AbstractPhaseEstimator):
    """Time since the first sample over exp(E[log T | phi(e)]), the same for demonstrations and online.

    What a person does faster or slower than expected stays in the covariance of the weights. E[log T | phi(e)] is a
    ridge regression, from the features that are observed and to within a factor of two of the demonstrated durations;
    its deviation from mean log T is multiplied by `slope`, that of the true on the predicted deviation of groups left
    out: 0 for an environment that says nothing about the duration, or where no group can be left out.
    Without an environment, or with a wholly unobserved one, the clock is the constant exp(mean log T). `limit` is the
    longest demonstration on this clock, so that with a slope of 0 it is `ElapsedClock` to the digit.

    Args:
        features: phi, or several, of which the one with the least squared error of log T for groups left out is kept:
            the first where no group can be left out. Default raw, and with squares and products.
        ridge: of the regression, relative to each feature's variance.
        mean: mean log T of the demonstrations, T in seconds; None until fitted.
        slope: between 0, which is a constant clock, and 1.
        explained: share of the squared deviation of log T explained for groups left out; 0 where the slope is.
        regression: of log T on the chosen features; None where no environment was demonstrated.

    Raises:
        InputError: no feature map or something else, or a ridge that is not positive.

    Example:
        >>> from eaip_prob.data import Demonstration
        >>> def reach(distance: float, seconds: float) -> Demonstration:
        ...     motion = Trajectory([0.0, seconds], [[0.0], [distance]])
        ...     return Demonstration(motion, environment=EnvironmentFeatures(("distance",), [distance]))
        >>> demonstrations = DemonstrationSet([reach(0.1 * n, 0.5 + 0.1 * n + 0.01 * (n % 3)) for n in range(1, 9)])
        >>> clock = ExpectedClock(RawFeatures()).fit(demonstrations, "human")
        >>> seen = Trajectory([0.0, 0.1], torch.zeros(2, 2, 1))
        >>> scenes = EnvironmentFeatures(("distance",), [[0.2], [0.7]])
        >>> [round(float(duration), 1) for duration in clock.estimate(seen, scenes).duration]
        [0.7, 1.2]
    """

    features: AbstractFeatureMap | Sequence[AbstractFeatureMap] = (RawFeatures(), QuadraticFeatures())
    ridge: float = 1e-3
    mean: float | None = None
    slope: float = 0.0
    explained: float = 0.0
    regression: LogDurationRegression | None = None
    _last: list[tuple[EnvironmentFeatures, Tensor]] = field(default_factory=list, init=False, repr=False)

    def __post_init__(self) -> None:
        maps = self.features if isinstance(self.features, Sequence) else (self.features,)
        if not maps:
            raise InputError("Expected at least one feature map in features, got none. Use RawFeatures().")
        for feature_map in maps:
            check_type("features", feature_map, AbstractFeatureMap, "Use RawFeatures() or QuadraticFeatures().")
        check_positive("ridge", self.ridge)
        object.__setattr__(self, "features", tuple(maps))

    @property
    def chosen(self) -> AbstractFeatureMap | None:
        """The fitted feature map that was kept; None where no environment was demonstrated."""
        return None if self.regression is None else self.regression.feature_map

    def fit(self, demonstrations: DemonstrationSet, agent: str) -> Self:
        """Mean and regression of log T, how far the regression holds for groups left out, and the limit."""
        durations = check_durations(demonstrations.trajectories(agent))
        environment = demonstrations.environments
        seen = None if environment is None else environment.observed.any(-1)
        fitted = dataclasses.replace(
            self, mean=float(durations.log().mean()), slope=0.0, explained=0.0, regression=None
        )
        if environment is not None and seen is not None and bool(seen.any()):
            groups = [group for group, kept in zip(demonstrations.groups, seen.tolist(), strict=True) if kept]
            fitted = fitted._regressed(environment[seen], durations[seen].log(), groups)
        expected = fitted.log_duration(environment).exp()
        limit = max(1.0, float((durations / expected).amax()))
        object.__setattr__(fitted, "limit", limit)
        return fitted

    def _regressed(self, environment: EnvironmentFeatures, log_duration: Tensor, groups: Sequence[int | str]) -> Self:
        assert isinstance(self.features, tuple)
        scored = [(HeldOut.of(each, environment, log_duration, groups, self.ridge), each) for each in self.features]
        held_out, best = min(scored, key=lambda pair: 0.0 if pair[0] is None else pair[0].squared_error)
        slope = Slope(0.0, 0.0, math.inf, 0.0) if held_out is None else held_out.slope()
        regression = LogDurationRegression.fit(best, environment, log_duration, self.ridge)
        return dataclasses.replace(self, slope=slope.value, explained=slope.explained, regression=regression)

    def log_duration(self, environment: EnvironmentFeatures | None) -> Float[Tensor, "*batch"]:
        """E[log T | e], the mean where nothing was observed; T in seconds."""
        # While a person moves the scene is the same at every sample.
        if self._last and self._last[0][0] is environment:
            return self._last[0][1]
        expected = self._expected(environment)
        if environment is not None:
            self._last[:] = [(environment, expected)]
        return expected

    def _expected(self, environment: EnvironmentFeatures | None) -> Float[Tensor, "*batch"]:
        mean = torch.tensor(require_fitted(self.mean, "ExpectedClock"), dtype=torch.float64)
        if environment is None or self.regression is None:
            return mean if environment is None else mean.expand(environment.value.shape[:-1])
        expected = mean + self.slope * (self.regression.expectation(environment) - mean)
        return torch.where(environment.observed.any(-1), expected, mean)

    def without_environment(self) -> ElapsedClock:
        """The constant clock."""
        return ElapsedClock()

    def encoding(self, trajectory: Trajectory, environment: EnvironmentFeatures | None = None) -> PhaseEstimate:
        """Elapsed time over the expected duration; the true one is not used."""
        return self.estimate(trajectory, environment)

    def estimate(self, trajectory: Trajectory, environment: EnvironmentFeatures | None = None) -> PhaseEstimate:
        """Elapsed time over the duration that each motion's environment lets one expect.

        Raises:
            NotFittedError: before `fit`.
            InputError: other features than those of the demonstrations.
            ShapeError: another number of environments than of motions.
        """
        if environment is not None:
            check_scenes(environment, trajectory.batch_shape)
        return PhaseEstimate.linear(trajectory.time, self.log_duration(environment).exp())

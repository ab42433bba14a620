"""How far along is the partner: clocks that encode demonstrations and read motions online.

A clock gives J weighted hypotheses about the whole phase path of a motion. Phase is 0 at the first sample and 1 at the
end that the clock expects; it may pass 1 up to `limit`, behind which a motion is at rest.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass, field
from typing import ClassVar, Self, TypeVar

import torch
from jaxtyping import Float
from torch import Tensor

from eaip_prob.checks import as_float64, check_finite
from eaip_prob.data.demonstrations import DemonstrationSet
from eaip_prob.data.environment import EnvironmentFeatures
from eaip_prob.data.trajectory import Trajectory
from eaip_prob.errors import InputError, NotFittedError

_Fitted = TypeVar("_Fitted")
FAR = 100.0  # times the median duration: a recording that was not stopped


@dataclass(frozen=True, eq=False)
class PhaseEstimate:
    """Weighted hypotheses about the phase at the times seen, and how it goes on.

    Args:
        time: (*#batch, T), seconds, of the samples seen.
        paths: (*#batch, J, T), phase at those times.
        log_weight: (*#batch, J), log prior weight of each hypothesis, normalised.
        duration: (*#batch, J), time in which the phase grows by 1 from now on, seconds.
    """

    time: Float[Tensor, "*#batch time"]
    paths: Float[Tensor, "*#batch hypotheses time"]
    log_weight: Float[Tensor, "*#batch hypotheses"]
    duration: Float[Tensor, "*#batch hypotheses"]

    @classmethod
    def linear(cls, time: Float[Tensor, "*#batch time"], duration: Float[Tensor, "*#batch"]) -> PhaseEstimate:
        """One hypothesis: time since the first sample over a duration.

        Args:
            time: (*batch, T), seconds.
            duration: (*batch,), seconds, above zero.

        Raises:
            InputError: a duration that is not positive and finite.

        Example:
            >>> PhaseEstimate.linear(torch.tensor([3.0, 4.0]), torch.tensor(2.0)).paths.tolist()
            [[0.0, 0.5]]
        """
        time, duration = as_float64("time", time), as_float64("duration", duration)
        check_finite("duration", duration)
        if bool((duration <= 0).any()):
            raise InputError(f"Expected durations above zero seconds, got {float(duration.min())}.")
        paths = ((time - time[..., :1]) / duration[..., None])[..., None, :]
        one = duration[..., None]
        return cls(time, paths, torch.zeros_like(one), one)

    def at(self, time: Float[Tensor, "*#batch times"]) -> Float[Tensor, "*batch hypotheses times"]:
        """Phase of each hypothesis at any times: along its path, then onward at the rate 1 / duration.

        Args:
            time: (*batch, S), seconds on the clock of `self.time`.
        """
        time = as_float64("time", time)
        start, last = self.time[..., :1], self.time[..., -1:]
        later = time > last
        onward = self.paths[..., -1:] + (time - last)[..., None, :] / self.duration[..., None]
        if self.time.shape[-1] == 1 or bool(later.all()):
            return onward
        before = self.paths[..., :1] + (time - start)[..., None, :] / self.duration[..., None]
        inside = self._interpolated(time.clamp(start, last))
        return torch.where(later[..., None, :], onward, torch.where((time < start)[..., None, :], before, inside))

    def _interpolated(self, time: Tensor) -> Tensor:
        batch = torch.broadcast_shapes(self.time.shape[:-1], time.shape[:-1], self.paths.shape[:-2])
        known = self.time.expand(*batch, self.time.shape[-1]).contiguous()
        asked = time.expand(*batch, time.shape[-1]).contiguous()
        right = torch.searchsorted(known, asked).clamp(1, known.shape[-1] - 1)
        t0, t1 = known.gather(-1, right - 1), known.gather(-1, right)
        fraction = ((asked - t0) / (t1 - t0))[..., None, :]
        paths = self.paths.expand(*batch, *self.paths.shape[-2:])
        index = right[..., None, :].expand(*batch, paths.shape[-2], right.shape[-1])
        low, high = paths.gather(-1, index - 1), paths.gather(-1, index)
        return low + fraction * (high - low)


@dataclass(frozen=True, eq=False)
class AbstractPhaseEstimator(ABC):
    """A clock. The same clock gives the phase with which demonstrations are encoded and the phase online.

    A subclass gives `fit`, `encoding` and `estimate`; in return it can be named in a configuration and works with every
    primitive, evidence and joint model. An estimator that needs no environment ignores that argument.
    """

    limit: float = field(default=1.0, init=False)
    needs_duration: ClassVar[bool] = False  # whether a prediction must be told the true duration: studies only

    @abstractmethod
    def fit(self, demonstrations: DemonstrationSet, agent: str) -> Self:
        """A clock fitted to complete motions of the named agent; `self` is unchanged."""

    def without_environment(self) -> AbstractPhaseEstimator:
        """The clock, not fitted, that stands in where nothing of the scene is known; itself where it needs nothing."""
        return self

    @abstractmethod
    def encoding(self, trajectory: Trajectory, environment: EnvironmentFeatures | None = None) -> PhaseEstimate:
        """The phase (J = 1) of complete motions, batched."""

    @abstractmethod
    def estimate(self, trajectory: Trajectory, environment: EnvironmentFeatures | None = None) -> PhaseEstimate:
        """Phase hypotheses for the beginnings of motions, batched; signals and samples may be masked."""


def check_durations(trajectory: Trajectory) -> Float[Tensor, "*batch"]:
    """Durations of complete motions, seconds.

    Raises:
        InputError: a motion with fewer than two seen samples, or more than 100 times as long, or short, as the median.
    """
    duration = trajectory.duration
    if bool((duration <= 0).any()):
        at = tuple(int(i) for i in (duration <= 0).nonzero()[0]) if duration.ndim else ()
        raise InputError(f"Expected motions with at least two seen samples, got a duration of 0 s for motion {at}.")
    median = duration.flatten().quantile(0.5)
    far = (duration > FAR * median) | (duration * FAR < median)
    if bool(far.any()):
        at = tuple(int(i) for i in far.nonzero()[0])
        raise InputError(
            f"Expected motions of comparable durations, got {float(duration[at]):.3g} s for motion {at} at a median of "
            f"{float(median):.3g} s. Cut or leave out that recording, which was probably not stopped or not started."
        )
    return duration


def require_fitted(fitted: _Fitted | None, name: str) -> _Fitted:
    """What `fit` learnt; raises NotFittedError where an estimator was asked before it."""
    if fitted is None:
        raise NotFittedError(
            f"Expected a fitted {name}. Call fit(demonstrations, agent) first and use what it returns."
        )
    return fitted

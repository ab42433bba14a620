"""The paper's clock (Eq. 5): open-end dynamic time warping to one reference motion."""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass
from typing import TYPE_CHECKING, Self

import torch
from jaxtyping import Float
from torch import Tensor

from eaip_prob.data.demonstrations import DemonstrationSet
from eaip_prob.data.environment import EnvironmentFeatures
from eaip_prob.data.resampling import time_normalised
from eaip_prob.data.trajectory import Trajectory
from eaip_prob.errors import InputError, ShapeError
from eaip_prob.phase.base import FAR, AbstractPhaseEstimator, PhaseEstimate, check_durations, require_fitted

if TYPE_CHECKING:
    from eaip_prob.phase.alignment import OpenEnd


@dataclass(frozen=True, eq=False)
class DTWClock(AbstractPhaseEstimator):
    """Phase t* / T of the reference index t* whose prefix is closest to what was seen (Eq. 5).

    Demonstrations are encoded with time over their own duration ("temporally normalised"); online, the samples seen
    are spread evenly from phase 0 to t* / T, and the motion goes on at the rate that this implies. While t* is 0
    the mean duration of the demonstrations stands in.

    Args:
        reference: "mean" of the time-normalised demonstrations, or their "medoid".
        num_samples: samples of the reference.
        path: (num_samples, D), the reference; None until fitted.
        duration: geometric mean duration of the demonstrations, seconds; None until fitted.

    Raises:
        InputError: another word for `reference`, or fewer than two samples.
    """

    reference: str = "mean"
    num_samples: int = 200
    path: Float[Tensor, "time signals"] | None = None
    duration: float | None = None

    def __post_init__(self) -> None:
        if self.reference not in ("mean", "medoid") or self.num_samples < 2:
            raise InputError(
                f"Expected reference 'mean' or 'medoid' and num_samples of at least 2, "
                f"got {self.reference!r} and {self.num_samples}."
            )

    def fit(self, demonstrations: DemonstrationSet, agent: str) -> Self:
        """The reference and the mean duration, from complete motions."""
        motions = demonstrations.trajectories(agent)
        duration = float(check_durations(motions).log().mean().exp())
        normalised = time_normalised(motions, self.num_samples)
        path = self._mean(normalised) if self.reference == "mean" else self._medoid(normalised)
        return dataclasses.replace(self, path=path, duration=duration)

    @staticmethod
    def _mean(motions: Trajectory) -> Tensor:
        count = motions.mask.sum(0)
        if bool((count == 0).any()):
            raise InputError(
                "Expected each phase of each signal to be seen in at least one demonstration for the mean reference. "
                "Use reference='medoid' or drop the signal."
            )
        return motions.values.sum(0) / count

    @staticmethod
    def _medoid(motions: Trajectory) -> Tensor:
        from eaip_prob.phase.alignment import medoid

        complete = motions.mask.flatten(1).all(-1).nonzero()[:, 0]
        if len(complete) == 0:
            raise InputError("Expected at least one demonstration without missing samples for the medoid reference.")
        return motions.values[complete[medoid(motions.values[complete])]]

    def encoding(self, trajectory: Trajectory, environment: EnvironmentFeatures | None = None) -> PhaseEstimate:
        """Time over each motion's own duration."""
        return PhaseEstimate.linear(trajectory.time, check_durations(trajectory))

    def estimate(self, trajectory: Trajectory, environment: EnvironmentFeatures | None = None) -> PhaseEstimate:
        """Open-end alignment of the samples seen; hidden signals do not count.

        Raises:
            ShapeError: other signals than the reference's.
        """
        from eaip_prob.phase.alignment import open_end

        path = require_fitted(self.path, "DTWClock")
        if trajectory.num_signals != path.shape[-1]:
            raise ShapeError(
                f"Expected trajectories with {path.shape[-1]} signals, as fitted, got {trajectory.num_signals}. "
                "Mark signals that are not seen with mask=False instead of leaving them out."
            )
        index, _ = open_end(trajectory.values, path, trajectory.mask)
        return self.from_index(index[..., -1], trajectory)

    def from_index(self, index: Tensor, trajectory: Trajectory) -> PhaseEstimate:
        """The estimate that follows from a reference index (*batch,) for the samples seen so far."""
        mean_duration = require_fitted(self.duration, "DTWClock")
        share = index.to(torch.float64) / (self.num_samples - 1)
        elapsed = trajectory.duration
        known = (share > 0) & (elapsed > 0)
        # Somebody who waits has done next to nothing of the motion: its duration must not grow without bound.
        longest = FAR * mean_duration
        duration = torch.where(known, elapsed / torch.where(known, share, 1.0), mean_duration).clamp_max(longest)
        return PhaseEstimate.linear(trajectory.time, duration)

    def alignment(self) -> OpenEnd:
        """The same alignment one sample at a time; see `alignment.OpenEnd`."""
        from eaip_prob.phase.alignment import OpenEnd

        return OpenEnd.start(require_fitted(self.path, "DTWClock"))

"""Evidence on positions: samples equal the primitive's positions up to noise."""

from __future__ import annotations

from dataclasses import dataclass

import torch
from jaxtyping import Float
from torch import Tensor

from eaip_prob.checks import check_finite
from eaip_prob.data.trajectory import Trajectory
from eaip_prob.evidence.base import AbstractEvidence
from eaip_prob.linalg import collapsed
from eaip_prob.observation import AbstractObservation, LinearObservation, SharedDesignObservation
from eaip_prob.primitives.base import AbstractPrimitive, Boundary


@dataclass(frozen=True)
class PositionEvidence(AbstractEvidence):
    """y(t) = design(phase(t)) @ w + offset + noise, of variance sigma^2 plus the sensor's, where it is known.

    Example:
        >>> from eaip_prob.primitives.promp import ProMP
        >>> seen = Trajectory(time=[0.0, 0.1], values=[[0.0], [0.3]], noise=torch.full((2, 1, 1), 9.0))
        >>> one = torch.ones(1, dtype=torch.float64)
        >>> rows = PositionEvidence().observe(ProMP(), "human", seen, seen.time[None], one, noise=4.0 * one).dense()
        >>> rows.value.tolist(), rows.noise.tolist()
        ([[0.0, 0.3]], [[25.0, 25.0]])
    """

    def scale(
        self, primitive: AbstractPrimitive, trajectory: Trajectory, phase: Float[Tensor, "*#batch time"]
    ) -> Float[Tensor, "signals"]:
        """Standard deviation of the seen samples over motions and time."""
        return masked_deviation(trajectory.values.mT, trajectory.mask.mT)

    def observe(
        self,
        primitive: AbstractPrimitive,
        block: str,
        trajectory: Trajectory,
        phase: Float[Tensor, "*#batch hypotheses time"],
        duration: Float[Tensor, "*#batch hypotheses"],
        noise: Float[Tensor, "*#batch signals"],
        boundary: Boundary | None = None,
    ) -> AbstractObservation | None:
        """See `AbstractEvidence.observe`."""
        design, offset = primitive.design(phase, duration, _per_hypothesis(boundary))
        if boundary is not None:
            check_finite("boundary", offset)
        if trajectory.noise is None:
            value, mask = trajectory.values.mT.unsqueeze(-3), collapsed(trajectory.mask.mT.unsqueeze(-3), 2)
            variance = noise.square().unsqueeze(-1).unsqueeze(-3)
            return SharedDesignObservation.of_motion(block, design, offset, value, variance, mask)
        return self._with_sensor(block, design, offset, trajectory, noise)

    @staticmethod
    def _with_sensor(
        block: str, design: Tensor, offset: Tensor, trajectory: Trajectory, noise: Tensor
    ) -> AbstractObservation:
        """Sensor noise may correlate the signals of one sample, so rows are written out unless it does not."""
        assert trajectory.noise is not None
        sensor = collapsed(trajectory.noise, 3)
        diagonal = sensor.diagonal(dim1=-2, dim2=-1)
        value, mask = trajectory.values.mT[..., None, :, :], collapsed(trajectory.mask.mT[..., None, :, :], 2)
        if bool((sensor == torch.diag_embed(diagonal)).all()):
            variance = noise.square()[..., None, :, None] + diagonal.mT[..., None, :, :]
            return SharedDesignObservation(block, design, offset, value, variance, mask)
        rows = SharedDesignObservation(block, design, offset, value, noise.square()[..., None, :, None], mask).dense()
        eye = torch.eye(trajectory.num_samples, dtype=torch.float64)
        across = torch.einsum("...tde,tu->...dteu", sensor, eye).flatten(-2).flatten(-3, -2)[..., None, :, :]
        return LinearObservation(
            rows.matrices, rows.offset, rows.value, torch.diag_embed(rows.noise) + across, rows.mask, correlated=True
        )


def masked_deviation(values: Float[Tensor, "*batch signals time"], mask: Tensor) -> Float[Tensor, "signals"]:
    """Standard deviation of each signal over all seen samples of all motions."""
    flat = values.movedim(-2, 0).flatten(1)
    seen = mask.movedim(-2, 0).flatten(1)
    count = seen.sum(-1).clamp_min(1)
    mean = torch.where(seen, flat, 0.0).sum(-1) / count
    deviation = torch.where(seen, flat - mean[:, None], 0.0)
    return (deviation.square().sum(-1) / count).sqrt()


def _per_hypothesis(boundary: Boundary | None) -> Boundary | None:
    """The same start for each phase hypothesis."""
    if boundary is None:
        return None
    return Boundary(boundary.start[..., None, :], boundary.velocity[..., None, :])

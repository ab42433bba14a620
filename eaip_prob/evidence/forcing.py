"""The paper's evidence (Eq. 11-13): forces of the observed motion, linear in the DMP's [w, g].

White noise on forces is the paper's model. Forces hold second differences of positions, so that noise of a sensor
comes out hundreds of times larger and correlated from sample to sample; `propagated` carries it through the
differentiation: R = s^2 G G^T + sigma^2 I, with G the matrix from positions to forces.
"""

from __future__ import annotations

from dataclasses import dataclass

import torch
from jaxtyping import Float
from torch import Tensor

from eaip_prob.data.trajectory import Trajectory
from eaip_prob.errors import InputError
from eaip_prob.evidence.base import AbstractEvidence
from eaip_prob.evidence.position import masked_deviation
from eaip_prob.linalg import collapsed
from eaip_prob.observation import AbstractObservation, SharedDesignObservation
from eaip_prob.primitives.base import AbstractPrimitive, Boundary
from eaip_prob.primitives.dmp import DMP


@dataclass(frozen=True)
class ForcingEvidence(AbstractEvidence):
    """f*(t) = y'' + alpha_y (beta_y y + y') = [phi(x)^T, alpha_y beta_y] [w; g] + noise, derivatives by phase.

    Args:
        noise: "white" (the paper), or "propagated".
        position_noise: s of `propagated`, standard deviation of the positions, one number in the signals' units; a
            trajectory that carries its own sensor noise uses the variances of that instead.

    Raises:
        InputError: another word for `noise`, or `propagated` without a positive position noise.

    Example:
        A hand that rests at 2 is held there by the spring's force alone, alpha_y beta_y 2.

        >>> dmp, resting = DMP(), Trajectory(time=[0.0, 0.1, 0.2], values=[[2.0], [2.0], [2.0]])
        >>> one = torch.ones(1, dtype=torch.float64)
        >>> forces = ForcingEvidence().observe(dmp, "human", resting, resting.time[None], one, noise=one)
        >>> bool(torch.isclose(forces.value, dmp.alpha_y * dmp.beta_y * resting.values.mT).all())
        True
    """

    noise: str = "white"
    position_noise: float = 0.0

    def __post_init__(self) -> None:
        if self.noise not in ("white", "propagated") or self.position_noise < 0:
            raise InputError(
                f"Expected noise 'white' or 'propagated' and position_noise of at least 0, "
                f"got {self.noise!r} and {self.position_noise}."
            )

    def scale(
        self, primitive: AbstractPrimitive, trajectory: Trajectory, phase: Float[Tensor, "*#batch time"]
    ) -> Float[Tensor, "signals"]:
        """Standard deviation of the forces over motions and time, one number for all signals: Eq. 11 has one sigma."""
        force, mask = _dmp(primitive).forces(trajectory.values, trajectory.mask, phase)
        deviation = masked_deviation(force.mT, mask.mT)
        return deviation.square().mean().sqrt().expand_as(deviation)

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
        """See `AbstractEvidence.observe`; fewer than three samples hold no force."""
        if trajectory.num_samples < 3:
            return None
        dmp = _dmp(primitive)
        force, mask = dmp.forces(trajectory.values[..., None, :, :], trajectory.mask[..., None, :, :], phase)
        force, mask = force.mT, collapsed(mask.mT, 2)
        variance = noise.square()[..., None, :, None]
        design, offset = dmp.forcing_design(phase), phase.new_zeros(1, 1)
        if self.noise == "white":
            return SharedDesignObservation(block, design, offset, force, variance, mask)
        white = variance[..., None] * torch.eye(phase.shape[-1], dtype=torch.float64)
        covariance = self._propagated(dmp, trajectory, phase) + white
        return SharedDesignObservation(block, design, offset, force, covariance, mask, correlated=True)

    def _propagated(
        self, dmp: DMP, trajectory: Trajectory, phase: Tensor
    ) -> Float[Tensor, "*batch hypotheses signals time time"]:
        operator = dmp.force_operator(phase)[..., None, :, :]
        if trajectory.noise is None:
            if self.position_noise == 0:
                raise InputError(
                    "Expected the noise of positions for propagated forces: give position_noise above zero or "
                    "trajectories with their sensor's noise."
                )
            return self.position_noise**2 * operator @ operator.mT
        variance = trajectory.noise.diagonal(dim1=-2, dim2=-1).mT[..., None, :, :]
        return (operator * variance[..., None, :]) @ operator.mT


def _dmp(primitive: AbstractPrimitive) -> DMP:
    if not isinstance(primitive, DMP):
        raise InputError(f"Expected a DMP for forcing evidence, got {type(primitive).__name__}. Use evidence=position.")
    return primitive

"""How the beginning of a motion becomes an observation of the agent's weights."""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass

from jaxtyping import Float
from torch import Tensor

from eaip_prob.data.trajectory import Trajectory
from eaip_prob.observation import AbstractObservation
from eaip_prob.primitives.base import AbstractPrimitive, Boundary


@dataclass(frozen=True)
class AbstractEvidence(ABC):
    """Reads samples through a primitive and a clock.

    A subclass gives `scale` and `observe`; in return its noise can be chosen on held-out demonstrations.
    """

    @abstractmethod
    def scale(
        self, primitive: AbstractPrimitive, trajectory: Trajectory, phase: Float[Tensor, "*#batch time"]
    ) -> Float[Tensor, "signals"]:
        """Standard deviation of the observed quantity of each signal over demonstrations, in its own units.

        Noise is chosen as a multiple of it, so that the choice does not depend on units.
        """

    @abstractmethod
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
        """The observation (*batch, J), one per phase hypothesis; None where the samples say nothing.

        Args:
            primitive: fitted with this agent's demonstrations.
            block: the agent.
            trajectory: samples seen, batched.
            phase: their phase under each hypothesis.
            duration: time in which the phase grows by 1, seconds.
            noise: standard deviation of each signal, in the observed quantity's units.
            boundary: start of the motion, where the primitive needs it.
        """

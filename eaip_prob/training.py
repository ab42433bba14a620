"""What a predictor learns from demonstrations: one clock, primitives on it, and a joint model of the weights."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from jaxtyping import Float
from torch import Tensor

from eaip_prob.data.demonstrations import DemonstrationSet
from eaip_prob.data.resampling import time_normalised
from eaip_prob.data.trajectory import Trajectory
from eaip_prob.encoding import encode
from eaip_prob.models import AbstractJointModel
from eaip_prob.phase import AbstractPhaseEstimator, PhaseEstimate
from eaip_prob.primitives import AbstractPrimitive, Boundary

HUMAN, ROBOT, ENVIRONMENT = "human", "robot", "environment"


@dataclass(frozen=True, eq=False)
class Fitted:
    """A fitted predictor's knowledge.

    Args:
        phase: fitted clock.
        primitives: {agent: primitive spanning the clock's limit}.
        model: fitted joint model.
        names: {agent: signals} and {"environment": features}.
        noise: standard deviation of the observed quantity, per human signal, in its units.
        environment_noise: sigma_e per feature, in its units.
        residual: variance of what the target's primitive cannot represent, units squared.
        boundary: mean start of the target.
        step: median sampling step of the target, seconds.
        inflation: factor on predictive variances.
    """

    phase: AbstractPhaseEstimator
    primitives: Mapping[str, AbstractPrimitive]
    model: AbstractJointModel
    names: Mapping[str, tuple[str, ...]]
    noise: Float[Tensor, "signals"]
    environment_noise: Float[Tensor, "features"]
    residual: Float[Tensor, "target_signals"]
    boundary: Boundary
    step: float
    inflation: float = 1.0


@dataclass(frozen=True, eq=False)
class Training:
    """Demonstrations on one clock, as held-out choices need them.

    Args:
        demonstrations: complete motions.
        motions: {agent: (N, T, D)} as encoded.
        phase: the demonstrations' clock.
        weights: {block: (N, K)}.
        observed: {block: (N, K)}, False where a feature was not observed; None where there are no features.
        grams: {agent: (K, K)}, mean square of a motion as a function of its weights.
        fitted: everything but the noise, which is still zero where it is to be chosen.
    """

    demonstrations: DemonstrationSet
    motions: Mapping[str, Trajectory]
    phase: PhaseEstimate
    weights: Mapping[str, Float[Tensor, "demonstrations weights"]]
    observed: Mapping[str, Tensor] | None
    grams: Mapping[str, Float[Tensor, "weights weights"]]
    fitted: Fitted

    def fitted_model(
        self, model: AbstractJointModel, target: str, kept: Sequence[bool] | None = None
    ) -> AbstractJointModel:
        """A joint model fitted to these weights, or to the demonstrations `kept` of them."""
        index = [number for number in range(len(self.demonstrations)) if kept is None or kept[number]]
        observed = self.observed
        return model.fit(
            {block: rows[index] for block, rows in self.weights.items()},
            None if observed is None else {block: rows[index] for block, rows in observed.items()},
            [self.demonstrations.groups[number] for number in index],
            target,
            self.grams,
        )


def train(
    demonstrations: DemonstrationSet,
    clock: AbstractPhaseEstimator,
    primitives: Mapping[str, AbstractPrimitive],
    model: AbstractJointModel,
    target: str,
    noise: tuple[Float[Tensor, "signals"], Float[Tensor, "features"]],
    num_samples: int | None,
) -> Training:
    """Fits clock, weights and joint model, in that order.

    Args:
        demonstrations: of the human and the target at least.
        clock: not yet fitted.
        primitives: {agent: primitive}, of any limit.
        model: not yet fitted.
        target: agent that will be predicted.
        noise: (per human signal, per feature), zeros where they are to be chosen.
        num_samples: resample the motions to this many first; None keeps them as recorded.
    """
    motions = {agent: demonstrations.trajectories(agent) for agent in demonstrations.agents}
    if num_samples is not None:
        motions = {agent: time_normalised(motion, num_samples) for agent, motion in motions.items()}
    scene = demonstrations.environments
    clock = clock.fit(demonstrations, HUMAN)
    phase = clock.encoding(motions[HUMAN], scene)
    spanning = {agent: primitives[agent].spanning(clock.limit) for agent in motions}
    encoded = {agent: encode(spanning[agent], motions[agent], phase, clock.limit) for agent in motions}
    weights = {agent: part.weights for agent, part in encoded.items()}
    names = {agent: motion.names for agent, motion in motions.items()} | {ENVIRONMENT: scene.names if scene else ()}
    observed = None
    if scene is not None:
        weights[ENVIRONMENT] = scene.value
        observed = {ENVIRONMENT: scene.observed}
    grams = {
        agent: spanning[agent].gram(motions[agent].num_signals, phase.duration.median())
        for agent in motions
        if not spanning[agent].weights_are_positions
    }
    starts = encoded[target].boundary
    fitted = Fitted(
        clock,
        spanning,
        model.fit(weights, observed, demonstrations.groups, target, grams),
        names,
        *noise,
        residual=encoded[target].residual,
        boundary=Boundary(starts.start.mean(0), starts.velocity.mean(0)),
        step=float(motions[target].time.diff(dim=-1).median()),
    )
    return Training(demonstrations, motions, phase, weights, observed, grams, fitted)

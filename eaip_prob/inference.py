"""What one fitted joint says about a motion, from the samples seen of it and the scene.

Data goes one way: the scene and the samples become observations, observations a posterior, the posterior a prediction.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import torch
from jaxtyping import Float
from torch import Tensor

from eaip_prob.checks import check_finite
from eaip_prob.data.environment import EnvironmentFeatures
from eaip_prob.data.trajectory import Trajectory
from eaip_prob.errors import InputError
from eaip_prob.forecast import Prediction, checked_times
from eaip_prob.linalg import safe_cholesky, whitened
from eaip_prob.models import Posterior
from eaip_prob.observation import AbstractObservation, LinearObservation
from eaip_prob.phase import PhaseEstimate
from eaip_prob.primitives import Boundary, initial_boundary
from eaip_prob.training import ENVIRONMENT, HUMAN, Fitted
from eaip_prob.trust import tempered

# An end that a step meets up to round-off takes no further step.
_FULL = 0.999  # trust from which on what it would leave out is not worth a second posterior
_SNAP_STEPS = 1e-6
Ask = Callable[[Sequence[AbstractObservation], bool, Tensor], Posterior]


@dataclass(frozen=True, eq=False)
class SceneEvidence:
    """What an environment tells one fitted joint.

    Args:
        environment: features, in the order of the demonstrations; None where there are none.
        observations: of the environment's block, none where nothing was observed.
        growth: (*batch,), factor on variances: more the further the scene lies from those demonstrated.
    """

    environment: EnvironmentFeatures | None
    observations: Sequence[AbstractObservation]
    growth: Float[Tensor, "*batch"]

    @classmethod
    def of(cls, fitted: Fitted, environment: EnvironmentFeatures | None) -> SceneEvidence:
        """Observes the mapped features, believed as far as the gate says.

        Raises:
            InputError: other features than fitted.
        """
        if environment is None:
            return cls(None, (), torch.ones((), dtype=torch.float64))
        if fitted.features is None:
            raise InputError("Expected no environment: the demonstrations had none. Call predict(observed).")
        ordered = environment.ordered_as(fitted.names[ENVIRONMENT])
        if not bool(ordered.observed.any()):
            return cls(None, (), torch.ones((), dtype=torch.float64))
        mapped = fitted.features(ordered)
        # sigma_e says how much an observation is believed; what is observed follows from the sensor alone.
        blurred = replace(ordered, covariance=ordered.covariance + torch.diag(fitted.environment_noise.square()))
        noise = fitted.features(blurred).covariance
        observation = _gated(fitted, mapped.value, noise, mapped.observed)
        return cls(ordered, (observation,), _growth(fitted, mapped.value, noise, mapped.observed))


def _gated(fitted: Fitted, value: Tensor, noise: Tensor, observed: Tensor) -> LinearObservation:
    """The features with their cross-covariances scaled by the gate g, as an observation: any joint model takes it.

    Observing g (e - mean) + mean with further noise (1 - g^2) cov(e) is to observe a block with cov(w, e) times g.
    """
    eye = torch.eye(value.shape[-1], dtype=torch.float64)
    gate = fitted.gate.value
    offset = torch.zeros_like(value)
    if gate < 1.0:
        prior = fitted.model.prior
        offset = (1.0 - gate) * prior.block_mean(ENVIRONMENT).expand(value.shape)
        noise = noise + (1.0 - gate**2) * prior.block_covariance(ENVIRONMENT)
    parts = (offset[..., None, :], value[..., None, :], noise[..., None, :, :], observed[..., None, :])
    return LinearObservation({ENVIRONMENT: gate * eye}, *parts, correlated=True)


def _growth(fitted: Fitted, value: Tensor, noise: Tensor, observed: Tensor) -> Float[Tensor, "*batch"]:
    """1 + d^2 / n: the variance that a regression on n scenes has at Mahalanobis distance d from their mean."""
    prior, scenes = fitted.model.prior, fitted.scenes
    assert scenes is not None
    both = observed[..., :, None] & observed[..., None, :]
    covariance = torch.where(both, prior.block_covariance(ENVIRONMENT) + noise, 0.0)
    covariance = covariance + torch.diag_embed((~observed).to(torch.float64))
    deviation = torch.where(observed, value - prior.block_mean(ENVIRONMENT), 0.0)
    distance = whitened(safe_cholesky(covariance, "covariance of the features"), deviation).square().sum(-1)
    return 1.0 + distance / max(1, scenes.num_scenes)


def predicted(
    fitted: Fitted,
    trajectory: Trajectory,
    environment: EnvironmentFeatures | None,
    time: Float[Tensor, "*#batch times"] | None = None,
    phase: PhaseEstimate | None = None,
    also: Sequence[AbstractObservation] = (),
) -> Prediction:
    """See `InteractionPredictor.predict`; this joint answers whatever was observed."""
    scene = SceneEvidence.of(fitted, environment)

    def ask(human: Sequence[AbstractObservation], known: bool, log_weight: Tensor) -> Posterior:
        seen = [*also, *human, *(scene.observations if known else ())]
        return fitted.model.posterior(seen, log_weight, (fitted.target,))

    return answered(fitted, trajectory, scene, ask, time, phase)


def answered(
    fitted: Fitted,
    trajectory: Trajectory,
    scene: SceneEvidence,
    ask: Ask,
    time: Float[Tensor, "*#batch times"] | None = None,
    phase: PhaseEstimate | None = None,
) -> Prediction:
    """The prediction from samples and whoever gives the posterior.

    Args:
        fitted: what was learnt.
        trajectory: samples seen, batched.
        scene: what the environment tells.
        ask: (observations of the human, whether the scene is known, log weights of the hypotheses) to the posterior
            of the target.
        time: times to predict at, seconds; default evenly to the expected end.
        phase: hypotheses that replace the clock's.
    """
    if phase is None:
        phase = fitted.phase.estimate(trajectory, scene.environment)
    posterior = _believed(fitted, trajectory, phase, bool(scene.observations), ask)
    return Prediction(
        time=_times(fitted, trajectory, phase) if time is None else checked_times(time),
        posterior=posterior,
        phase=phase,
        primitive=fitted.primitives[fitted.target],
        block=fitted.target,
        names=fitted.names[fitted.target],
        residual=fitted.residual,
        inflation=fitted.inflation * scene.growth,
        boundary=_boundary(fitted, trajectory, fitted.target),
    )


def _believed(fitted: Fitted, trajectory: Trajectory, phase: PhaseEstimate, known: bool, ask: Ask) -> Posterior:
    """The posterior, the motion and beside it the scene believed as far as either told on groups left out."""
    human, prior = _human(fitted, trajectory, phase), phase.log_weight
    posterior = ask(human, known, prior)
    if not human:
        return posterior
    in_motion, in_scene = not fitted.trust.is_full, known and not fitted.scene_trust.is_full
    if in_motion or in_scene:
        share = seen_share(trajectory, phase)
        if in_motion and bool(((believed := fitted.trust.at(share)) < _FULL).any()):
            posterior = tempered(ask((), known, prior), posterior, believed)
        if in_scene and bool(((believed := fitted.scene_trust.at(share)) < _FULL).any()):
            posterior = tempered(ask(human, False, prior), posterior, believed)
    return posterior


def seen_share(trajectory: Trajectory, phase: PhaseEstimate) -> Float[Tensor, "*batch"]:
    """Time from the first sample to the last one seen, as a share of the expected duration."""
    return trajectory.duration / (phase.log_weight.exp() * phase.duration).sum(-1)


def _human(fitted: Fitted, trajectory: Trajectory, phase: PhaseEstimate) -> list[AbstractObservation]:
    if not bool(trajectory.mask.any()):
        return []
    boundary = _boundary(fitted, trajectory, HUMAN)
    primitive = fitted.primitives[HUMAN]
    seen = fitted.evidence.observe(primitive, HUMAN, trajectory, phase.paths, phase.duration, fitted.noise, boundary)
    return [] if seen is None else [seen]


def _boundary(fitted: Fitted, trajectory: Trajectory, agent: str) -> Boundary | None:
    """Start of the agent's motion: what was seen of it, else the demonstrations' mean."""
    if not fitted.primitives[agent].needs_boundary:
        return None
    mean = fitted.boundary
    if agent != HUMAN:
        return mean
    seen, ever = initial_boundary(trajectory), trajectory.mask.any(-2)
    if fitted.target != HUMAN:
        return seen
    return Boundary(torch.where(ever, seen.start, mean.start), torch.where(ever, seen.velocity, mean.velocity))


def _times(fitted: Fitted, trajectory: Trajectory, phase: PhaseEstimate) -> Tensor:
    """Evenly from the first sample to the expected end, at the demonstrations' step."""
    remaining = (1.0 - phase.paths[..., -1]).clamp_min(0.0) * phase.duration
    span = (trajectory.time[..., -1:] - trajectory.time[..., :1] + remaining).amax()
    check_finite("the expected duration", span)
    num_steps = int(torch.ceil(span / fitted.step - _SNAP_STEPS))
    return trajectory.time[..., :1] + fitted.step * torch.arange(num_steps + 1, dtype=torch.float64)

"""What a predictor learns from demonstrations: one clock, primitives on it, and a joint model of the weights."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from functools import partial

import torch
from jaxtyping import Float
from torch import Tensor

from eaip_prob.data.demonstrations import DemonstrationSet
from eaip_prob.data.environment import EnvironmentFeatures
from eaip_prob.data.features import AbstractFeatureMap
from eaip_prob.data.resampling import time_normalised
from eaip_prob.data.trajectory import Trajectory
from eaip_prob.encoding import encode
from eaip_prob.evidence import AbstractEvidence
from eaip_prob.models import AbstractJointModel
from eaip_prob.models.learnt import check_learnt, named
from eaip_prob.phase import AbstractPhaseEstimator
from eaip_prob.primitives import AbstractPrimitive, Boundary
from eaip_prob.slope import Slope
from eaip_prob.trust import Trust

HUMAN, ROBOT, ENVIRONMENT = "human", "robot", "environment"


@dataclass(frozen=True, eq=False)
class SceneRange:
    """Which environments were demonstrated.

    Args:
        low: (E,), smallest value of each feature, in its units.
        high: (E,), largest value.
        num_scenes: different environments among them.
    """

    low: Float[Tensor, "features"]
    high: Float[Tensor, "features"]
    num_scenes: int

    @classmethod
    def of(cls, scene: EnvironmentFeatures) -> SceneRange:
        """The range of observed features of demonstrations (N, E)."""
        low = torch.where(scene.observed, scene.value, torch.inf).amin(0)
        high = torch.where(scene.observed, scene.value, -torch.inf).amax(0)
        return cls(low, high, len(torch.unique(scene.value, dim=0)))


@dataclass(frozen=True, eq=False)
class Fitted:
    """A fitted predictor's knowledge.

    Args:
        target: agent that is predicted.
        evidence: how samples speak about weights.
        phase: fitted clock.
        primitives: {agent: primitive spanning the clock's limit}.
        model: fitted joint model.
        names: {agent: signals} and {"environment": features}.
        noise: standard deviation of the observed quantity, per human signal, in its units.
        environment_noise: sigma_e per feature, in its units.
        residual: variance of what the target's primitive cannot represent, units squared.
        boundary: mean start of the target.
        step: median sampling step of the target, seconds.
        longest: duration of the longest demonstration, seconds.
        features: fitted feature map of the environment; None without one.
        scenes: environments that were demonstrated; None without one.
        inflation: factor on predictive variances.
        gate: how far the environment is believed before anything of the motion was seen.
        scene_trust: how far it is believed beside the part of the motion that was seen.
        trust: how far the human's motion is believed.
        num_folds: folds on which choices were made; 0 where nothing could be held out.
        alone: knowledge from motions alone, which answers where nothing of the scene was observed; None where this
            one does.
    """

    target: str
    evidence: AbstractEvidence
    phase: AbstractPhaseEstimator
    primitives: Mapping[str, AbstractPrimitive]
    model: AbstractJointModel
    names: Mapping[str, tuple[str, ...]]
    noise: Float[Tensor, "signals"]
    environment_noise: Float[Tensor, "features"]
    residual: Float[Tensor, "target_signals"]
    boundary: Boundary
    step: float
    longest: float
    features: AbstractFeatureMap | None = None
    scenes: SceneRange | None = None
    inflation: float = 1.0
    gate: Slope = Slope()
    scene_trust: Trust = Trust()
    trust: Trust = Trust()
    num_folds: int = 0
    alone: Fitted | None = None


@dataclass(frozen=True, eq=False)
class Recipe:
    """How demonstrations become a fitted joint, but for what is chosen later.

    Args:
        target: agent that will be predicted.
        evidence: how samples speak about weights.
        clock: not yet fitted.
        primitives: {agent: primitive}, of any limit.
        num_samples: resample the motions to this many first; None keeps them as recorded.
    """

    target: str
    evidence: AbstractEvidence
    clock: AbstractPhaseEstimator
    primitives: Mapping[str, AbstractPrimitive]
    num_samples: int | None


@dataclass(frozen=True, eq=False)
class Training:
    """Demonstrations on one clock, as joint models are fitted to them.

    Args:
        demonstrations: complete motions.
        motions: {agent: (N, T, D)} as encoded.
        paths: (N, T), phase of the human's samples, or (T,) shared.
        weights: {block: (N, K)}.
        observed: {block: (N, K)}, False where a feature was not observed; None where there are no features.
        grams: {agent: (K, K)}, mean square of a motion as a function of its weights.
        make: gives `Fitted` once the joint model and what is chosen on held-out groups are there.
        target: agent that will be predicted.
        limit: last phase of the clock.
    """

    demonstrations: DemonstrationSet
    motions: Mapping[str, Trajectory]
    paths: Float[Tensor, "*demonstrations time"]
    weights: Mapping[str, Float[Tensor, "demonstrations weights"]]
    observed: Mapping[str, Tensor] | None
    grams: Mapping[str, Float[Tensor, "weights weights"]]
    make: Callable[..., Fitted]
    target: str
    limit: float

    def with_features(self, features: AbstractFeatureMap) -> Training:
        """With the environment as a block, through a feature map that is not yet fitted; unchanged without one."""
        scene = self.demonstrations.environments
        if scene is None:
            return self
        features = features.fit(scene)
        mapped = features(scene)
        make = partial(self.make, features=features, scenes=SceneRange.of(scene))
        weights = {**self.weights, ENVIRONMENT: mapped.value}
        return replace(self, weights=weights, observed={ENVIRONMENT: mapped.observed}, make=make)

    def fitted(
        self, model: AbstractJointModel, noise: Float[Tensor, "signals"], environment_noise: Float[Tensor, "features"]
    ) -> Fitted:
        """With a joint model, not yet fitted, and noise in the quantities' units.

        Raises:
            InputError: what `fit` returned is no joint model of these blocks.
            NotPositiveDefiniteError: what it learnt is no Gaussian.
        """
        with named(f"{type(model).__name__}.fit"):
            model = model.fit(self.weights, self.observed, self.demonstrations.groups, self.target, self.grams)
        check_learnt(model, {block: rows.shape[-1] for block, rows in self.weights.items()}, self.target)
        return self.make(model=model, noise=noise, environment_noise=environment_noise)


def train(demonstrations: DemonstrationSet, recipe: Recipe) -> Training:
    """Fits the clock and encodes the motions on it; the environment is still to be mapped."""
    motions = {agent: demonstrations.trajectories(agent) for agent in demonstrations.agents}
    if recipe.num_samples is not None:
        motions = {agent: time_normalised(motion, recipe.num_samples) for agent, motion in motions.items()}
    scene = demonstrations.environments
    clock = recipe.clock.fit(demonstrations, HUMAN)
    phase = clock.encoding(motions[HUMAN], scene)
    spanning = {agent: recipe.primitives[agent].spanning(clock.limit) for agent in motions}
    encoded = {agent: encode(spanning[agent], motions[agent], phase, clock.limit) for agent in motions}
    weights = {agent: part.weights for agent, part in encoded.items()}
    grams = {
        agent: spanning[agent].gram(motions[agent].num_signals, phase.duration.median())
        for agent in motions
        if not spanning[agent].weights_are_positions
    }
    target = encoded[recipe.target]
    make = partial(
        Fitted,
        target=recipe.target,
        evidence=recipe.evidence,
        phase=clock,
        primitives=spanning,
        names={agent: motion.names for agent, motion in motions.items()} | {ENVIRONMENT: scene.names if scene else ()},
        residual=target.residual,
        boundary=Boundary(target.boundary.start.mean(0), target.boundary.velocity.mean(0)),
        step=float(motions[recipe.target].time.diff(dim=-1).median()),
        longest=float(motions[HUMAN].duration.amax()),
    )
    paths = phase.at(motions[HUMAN].time)[..., 0, :]
    return Training(demonstrations, motions, paths, weights, None, grams, make, recipe.target, clock.limit)

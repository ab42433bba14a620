"""From the beginning of a motion and the scene to a whole motion with its uncertainty.

`InteractionPredictor` joins a clock, primitives, evidence and a joint model; `Prediction` is what it says. Both are
immutable: `fit` returns a fitted predictor.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import Self

import torch
from jaxtyping import Float
from torch import Tensor

from eaip_prob.checks import as_float64, check_finite, check_type
from eaip_prob.data.demonstrations import DemonstrationSet
from eaip_prob.data.environment import EnvironmentFeatures, check_scenes
from eaip_prob.data.trajectory import Trajectory, stack
from eaip_prob.errors import InputError, NotFittedError
from eaip_prob.evidence import AbstractEvidence, PositionEvidence
from eaip_prob.forecast import Prediction, checked_times
from eaip_prob.linalg import collapsed
from eaip_prob.models import AbstractJointModel, GaussianJointModel
from eaip_prob.observation import AbstractObservation, LinearObservation
from eaip_prob.phase import AbstractPhaseEstimator, ElapsedClock, MarginalClock, PhaseEstimate
from eaip_prob.primitives import DMP, AbstractPrimitive, Boundary, ProMP, initial_boundary
from eaip_prob.training import ENVIRONMENT, HUMAN, ROBOT, Fitted, train

# An end that a step meets up to round-off takes no further step.
_SNAP_STEPS = 1e-6


def _clocks() -> tuple[AbstractPhaseEstimator, ...]:
    return ElapsedClock(), MarginalClock()


@dataclass(frozen=True, eq=False)
class InteractionPredictor:
    """Learns a joint Gaussian over the motions of two agents and the scene; predicts one from the beginning of another.

    Args:
        human: primitive of the agent that is watched.
        robot: primitive of the agent that is predicted (not used with `target="human"`).
        phase: clock, for the demonstrations and online; of several, the one with the highest held-out density of the
            target's future is kept (the first where nothing can be held out). Default: `ElapsedClock`, `MarginalClock`.
        evidence: how samples speak about weights.
        model: joint model.
        target: "robot", or "human" to predict the rest of the watched motion itself.
        noise: standard deviation of the observed quantity per signal, in its units (one number for all, or one
            each); None chooses a multiple of the signals' standard deviation on held-out groups.
        environment_noise: sigma_e per feature, in its units; None chooses it in the same way.
        criterion: what held-out choices maximise: "prediction" (density of the target's future), or "evidence" (density
            of what was observed, as the paper's likelihood).
        num_samples: resample demonstrations to this many before encoding; None keeps them as recorded.
        recalibrate: multiply predictive variances by the mean squared standardised error on held-out groups.
        fitted: what `fit` learnt.

    Example:
        >>> from eaip_prob.tasks.passing_over import PassingOver
        >>> task = PassingOver()
        >>> predictor = InteractionPredictor(target="human").fit(task.demonstrations(2, seed=0))
        >>> test = task.demonstrations(1, seed=1)[0]
        >>> prediction = predictor.predict(test.human.first(50), test.environment)
        >>> prediction.mean.shape[-1], prediction.covariance.shape[-2:]
        (2, torch.Size([2, 2]))
    """

    human: AbstractPrimitive = field(default_factory=ProMP)
    robot: AbstractPrimitive = field(default_factory=DMP)
    phase: AbstractPhaseEstimator | Sequence[AbstractPhaseEstimator] = field(default_factory=_clocks)
    evidence: AbstractEvidence = field(default_factory=PositionEvidence)
    model: AbstractJointModel = field(default_factory=GaussianJointModel)
    target: str = ROBOT
    noise: float | Sequence[float] | None = None
    environment_noise: float | Sequence[float] | None = None
    criterion: str = "prediction"
    num_samples: int | None = None
    recalibrate: bool = True
    fitted: Fitted | None = None

    def __post_init__(self) -> None:
        self._check_parts()
        if self.target not in (HUMAN, ROBOT) or self.criterion not in ("prediction", "evidence"):
            raise InputError(
                f"Expected target 'human' or 'robot' and criterion 'prediction' or 'evidence', "
                f"got {self.target!r} and {self.criterion!r}."
            )

    def _check_parts(self) -> None:
        parts = {"human": AbstractPrimitive, "robot": AbstractPrimitive}
        parts |= {"evidence": AbstractEvidence, "model": AbstractJointModel}
        for name, kind in parts.items():
            check_type(name, getattr(self, name), kind, f"Pass an object of a class derived from it as {name}.")
        if not self._clocks:
            raise InputError("Expected at least one clock in phase, got none. Leave phase out for the default clocks.")
        for clock in self._clocks:
            check_type("phase", clock, AbstractPhaseEstimator, "Pass one clock, or several in a list.")

    @property
    def _clocks(self) -> list[AbstractPhaseEstimator]:
        return [self.phase] if isinstance(self.phase, AbstractPhaseEstimator) else list(self.phase or ())

    def fit(self, demonstrations: DemonstrationSet) -> Self:
        """A predictor fitted to complete motions; `self` is unchanged.

        Raises:
            InputError: fewer than two demonstrations, or an agent that is missing.
        """
        from eaip_prob.selection import selected

        self._check_agents(demonstrations)
        scene = demonstrations.environments
        noise = (
            self._given(self.noise, len(demonstrations.signals(HUMAN)), "noise"),
            self._given(self.environment_noise, len(scene.names) if scene else 0, "environment_noise"),
        )
        primitives = {HUMAN: self.human, ROBOT: self.robot}
        models = self.model.candidates()
        model = models[len(models) // 2]
        candidates = [
            train(demonstrations, clock, primitives, model, self.target, noise, self.num_samples)
            for clock in self._clocks
        ]
        return replace(self, fitted=selected(self, candidates))

    def _check_agents(self, demonstrations: DemonstrationSet) -> None:
        advice = "Make one with DemonstrationSet(demonstrations)."
        check_type("demonstrations", demonstrations, DemonstrationSet, advice)
        if HUMAN not in demonstrations.agents or self.target not in demonstrations.agents:
            raise InputError(
                f"Expected demonstrations of the human and of the target {self.target!r}, got {demonstrations.agents}. "
                "A single agent is the human; predict it with target='human'."
            )
        if len(demonstrations) < 2:
            raise InputError("Expected at least two demonstrations to learn a covariance, got one. Record more.")

    @staticmethod
    def _given(noise: float | Sequence[float] | Tensor | None, count: int, name: str) -> Tensor:
        """A given noise per signal; zeros stand in until a missing one is chosen."""
        if noise is None:
            return torch.zeros(count, dtype=torch.float64)
        values = as_float64(name, noise)
        usable = bool(((values >= 0) & values.isfinite()).all())
        if values.shape not in ((), (1,), (count,)) or not usable:
            raise InputError(
                f"Expected {name} as one standard deviation or {count} of them, finite and at least 0, got {noise}."
            )
        return values.expand(count).clone()

    def with_noise(self, noise: float | Tensor | None = None, environment_noise: float | Tensor | None = None) -> Self:
        """The fitted predictor with another sigma or sigma_e, nothing fitted anew.

        Args:
            noise: standard deviation per signal, in the observed quantity's units; None keeps it.
            environment_noise: per feature, in its units; None keeps it.
        """
        fitted = self._require_fitted()
        if noise is not None:
            fitted = replace(fitted, noise=self._given(noise, len(fitted.noise), "noise"))
        if environment_noise is not None:
            value = self._given(environment_noise, len(fitted.environment_noise), "environment_noise")
            fitted = replace(fitted, environment_noise=value)
        return replace(self, fitted=fitted)

    def predict(
        self,
        observed: Trajectory | Sequence[Trajectory],
        environment: EnvironmentFeatures | None = None,
        time: Float[Tensor, "*#batch times"] | None = None,
        phase: PhaseEstimate | None = None,
        also: Sequence[AbstractObservation] = (),
    ) -> Prediction:
        """The whole motion of the target, from its start to the end that the clock expects.

        Args:
            observed: beginning of the human's motion, or many of them (batched, or a sequence that is stacked);
                signals and samples that were not seen are masked.
            environment: features of the scene; None or `observed=False` where nothing was detected.
            time: (*batch, S), times to predict at, seconds on the clock of `observed`; default evenly from the first
                sample to the expected end. After the clock's limit the goal is held.
            phase: phase hypotheses that replace the clock's, for studies.
            also: further evidence about the blocks, with batch axes (*batch, J).

        Raises:
            NotFittedError: before `fit`.
            InputError: other signals or features than fitted.
            ShapeError: another number of environments than of motions.
        """
        fitted = self._require_fitted()
        trajectory = observed if isinstance(observed, Trajectory) else stack(observed)
        if trajectory.names != fitted.names[HUMAN]:
            raise InputError(f"Expected human signals {fitted.names[HUMAN]}, as fitted, got {trajectory.names}.")
        if phase is None:
            phase = fitted.phase.estimate(trajectory, environment)
        observations = [*also]
        if environment is not None:
            check_scenes(environment, trajectory.batch_shape)
        if bool(trajectory.mask.any()):
            boundary = self._boundary(trajectory, HUMAN)
            seen = self.evidence.observe(
                fitted.primitives[HUMAN], HUMAN, trajectory, phase.paths, phase.duration, fitted.noise, boundary
            )
            observations += [] if seen is None else [seen]
        if environment is not None:
            observations += self._scene(environment)
        posterior = fitted.model.posterior(observations, phase.log_weight, keep=(self.target,))
        return Prediction(
            time=self._times(trajectory, phase) if time is None else checked_times(time),
            posterior=posterior,
            phase=phase,
            primitive=fitted.primitives[self.target],
            block=self.target,
            names=fitted.names[self.target],
            residual=fitted.residual,
            inflation=fitted.inflation,
            boundary=self._boundary(trajectory, self.target),
        )

    def _scene(self, environment: EnvironmentFeatures) -> list[AbstractObservation]:
        fitted = self._require_fitted()
        if not fitted.names[ENVIRONMENT]:
            raise InputError("Expected no environment: the demonstrations had none. Call predict(observed).")
        features = environment.ordered_as(fitted.names[ENVIRONMENT])
        if not bool(features.observed.any()):
            return []
        eye = torch.eye(len(features.names), dtype=torch.float64)
        noise = collapsed(features.covariance, 2) + torch.diag(fitted.environment_noise.square())
        value, observed = features.value[..., None, :], collapsed(features.observed, 1)[..., None, :]
        zero = torch.zeros_like(value[..., :1, :])
        return [LinearObservation({ENVIRONMENT: eye}, zero, value, noise[..., None, :, :], observed, True)]

    def _boundary(self, trajectory: Trajectory, agent: str) -> Boundary | None:
        """Start of the agent's motion: what was seen of it, else the demonstrations' mean."""
        fitted = self._require_fitted()
        if not fitted.primitives[agent].needs_boundary:
            return None
        mean = fitted.boundary
        if agent != HUMAN:
            return mean
        seen, ever = initial_boundary(trajectory), trajectory.mask.any(-2)
        if self.target != HUMAN:
            return seen
        return Boundary(torch.where(ever, seen.start, mean.start), torch.where(ever, seen.velocity, mean.velocity))

    def _times(self, trajectory: Trajectory, phase: PhaseEstimate) -> Tensor:
        """Evenly from the first sample to the expected end, at the demonstrations' step."""
        step = self._require_fitted().step
        remaining = (1.0 - phase.paths[..., -1]).clamp_min(0.0) * phase.duration
        span = (trajectory.time[..., -1:] - trajectory.time[..., :1] + remaining).amax()
        check_finite("the expected duration", span)
        num_steps = int(torch.ceil(span / step - _SNAP_STEPS))
        return trajectory.time[..., :1] + step * torch.arange(num_steps + 1, dtype=torch.float64)

    def _require_fitted(self) -> Fitted:
        if self.fitted is None:
            raise NotFittedError("Expected a fitted predictor. Use the predictor that fit(demonstrations) returns.")
        return self.fitted

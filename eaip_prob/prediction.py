"""From the beginning of a motion and the scene to a whole motion with its uncertainty.

`InteractionPredictor` joins a clock, primitives, evidence and a joint model; `Prediction` is what it says. Both are
immutable: `fit` returns a fitted predictor.
"""

from __future__ import annotations

import warnings
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import Literal, Self, TypeVar

import torch
from jaxtyping import Float
from torch import Tensor

from eaip_prob.checks import as_float64, check_type
from eaip_prob.data.demonstrations import DemonstrationSet
from eaip_prob.data.environment import EnvironmentFeatures, check_scenes
from eaip_prob.data.features import AbstractFeatureMap, QuadraticFeatures, RawFeatures
from eaip_prob.data.trajectory import Trajectory, stack
from eaip_prob.errors import ExtrapolationWarning, InputError, NotFittedError
from eaip_prob.evidence import AbstractEvidence, PositionEvidence
from eaip_prob.forecast import Prediction
from eaip_prob.inference import predicted
from eaip_prob.models import AbstractJointModel, GaussianJointModel
from eaip_prob.observation import AbstractObservation
from eaip_prob.phase import AbstractPhaseEstimator, ElapsedClock, ExpectedClock, ExpectedMarginalClock, PhaseEstimate
from eaip_prob.primitives import DMP, AbstractPrimitive, ProMP
from eaip_prob.streaming import Stream, begun, stepped
from eaip_prob.training import ENVIRONMENT, HUMAN, ROBOT, Fitted

_Part = TypeVar("_Part")
_LONG = 2.0  # times the longest demonstration


def _clocks() -> tuple[AbstractPhaseEstimator, ...]:
    return ElapsedClock(), ExpectedClock(), ExpectedMarginalClock()


def _maps() -> tuple[AbstractFeatureMap, ...]:
    return RawFeatures(), QuadraticFeatures()


@dataclass(frozen=True, eq=False)
class InteractionPredictor:
    """Learns a joint Gaussian over the motions of two agents and the scene; predicts one from the beginning of another.

    Two joints are fitted where the demonstrations have an environment: one with it, and one of the motions alone, which
    answers when nothing of the scene was observed, or when on held-out groups the scene told nothing.

    Args:
        human: primitive of the agent that is watched.
        robot: primitive of the agent that is predicted (not used with `target="human"`).
        phase: clock, for the demonstrations and online; of several, the first whose held-out density of the target's
            future is within one standard error of the best is kept (the first where nothing can be held out).
            Default: `ElapsedClock`, `ExpectedClock`, `ExpectedMarginalClock`; without an environment what stands in
            for them.
        evidence: how samples speak about weights.
        model: joint model.
        features: map of the environment's features; one of several is chosen with the clock. Default: `RawFeatures`,
            `QuadraticFeatures`.
        target: "robot", or "human" to predict the rest of the watched motion itself.
        noise: standard deviation of the observed quantity per signal, in its units (one number for all, or one
            each); None chooses a multiple of the signals' standard deviation on held-out groups.
        environment_noise: sigma_e per feature, in its units; None chooses it in the same way.
        criterion: what held-out choices maximise: "prediction" (density of the target's future), or "evidence" (density
            of what was observed, as the paper's likelihood).
        num_samples: resample demonstrations to this many before encoding; None keeps them as recorded.
        recalibrate: multiply predictive variances so that 90 % intervals hold 90 % of the samples of held-out groups;
            with "groups", of a new group (a person nobody has met) with probability 0.9, which takes wider ones.
        gate: believe the environment, alone and beside the motion seen, as far as it told on held-out groups.
        trust: believe the human's motion as far as it told on held-out groups.
        separate: fit a joint of the motions alone beside the one with the environment.
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
    features: AbstractFeatureMap | Sequence[AbstractFeatureMap] = field(default_factory=_maps)
    target: str = ROBOT
    noise: float | Sequence[float] | None = None
    environment_noise: float | Sequence[float] | None = None
    criterion: str = "prediction"
    num_samples: int | None = None
    recalibrate: bool | Literal["groups"] = True
    gate: bool = True
    trust: bool = True
    separate: bool = True
    fitted: Fitted | None = None

    def __post_init__(self) -> None:
        self._check_parts()
        if self.target not in (HUMAN, ROBOT) or self.criterion not in ("prediction", "evidence"):
            raise InputError(
                f"Expected target 'human' or 'robot' and criterion 'prediction' or 'evidence', "
                f"got {self.target!r} and {self.criterion!r}."
            )
        if self.recalibrate not in (True, False, "groups"):
            raise InputError(f"Expected recalibrate as True, False or 'groups', got {self.recalibrate!r}.")

    def _check_parts(self) -> None:
        parts = {"human": AbstractPrimitive, "robot": AbstractPrimitive}
        parts |= {"evidence": AbstractEvidence, "model": AbstractJointModel}
        for name, kind in parts.items():
            check_type(name, getattr(self, name), kind, f"Pass an object of a class derived from it as {name}.")
        several = {"phase": (self.clocks, AbstractPhaseEstimator), "features": (self.maps, AbstractFeatureMap)}
        for name, (members, kind) in several.items():
            if not members:
                raise InputError(f"Expected at least one {kind.__name__} in {name}, got none. Leave it out.")
            for member in members:
                check_type(name, member, kind, "Pass one, or several in a list.")

    @property
    def clocks(self) -> list[AbstractPhaseEstimator]:
        """Clocks to choose from."""
        return _listed(self.phase, AbstractPhaseEstimator)

    @property
    def maps(self) -> list[AbstractFeatureMap]:
        """Feature maps to choose from."""
        return _listed(self.features, AbstractFeatureMap)

    def fit(self, demonstrations: DemonstrationSet, alone: Fitted | None = None) -> Self:
        """A predictor fitted to complete motions; `self` is unchanged.

        Args:
            demonstrations: two or more.
            alone: knowledge from the same motions without their scenes (`Fitted.alone` of another predictor), which is
                then not fitted again.

        Raises:
            InputError: fewer than two demonstrations, or an agent that is missing.
        """
        from eaip_prob.selection import selected, warn_where_nothing_is_held_out

        self._check_agents(demonstrations)
        warn_where_nothing_is_held_out(demonstrations)
        if demonstrations.environments is None:
            return replace(self, fitted=selected(self, demonstrations))
        together = selected(self, demonstrations)
        if not self.separate:
            return replace(self, fitted=together)
        alone = alone or selected(self, demonstrations.without_environment())
        return replace(self, fitted=replace(together, alone=alone))

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

    def with_noise(self, noise: float | Tensor | None = None, environment_noise: float | Tensor | None = None) -> Self:
        """The fitted predictor with another sigma or sigma_e, nothing fitted anew.

        Args:
            noise: standard deviation per signal, in the observed quantity's units; None keeps it.
            environment_noise: per feature, in its units; None keeps it.
        """
        fitted = self.require_fitted()
        alone = fitted.alone
        if noise is not None:
            value = given_noise(noise, len(fitted.noise), "noise")
            fitted = replace(fitted, noise=value, alone=None if alone is None else replace(alone, noise=value))
        if environment_noise is not None:
            value = given_noise(environment_noise, len(fitted.environment_noise), "environment_noise")
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
            InputError: other signals or features than fitted, or a batch in which the scene was observed for some
                motions only.
            ShapeError: another number of environments than of motions.
        """
        trajectory = self._checked(observed if isinstance(observed, Trajectory) else stack(observed))
        if environment is not None:
            check_scenes(environment, trajectory.batch_shape)
        fitted, environment = self.serving(environment)
        _warn_of_long_waits(fitted, trajectory)
        return predicted(fitted, trajectory, environment, time, phase, also)

    def init(self, environment: EnvironmentFeatures | None = None) -> Stream:
        """The state of a prediction that runs while the person moves: nothing seen yet.

        Args:
            environment: features of the scene (single); None or `observed=False` where nothing was detected so far.

        Example:
            >>> from eaip_prob.tasks.passing_over import PassingOver
            >>> task = PassingOver()
            >>> predictor = InteractionPredictor(target="human").fit(task.demonstrations(2, seed=0))
            >>> test = task.demonstrations(1, seed=1)[0]
            >>> state = predictor.init(test.environment)
            >>> for place in range(50):
            ...     prediction, state = predictor.step(test.human.first(place + 1).last(1), state)
            >>> whole = predictor.predict(test.human.first(50), test.environment)
            >>> bool((prediction.mean - whole.mean).abs().max() < 1e-6)
            True
        """
        fitted, environment = self.serving(environment)
        return begun(fitted, environment)

    def step(
        self,
        sample: Trajectory,
        state: Stream,
        environment: EnvironmentFeatures | None = None,
        time: Float[Tensor, "times"] | None = None,
    ) -> tuple[Prediction, Stream]:
        """The prediction after one more frame (or several), and the state to pass to the next step.

        It equals `predict` of everything seen so far. Frames may arrive late and in any order; of signals that one
        moment has twice, the later arrival counts.

        Args:
            sample: what arrived (single); signals that were not seen are masked.
            state: from `init` or the step before; unchanged.
            environment: features of the scene, where they arrived or changed; None keeps what was known.
            time: (S,), times to predict at, seconds; default evenly to the expected end.
        """
        sample = self._checked(sample)
        check_type("state", state, Stream, "Pass the state that init or the step before returned.")
        known = self.require_fitted()
        if state.fitted is not known and state.fitted is not known.alone:
            raise InputError("Expected a state of this predictor, got another's. Begin with init(environment).")
        if environment is not None:
            state = begun(*self.serving(environment)).after(state.observed)
        prediction, state = stepped(state, sample, time)
        assert state.observed is not None
        _warn_of_long_waits(state.fitted, state.observed)
        return prediction, state

    def serving(self, environment: EnvironmentFeatures | None) -> tuple[Fitted, EnvironmentFeatures | None]:
        """(the joint that answers, what it is told of the scene)."""
        fitted = self.require_fitted()
        if environment is None:
            return fitted.alone or fitted, None
        check_type("environment", environment, EnvironmentFeatures, "Make one with EnvironmentFeatures(names, value).")
        if not fitted.names[ENVIRONMENT]:
            raise InputError("Expected no environment: the demonstrations had none. Call predict(observed).")
        environment = environment.ordered_as(fitted.names[ENVIRONMENT])
        seen = environment.observed.any(-1)
        if fitted.alone is not None and (not bool(seen.any()) or fitted.gate.value == 0.0):
            return fitted.alone, None
        if fitted.alone is not None and not bool(seen.all()):
            raise InputError(
                f"Expected the scene observed for all motions of a batch or for none, got {int(seen.sum())} of "
                f"{seen.numel()}. Predict those with an observed scene and the others in two calls."
            )
        _warn_of_far_scenes(fitted, environment)
        return fitted, environment

    def summary(self) -> str:
        """What fitting found, in words: the clock, what the environment and the motion tell, calibration."""
        from eaip_prob.summary import described

        return described(self.require_fitted())

    def _checked(self, trajectory: Trajectory) -> Trajectory:
        names = self.require_fitted().names[HUMAN]
        check_type("observed", trajectory, Trajectory, "Make one with Trajectory(time, values, names).")
        if trajectory.names != names:
            raise InputError(f"Expected human signals {names}, as fitted, got {trajectory.names}.")
        return trajectory

    def require_fitted(self) -> Fitted:
        """What `fit` learnt.

        Raises:
            NotFittedError: before `fit`.
        """
        if self.fitted is None:
            raise NotFittedError("Expected a fitted predictor. Use the predictor that fit(demonstrations) returns.")
        return self.fitted


def given_noise(noise: float | Sequence[float] | Tensor, count: int, name: str) -> Float[Tensor, "signals"]:
    """A given noise per signal.

    Raises:
        InputError: neither one number nor one for each signal, or not finite and at least 0.
    """
    values = as_float64(name, noise)
    usable = bool(((values >= 0) & values.isfinite()).all())
    if values.shape not in ((), (1,), (count,)) or not usable:
        raise InputError(
            f"Expected {name} as one standard deviation or {count} of them, finite and at least 0, got {noise}."
        )
    return values.expand(count).clone()


def _listed(part: _Part | Sequence[_Part], kind: type[_Part]) -> list[_Part]:
    return [part] if isinstance(part, kind) else list(part or ())  # pyright: ignore[reportArgumentType]


def _warn_of_far_scenes(fitted: Fitted, environment: EnvironmentFeatures) -> None:
    """Says which features lie further from the demonstrated range than half its width."""
    assert fitted.scenes is not None
    low, high = fitted.scenes.low, fitted.scenes.high
    room = 0.5 * (high - low) + 1e-9 * torch.maximum(low.abs(), high.abs())
    far = environment.observed & ((environment.value > high + room) | (environment.value < low - room))
    if not bool(far.any()):
        return
    column = int(far.reshape(-1, far.shape[-1]).any(0).nonzero()[0])
    value = float(environment.value[far[..., column]][..., column].reshape(-1)[0])
    warnings.warn(
        f"{environment.names[column]} = {value:g} lies far outside the demonstrations, {float(low[column]):g} to "
        f"{float(high[column]):g}: the prediction extrapolates, its variance grows with the distance.",
        ExtrapolationWarning,
        stacklevel=4,
    )


def _warn_of_long_waits(fitted: Fitted, trajectory: Trajectory) -> None:
    """Says when somebody has been watched for much longer than any motion lasted."""
    watched = float((trajectory.time[..., -1] - trajectory.time[..., 0]).amax())
    if watched > _LONG * fitted.longest:
        warnings.warn(
            f"The person has been watched for {watched:.3g} s, the longest demonstration took {fitted.longest:.3g} s: "
            "behind the end that the clock allows, samples count as rest at the goal, which the prediction holds. "
            "Begin anew, with init(environment), when the person starts to move.",
            ExtrapolationWarning,
            stacklevel=3,
        )

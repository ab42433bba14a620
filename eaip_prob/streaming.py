"""A prediction that runs while the person moves, one frame at a time.

The scene is taken once and kept as a posterior; each frame then costs one update, whatever came before. State is
passed in and returned, so that several people can be followed, or a moment gone back to.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

from jaxtyping import Float
from torch import Tensor

from eaip_prob.data.environment import EnvironmentFeatures
from eaip_prob.data.merging import merged
from eaip_prob.data.trajectory import Trajectory
from eaip_prob.errors import InputError
from eaip_prob.forecast import Prediction
from eaip_prob.inference import SceneEvidence, answered
from eaip_prob.models import Posterior
from eaip_prob.observation import AbstractObservation
from eaip_prob.training import HUMAN, Fitted


@dataclass(frozen=True, eq=False)
class Stream:
    """What has been seen so far.

    Args:
        fitted: the joint that answers.
        scene: what the environment tells it.
        belief: about all motions once the scene is known.
        blind: the same without the scene; None where it is not asked for.
        observed: samples so far; None before the first.
    """

    fitted: Fitted
    scene: SceneEvidence
    belief: Posterior
    blind: Posterior | None
    observed: Trajectory | None = None

    def after(self, observed: Trajectory | None) -> Stream:
        """The same scene after other samples."""
        return replace(self, observed=observed)


def begun(fitted: Fitted, environment: EnvironmentFeatures | None) -> Stream:
    """The state before the first sample.

    Raises:
        InputError: a batch of environments.
    """
    if environment is not None and environment.value.ndim > 1:
        raise InputError(
            f"Expected one environment for a motion that is followed, got a batch {tuple(environment.value.shape)}. "
            "Follow several people with one state each, or predict a batch with predict()."
        )
    scene = SceneEvidence.of(fitted, environment)
    blocks = tuple(dict.fromkeys((HUMAN, fitted.target)))
    needs_both = bool(scene.observations) and not fitted.scene_trust.is_full
    blind = fitted.model.posterior((), keep=blocks) if needs_both else None
    return Stream(fitted, scene, fitted.model.posterior(scene.observations, keep=blocks), blind)


def stepped(state: Stream, sample: Trajectory, time: Float[Tensor, "times"] | None = None) -> tuple[Prediction, Stream]:
    """(prediction, state) after more samples of the human, which may be earlier than those seen.

    Raises:
        InputError: a batch of motions, or samples that do not belong to those seen (`merged`).
    """
    if sample.batch_shape:
        raise InputError(
            f"Expected samples of a single motion, got a batch {tuple(sample.batch_shape)}. "
            "Follow several people with one state each, or predict a batch with predict()."
        )
    observed = sample if state.observed is None else merged(state.observed, sample)

    def ask(human: Sequence[AbstractObservation], known: bool, log_weight: Tensor) -> Posterior:
        belief = state.belief if known or state.blind is None else state.blind
        return belief.condition(human, log_weight, (state.fitted.target,))

    prediction = answered(state.fitted, observed, state.scene, ask, time)
    return prediction, state.after(observed)

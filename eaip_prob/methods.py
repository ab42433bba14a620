"""The methods that every table compares, behind one call.

`mean`, `environment`, `ip` and `eaip` are one fitted predictor with blocks unobserved; `eaip_kernel` weights the
demonstrations by their environment; `eaip_shuffled` is fitted to environments shuffled over the demonstrations, which
shows what a useless environment costs; `paper_ip` and `paper_eaip` are the method as published; `eaip_known_phase` is
told the true duration, a study outside every comparison. Further joint models have a row each, beside `eaip`.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace

import torch
from jaxtyping import Float
from torch import Tensor

from eaip_prob.data.demonstrations import Demonstration, DemonstrationSet
from eaip_prob.data.environment import EnvironmentFeatures
from eaip_prob.data.trajectory import Trajectory
from eaip_prob.errors import InputError
from eaip_prob.evaluation import future_mask, gaussian_mixture_nll, mixture_pit, squared_error
from eaip_prob.evaluation.scoring import scored_mean
from eaip_prob.forecast import Prediction
from eaip_prob.models import AbstractJointModel, KernelJointModel
from eaip_prob.phase import KnownPhase, known_phase
from eaip_prob.prediction import InteractionPredictor

MEAN, ENVIRONMENT, IP, EAIP = "mean", "environment", "ip", "eaip"
KERNEL, SHUFFLED, KNOWN = "eaip_kernel", "eaip_shuffled", "eaip_known_phase"
PAPER_IP, PAPER_EAIP = "paper_ip", "paper_eaip"
METHODS = (MEAN, ENVIRONMENT, IP, EAIP, KERNEL, SHUFFLED, PAPER_IP, PAPER_EAIP, KNOWN)
BLIND = (MEAN, IP, PAPER_IP)  # are told nothing of the environment
PUBLISHED = (PAPER_IP, PAPER_EAIP)


def asked(
    predictor: InteractionPredictor,
    method: str,
    observed: Trajectory,
    environment: EnvironmentFeatures | None,
    time: Float[Tensor, "*#batch times"] | None = None,
) -> Prediction:
    """The prediction of a method that is one predictor with something withheld from it.

    Args:
        predictor: fitted; the published method's for `PUBLISHED`.
        method: its name. Those of `BLIND` are not told the environment, `mean` and `environment` not the motion.
        observed: beginning of a motion, or of a batch.
        environment: features of the scene.
        time: times to predict at, s; default as of `InteractionPredictor.predict`.
    """
    scene = None if method in BLIND else environment
    if method in (MEAN, ENVIRONMENT):
        observed = observed.hide(observed.names)
    return predictor.predict(observed, scene, time)


@dataclass(frozen=True, eq=False)
class FittedMethods:
    """All methods fitted to one set of demonstrations.

    Args:
        ours: the package's predictor.
        kernel: the same with demonstrations weighted by their environment.
        shuffled: the same, environments shuffled.
        paper: the published method.
        known: ours with every demonstration on its own duration.
        further: ours with other joint models.
    """

    ours: InteractionPredictor
    kernel: InteractionPredictor
    shuffled: InteractionPredictor
    paper: InteractionPredictor
    known: InteractionPredictor
    further: Mapping[str, InteractionPredictor] = field(default_factory=dict)

    @property
    def names(self) -> tuple[str, ...]:
        """`METHODS`, then the further models."""
        return (*METHODS, *self.further)

    @classmethod
    def fit(
        cls,
        predictor: InteractionPredictor,
        paper: InteractionPredictor,
        demonstrations: DemonstrationSet,
        generator: torch.Generator,
        models: Mapping[str, AbstractJointModel] | None = None,
    ) -> FittedMethods:
        """Fits the five predictors, and one for each further model; `generator` shuffles the environments.

        Raises:
            InputError: a further model named as one of `METHODS`.
        """
        models = models or {}
        if taken := sorted(set(models) & set(METHODS)):
            raise InputError(f"Expected names of further models beside {METHODS}, got {taken}. Choose other names.")
        ours = predictor.fit(demonstrations)
        known = ours.require_fitted()
        alone = known.alone
        # The kernel's clock and features are those of the plain model: choosing them anew would cost most of its time.
        clock = next(clock for clock in predictor.clocks if type(clock) is type(known.phase))
        features = next(features for features in predictor.maps if type(features) is type(known.features))
        kernel = replace(predictor, model=KernelJointModel(), phase=clock, features=features)
        return cls(
            ours,
            kernel.fit(demonstrations, alone),
            predictor.fit(shuffled_environments(demonstrations, generator), alone),
            paper.fit(demonstrations),
            replace(predictor, phase=KnownPhase(), separate=False).fit(demonstrations),
            {
                name: replace(predictor, model=model, phase=clock, features=features).fit(demonstrations)
                for name, model in models.items()
            },
        )

    def predict(
        self,
        method: str,
        observed: Trajectory,
        environment: EnvironmentFeatures,
        time: Float[Tensor, "*#batch times"],
        duration: Float[Tensor, "*#batch"],
    ) -> Prediction:
        """The prediction of one method.

        Args:
            method: one of `names`.
            observed: beginnings of motions, batched.
            environment: features of the scene, batched.
            time: times to predict at, seconds.
            duration: true durations, seconds; only `eaip_known_phase` reads them.
        """
        if method == KNOWN:
            return self.known.predict(observed, environment, time, phase=known_phase(observed, duration))
        others = {KERNEL: self.kernel, SHUFFLED: self.shuffled, PAPER_IP: self.paper, PAPER_EAIP: self.paper}
        predictor = {**others, **self.further}.get(method, self.ours)
        return asked(predictor, method, observed, environment, time)


def shuffled_environments(demonstrations: DemonstrationSet, generator: torch.Generator) -> DemonstrationSet:
    """The same motions with the environments permuted over all demonstrations."""
    order = torch.randperm(len(demonstrations), generator=generator).tolist()
    return DemonstrationSet(
        [
            Demonstration(motion.human, motion.robot, demonstrations[other].environment)
            for motion, other in zip(demonstrations, order, strict=True)
        ],
        demonstrations.groups,
    )


@dataclass(frozen=True, eq=False)
class MotionScores:
    """Scores of predictions on the future of the motions that really followed, one per motion.

    Args:
        squared_error: (N,), mean over samples and signals, units squared.
        nll: (N,), mean per sample and signal, nats.
        coverage90: (N,), share of samples inside the central 90 % interval.
    """

    squared_error: Float[Tensor, "motions"]
    nll: Float[Tensor, "motions"]
    coverage90: Float[Tensor, "motions"]

    @property
    def motion_rmse(self) -> Float[Tensor, "motions"]:
        """Root mean squared error of each motion, in the signals' units."""
        return self.squared_error.sqrt()

    def summary(self) -> Mapping[str, float]:
        """Scores over all motions: rmse pooled, the others averaged."""
        return {
            "rmse": float(self.squared_error.mean().sqrt()),
            "nll": float(self.nll.mean()),
            "coverage90": float(self.coverage90.mean()),
        }


def score(prediction: Prediction, truth: Trajectory, seen_until: Float[Tensor, "*#batch"]) -> MotionScores:
    """Scores on the samples of the truth after the last one seen.

    Args:
        prediction: read at the truth's times, batched as the truth.
        truth: (N, T, D), what really followed.
        seen_until: (N,), time of the last sample seen, seconds.
    """
    mask = future_mask(truth, seen_until)
    means = prediction.component_means.expand(*truth.batch_shape, -1, -1, -1)
    variances = prediction.component_variances.expand(means.shape)
    log_weight = prediction.posterior.log_weight.expand(means.shape[:-2])
    # Inside the central 90 % interval, without solving for its bounds.
    level = mixture_pit(means, variances, log_weight, truth.values)
    mean = prediction.mean.expand(truth.values.shape)
    return MotionScores(
        squared_error(mean, truth.values, mask),
        gaussian_mixture_nll(means, variances, log_weight, truth.values, mask),
        scored_mean(((level >= 0.05) & (level <= 0.95)).double(), mask),
    )

"""Motions of groups left out, and how well a predictor that never saw them does."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator
from dataclasses import dataclass

import torch
from jaxtyping import Float
from torch import Tensor

from eaip_prob.data.environment import EnvironmentFeatures
from eaip_prob.data.trajectory import Trajectory
from eaip_prob.evaluation.scores import gaussian_mixture_nll
from eaip_prob.evaluation.scoring import future_mask
from eaip_prob.forecast import Prediction
from eaip_prob.models import AbstractJointModel
from eaip_prob.phase import known_phase
from eaip_prob.prediction import InteractionPredictor
from eaip_prob.training import HUMAN, Training

SHARES_SEEN = (0.05, 0.2, 0.5)
_MOTIONS_PER_FOLD = 16
_SCORED_SAMPLES = 25
_UNCERTAIN = 1e-6


@dataclass(frozen=True, eq=False)
class HeldOut:
    """A fold: a predictor that never saw its motions, and those motions."""

    predictor: InteractionPredictor
    human: Trajectory
    target: Trajectory
    environment: EnvironmentFeatures | None

    @property
    def can_be_scored(self) -> bool:
        """Whether any sample of the target lies ahead of the shortest beginning."""
        until = self.human.time[..., 0] + SHARES_SEEN[0] * self.human.duration.median()
        return bool(future_mask(self.target, until).any())

    def score(self, noise: Tensor, scene_noise: Tensor, scene_only: bool = False) -> Tensor:
        """What held-out choices maximise: the density of the target's future, or of what is observed.

        With `scene_only` predictions without the scene are left out: sigma_e has no part in them.
        """
        if self.predictor.criterion == "prediction":
            return self.density(noise, scene_noise, scene_only)
        predictor = self.predictor.with_noise(noise, scene_noise)
        parts = self._predictions(predictor, scene_only)
        return torch.stack([part.log_evidence.mean() for part, _ in parts]).mean()

    def density(self, noise: Tensor, scene_noise: Tensor, scene_only: bool = False) -> Tensor:
        """Mean log density of the target's future over beginnings of several lengths, with the scene and without it."""
        predictor = self.predictor.with_noise(noise, scene_noise)
        parts = self._predictions(predictor, scene_only)
        return -torch.stack([self._nll(part, mask) for part, mask in parts]).mean()

    def standardised_errors(self, noise: Tensor, scene_noise: Tensor) -> Float[Tensor, "samples"]:
        """Squared errors of held-out samples in units of their predicted variance.

        Samples of which the weights leave nothing uncertain (a signal that is constant) have no part in it.
        """
        predictor = self.predictor.with_noise(noise, scene_noise)
        squares = [torch.ones(0, dtype=torch.float64)]
        for prediction, mask in self._predictions(predictor):
            square = (prediction.mean - self.target.values).square() / prediction.variance
            squares.append(square[mask & (prediction.variance > (1.0 + _UNCERTAIN) * prediction.residual)])
        return torch.cat(squares)

    def _predictions(
        self, predictor: InteractionPredictor, scene_only: bool = False
    ) -> Iterator[tuple[Prediction, Tensor]]:
        """Predictions from beginnings of several lengths, and which samples of the target lie ahead of each."""
        fitted = predictor.fitted
        told = fitted is not None and fitted.phase.needs_duration
        start = self.human.time[..., 0]
        for share in SHARES_SEEN:
            until = start + share * self.human.duration.median()
            mask = future_mask(self.target, until)
            if not bool(mask.any()):
                continue
            seen = _beginning(self.human, until)
            scenes = [None] if self.environment is None else [None, self.environment]
            for scene in scenes[-1:] if scene_only else scenes:
                phase = known_phase(seen, self.human.duration) if told else None
                yield predictor.predict(seen, scene, time=self.target.time, phase=phase), mask

    def _nll(self, prediction: Prediction, mask: Tensor) -> Tensor:
        kept = mask.flatten(1).any(-1)
        means = prediction.component_means.expand(len(mask), -1, -1, -1)
        variances = prediction.component_variances.expand(means.shape)
        log_weight = prediction.posterior.log_weight.expand(means.shape[:-2])
        truth = self.target.values
        return gaussian_mixture_nll(means[kept], variances[kept], log_weight[kept], truth[kept], mask[kept]).mean()


def held_out(predictor: InteractionPredictor, training: Training, model: AbstractJointModel, fold: Tensor) -> HeldOut:
    """The joint model fitted without the fold; clock and primitives are those of all demonstrations.

    Args:
        predictor: not fitted; says how to predict.
        training: all demonstrations on one clock.
        model: not fitted.
        fold: places of the demonstrations to leave out.
    """
    demonstrations = training.demonstrations
    kept = torch.ones(len(demonstrations), dtype=torch.bool)
    kept[fold] = False
    model = training.fitted_model(model, predictor.target, kept.tolist())
    some = fold[torch.linspace(0, len(fold) - 1, min(len(fold), _MOTIONS_PER_FOLD)).round().long()]
    scene = demonstrations.environments
    return HeldOut(
        dataclasses.replace(predictor, fitted=dataclasses.replace(training.fitted, model=model)),
        _members(training.motions[HUMAN], some),
        _thinned(_members(training.motions[predictor.target], some)),
        None if scene is None else scene[some],
    )


def _members(motions: Trajectory, index: Tensor) -> Trajectory:
    """Some motions of a batch; a shared time vector stays shared."""
    if motions.time.ndim > 1:
        return motions[index]
    noise = None if motions.noise is None else motions.noise[index]
    return Trajectory(motions.time, motions.values[index], motions.names, motions.mask[index], noise)


def _thinned(motions: Trajectory) -> Trajectory:
    """Every k-th sample: neighbouring samples say nearly the same about a choice."""
    stride = max(1, motions.num_samples // _SCORED_SAMPLES)
    kept = slice(None, None, stride)
    return Trajectory(motions.time[..., kept], motions.values[..., kept, :], motions.names, motions.mask[..., kept, :])


def _beginning(trajectory: Trajectory, until: Tensor) -> Trajectory:
    """Samples up to a time, the others dropped where no motion needs them and masked elsewhere."""
    inside = trajectory.time <= until[..., None]
    count = max(1, int(inside.reshape(-1, trajectory.num_samples).any(0).sum()))
    mask = trajectory.mask & inside[..., None]
    return dataclasses.replace(trajectory, mask=mask).first(count)

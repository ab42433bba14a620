"""Clock, noise and calibration chosen on held-out groups, so that a newcomer tunes nothing.

Noise is searched as a multiple of each quantity's own standard deviation over the demonstrations, which keeps the
choice free of units. Where there is one group only nothing can be held out, and stated defaults are taken.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Sequence
from dataclasses import dataclass

import torch
from jaxtyping import Float
from torch import Tensor

from eaip_prob.data.environment import EnvironmentFeatures
from eaip_prob.held_out import HeldOut, held_out
from eaip_prob.models import AbstractJointModel, group_folds
from eaip_prob.prediction import InteractionPredictor
from eaip_prob.training import HUMAN, Fitted, Training

# The largest is as good as not listening: for people whose motion tells nothing of a new person's.
NOISE_MULTIPLES = (0.002, 0.005, 0.01, 0.02, 0.05, 0.1, 0.3, 1.0, 3.0, 10.0)
ENVIRONMENT_MULTIPLES = (0.01, 0.03, 0.1, 0.2, 0.4, 1.0)
DEFAULT_NOISE, DEFAULT_ENVIRONMENT_NOISE = 0.02, 0.1
_LEAST_FACTOR = 1e-3  # demonstrations that repeat each other leave no error at all
_TIE = 1e-6  # nats per sample
_LEVEL, _LEVEL_QUANTILE = 0.9, 2.705543454  # the chi-square quantile of one degree of freedom


def selected(predictor: InteractionPredictor, candidates: Sequence[Training]) -> Fitted:
    """The candidate clock, joint model, noise and calibration that do best on held-out groups.

    One after the other: the clock and the joint model at the default noise, sigma, sigma_e, and the factor on
    predictive variances with which 90 % intervals hold 90 % of the held-out samples.

    Args:
        predictor: what to choose: noise given to it is kept.
        candidates: the demonstrations on each clock.
    """
    folds = group_folds(candidates[0].demonstrations.groups)
    models = predictor.model.candidates()
    searches = [_Search.start(predictor, training, models[len(models) // 2], folds) for training in candidates]
    search = _best_search(searches)
    if len(models) > 1 and search.held_out:
        search = _best_search([_Search.start(predictor, search.training, model, folds) for model in models])
    return search.refined()


@dataclass(frozen=True, eq=False)
class _Search:
    """Held-out choices with one clock and one joint model.

    Args:
        predictor: with what was given to it.
        training: demonstrations on the clock.
        model: not fitted.
        held_out: folds that can be scored.
        scale: (D_h,), standard deviation of the observed quantity, the unit of sigma.
        spread: (E,), standard deviation of the features, the unit of sigma_e.
    """

    predictor: InteractionPredictor
    training: Training
    model: AbstractJointModel
    held_out: list[HeldOut]
    scale: Float[Tensor, "signals"]
    spread: Float[Tensor, "features"]

    @classmethod
    def start(
        cls, predictor: InteractionPredictor, training: Training, model: AbstractJointModel, folds: Sequence[Tensor]
    ) -> _Search:
        human = training.motions[HUMAN]
        paths = training.phase.at(human.time)[..., 0, :]
        size = human.values.abs().sum((0, 1)) / human.mask.sum((0, 1)).clamp_min(1)
        scale = _positive(predictor.evidence.scale(training.fitted.primitives[HUMAN], human, paths), size)
        scene = training.demonstrations.environments
        spread = training.fitted.environment_noise if scene is None else _spread(scene)
        parts = [held_out(predictor, training, model, fold) for fold in folds]
        return cls(predictor, training, model, [part for part in parts if part.can_be_scored], scale, spread)

    @property
    def noise(self) -> tuple[Tensor, Tensor]:
        """(sigma, sigma_e) as given, or the defaults."""
        fitted, given = self.training.fitted, self.predictor
        return (
            fitted.noise if given.noise is not None else DEFAULT_NOISE * self.scale,
            fitted.environment_noise
            if given.environment_noise is not None
            else DEFAULT_ENVIRONMENT_NOISE * self.spread,
        )

    def density(self) -> float:
        """Held-out log density of the target's future at that noise; without folds nothing is preferred."""
        scores = [fold.density(*self.noise) for fold in self.held_out]
        return float(torch.stack(scores).mean()) if scores else 0.0

    def refined(self) -> Fitted:
        """Fitted to all demonstrations, with noise chosen and variances calibrated."""
        noise, scene_noise = self.noise
        inflation = 1.0
        if self.held_out and self.predictor.noise is None:
            noise = self._climbed(scene_noise) * self.scale
        if self.held_out and self.predictor.environment_noise is None and len(self.spread):
            choices = [multiple * self.spread for multiple in ENVIRONMENT_MULTIPLES]
            scene_noise = max(choices, key=lambda choice: self._score(noise, choice, scene_only=True))
        if self.held_out and self.predictor.recalibrate:
            errors = [fold.standardised_errors(noise, scene_noise) for fold in self.held_out]
            inflation = _calibration(torch.cat(errors))
        return dataclasses.replace(
            self.training.fitted,
            model=self.training.fitted_model(self.model, self.predictor.target),
            noise=noise,
            environment_noise=scene_noise,
            inflation=inflation,
        )

    def _climbed(self, scene_noise: Tensor) -> float:
        """The best multiple of sigma on a climb from the default one, unless not listening is better still."""
        scores: dict[int, float] = {}

        def score(place: int) -> float:
            if place not in scores:
                scores[place] = self._score(NOISE_MULTIPLES[place] * self.scale, scene_noise)
            return scores[place]

        last = len(NOISE_MULTIPLES) - 1
        best = NOISE_MULTIPLES.index(DEFAULT_NOISE)
        while True:
            near = max((place for place in (best, best - 1, best + 1) if 0 <= place <= last), key=score)
            if near == best:
                return NOISE_MULTIPLES[max((best, last), key=score)]
            best = near

    def _score(self, noise: Tensor, scene_noise: Tensor, scene_only: bool = False) -> float:
        return float(torch.stack([fold.score(noise, scene_noise, scene_only) for fold in self.held_out]).mean())


def _best_search(searches: Sequence[_Search]) -> _Search:
    """The one with the highest held-out density; of those that agree up to round-off, the first."""
    if len(searches) == 1:
        return searches[0]
    densities = [search.density() for search in searches]
    return next(search for search, density in zip(searches, densities, strict=True) if density >= max(densities) - _TIE)


def _calibration(squares: Float[Tensor, "samples"]) -> float:
    """Factor on variances with which the central 90 % interval of a normal holds 90 % of these squared errors.

    A quantile rather than the mean: one motion far off, or samples of which little was known, would move a mean most.
    """
    if len(squares) == 0:
        return 1.0
    rank = max(0, math.ceil(_LEVEL * len(squares)) - 1)
    return max(_LEAST_FACTOR, float(squares.sort().values[rank] / _LEVEL_QUANTILE))


def _spread(scene: EnvironmentFeatures) -> Float[Tensor, "features"]:
    """Standard deviation of each feature over the demonstrations that observed it."""
    count = scene.observed.sum(0).clamp_min(1)
    mean = scene.value.sum(0) / count
    squares = torch.where(scene.observed, scene.value - mean, 0.0).square().sum(0)
    return _positive((squares / count).sqrt(), mean.abs())


def _positive(spread: Tensor, size: Tensor) -> Tensor:
    """The spread, or the size (or 1) of what does not vary: it says nothing, but needs a noise above zero."""
    return torch.where(spread > 1e-9 * size, spread, torch.where(size > 0, size, 1.0))

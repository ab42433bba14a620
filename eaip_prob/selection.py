"""Clock, noise and calibration chosen on held-out groups, so that a newcomer tunes nothing.

Noise is searched as a multiple of each quantity's own standard deviation over the demonstrations, which keeps the
choice free of units. Where there is one group only nothing can be held out, and stated defaults are taken.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from dataclasses import dataclass

import torch
from jaxtyping import Float
from torch import Tensor

from eaip_prob.data.environment import EnvironmentFeatures
from eaip_prob.held_out import HeldOut, held_out
from eaip_prob.models import group_folds
from eaip_prob.prediction import InteractionPredictor
from eaip_prob.training import HUMAN, Fitted, Training

NOISE_MULTIPLES = (0.002, 0.005, 0.01, 0.02, 0.05, 0.1, 0.3, 1.0)
ENVIRONMENT_MULTIPLES = (0.01, 0.03, 0.1, 0.2, 0.4, 1.0)
DEFAULT_NOISE, DEFAULT_ENVIRONMENT_NOISE = 0.03, 0.1
_TIE = 1e-6  # nats per sample


def selected(predictor: InteractionPredictor, candidates: Sequence[Training]) -> Fitted:
    """The candidate clock, the noise and the calibration that do best on held-out groups.

    First the clock, at the default noise; then sigma, then sigma_e; then the factor on predictive variances, the mean
    squared standardised error of held-out motions.

    Args:
        predictor: what to choose: noise given to it is kept.
        candidates: the demonstrations on each clock.
    """
    folds = group_folds(candidates[0].demonstrations.groups)
    searches = [_Search.start(predictor, training, folds) for training in candidates]
    if len(searches) == 1:
        return searches[0].refined()
    densities = [search.density() for search in searches]
    # Clocks that agree (all motions equally long) differ by round-off: the first of them is kept.
    good = [search for search, density in zip(searches, densities, strict=True) if density >= max(densities) - _TIE]
    return good[0].refined()


@dataclass(frozen=True, eq=False)
class _Search:
    """Held-out choices on one clock.

    Args:
        predictor: with what was given to it.
        training: demonstrations on the clock.
        held_out: folds that can be scored.
        scale: (D_h,), standard deviation of the observed quantity, the unit of sigma.
        spread: (E,), standard deviation of the features, the unit of sigma_e.
    """

    predictor: InteractionPredictor
    training: Training
    held_out: list[HeldOut]
    scale: Float[Tensor, "signals"]
    spread: Float[Tensor, "features"]

    @classmethod
    def start(cls, predictor: InteractionPredictor, training: Training, folds: Sequence[Tensor]) -> _Search:
        human = training.motions[HUMAN]
        paths = training.phase.at(human.time)[..., 0, :]
        size = human.values.abs().sum((0, 1)) / human.mask.sum((0, 1)).clamp_min(1)
        scale = _positive(predictor.evidence.scale(training.fitted.primitives[HUMAN], human, paths), size)
        scene = training.demonstrations.environments
        spread = training.fitted.environment_noise if scene is None else _spread(scene)
        parts = [held_out(predictor, training, fold) for fold in folds]
        return cls(predictor, training, [part for part in parts if part.can_be_scored], scale, spread)

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
        """The candidate with its noise chosen and its variances calibrated."""
        noise, scene_noise = self.noise
        inflation = 1.0
        if self.held_out and self.predictor.noise is None:
            noise = _best(self.held_out, [(multiple * self.scale, scene_noise) for multiple in NOISE_MULTIPLES])[0]
        if self.held_out and self.predictor.environment_noise is None and len(self.spread):
            choices = [(noise, multiple * self.spread) for multiple in ENVIRONMENT_MULTIPLES]
            scene_noise = _best(self.held_out, choices, scene_only=True)[1]
        if self.held_out and self.predictor.recalibrate:
            errors = [fold.standardised_error(noise, scene_noise) for fold in self.held_out]
            inflation = float(torch.stack(errors).mean())
        return dataclasses.replace(
            self.training.fitted, noise=noise, environment_noise=scene_noise, inflation=inflation
        )


def _spread(scene: EnvironmentFeatures) -> Float[Tensor, "features"]:
    """Standard deviation of each feature over the demonstrations that observed it."""
    count = scene.observed.sum(0).clamp_min(1)
    mean = scene.value.sum(0) / count
    squares = torch.where(scene.observed, scene.value - mean, 0.0).square().sum(0)
    return _positive((squares / count).sqrt(), mean.abs())


def _positive(spread: Tensor, size: Tensor) -> Tensor:
    """The spread, or the size (or 1) of what does not vary: it says nothing, but needs a noise above zero."""
    return torch.where(spread > 1e-9 * size, spread, torch.where(size > 0, size, 1.0))


def _best(
    held_out: list[HeldOut], choices: list[tuple[Tensor, Tensor]], scene_only: bool = False
) -> tuple[Tensor, Tensor]:
    scores = [float(torch.stack([fold.score(*choice, scene_only) for fold in held_out]).mean()) for choice in choices]
    return choices[max(range(len(choices)), key=scores.__getitem__)]

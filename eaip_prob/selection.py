"""Clock, features, noise, trust and calibration chosen on held-out groups, so that a newcomer tunes nothing.

Noise is searched as a multiple of each quantity's own standard deviation over the demonstrations, which keeps the
choice free of units. Where there is one group only nothing can be held out, and stated defaults are taken.
"""

from __future__ import annotations

import math
import warnings
from collections.abc import Sequence
from dataclasses import dataclass, replace

import torch
from jaxtyping import Float
from torch import Tensor

from eaip_prob.data.demonstrations import DemonstrationSet
from eaip_prob.data.environment import EnvironmentFeatures
from eaip_prob.data.feature_map import AbstractFeatureMap
from eaip_prob.earned_trust import earned_gate, earned_scene_trust, earned_trust
from eaip_prob.errors import HeldOutWarning
from eaip_prob.folds import group_folds
from eaip_prob.held_out import Fold, HeldOut, folds_of
from eaip_prob.models import AbstractJointModel
from eaip_prob.prediction import InteractionPredictor, given_noise
from eaip_prob.training import HUMAN, ROBOT, Fitted, Recipe, Training, train

# The largest is as good as not listening: for people whose motion tells nothing of a new person's.
NOISE_MULTIPLES = (0.002, 0.005, 0.01, 0.02, 0.05, 0.1, 0.3, 1.0, 3.0, 10.0)
ENVIRONMENT_MULTIPLES = (0.01, 0.03, 0.1, 0.2, 0.4, 1.0)
DEFAULT_NOISE, DEFAULT_ENVIRONMENT_NOISE = 0.02, 0.1
_LEAST_FACTOR = 1e-3  # demonstrations that repeat each other leave no error at all
_TIE = 1e-6  # nats per sample
_LEVEL, _LEVEL_QUANTILE = 0.9, 2.705543454  # the chi-square quantile of one degree of freedom


def selected(predictor: InteractionPredictor, demonstrations: DemonstrationSet) -> Fitted:
    """The clock, feature map, joint model, noise, trust and calibration that do best on held-out groups.

    One after the other: the clock with the feature map, and the joint model, at the default noise; sigma, sigma_e; the
    gate on the environment and the trust in the human; last the factor on predictive variances with which 90 %
    intervals hold 90 % of the held-out samples.

    Args:
        predictor: what to choose: noise given to it is kept.
        demonstrations: with or without environment.
    """
    folds = group_folds(demonstrations.groups)
    model = _middle(predictor.model)
    maps = [] if demonstrations.environments is None else predictor.maps
    searches: list[_Search] = []
    for recipe in _recipes(predictor, demonstrations):
        search = _Search.start(predictor, demonstrations, recipe, model, folds)
        searches += [search.with_features(features) for features in maps] or [search]
    search = _simplest_search(searches)
    still_open = predictor.model
    while search.folds and len(models := still_open.candidates()) > 1:
        searches = [replace(search, model=_middle(candidate)) for candidate in models]
        search = _best_search(searches)
        still_open = models[searches.index(search)]
    return search.refined()


def _middle(model: AbstractJointModel) -> AbstractJointModel:
    """The model with everything that is open at the middle of its candidates."""
    while len(models := model.candidates()) > 1:
        model = models[len(models) // 2]
    return model


def _recipes(predictor: InteractionPredictor, demonstrations: DemonstrationSet) -> list[Recipe]:
    """One for each clock; without a scene, for what stands in for them, each once."""
    clocks = predictor.clocks
    if demonstrations.environments is None:
        clocks = list({repr(clock): clock for clock in (one.without_environment() for one in clocks)}.values())
    primitives = {HUMAN: predictor.human, ROBOT: predictor.robot}
    return [Recipe(predictor.target, predictor.evidence, clock, primitives, predictor.num_samples) for clock in clocks]


@dataclass(frozen=True, eq=False)
class _Search:
    """Held-out choices with one clock, one feature map and one joint model.

    Args:
        predictor: with what was given to it.
        training: all demonstrations.
        model: not fitted.
        folds: trainings without some groups.
        scale: (D_h,), standard deviation of the observed quantity, the unit of sigma.
        spread: (E,), standard deviation of the features, the unit of sigma_e.
    """

    predictor: InteractionPredictor
    training: Training
    model: AbstractJointModel
    folds: Sequence[Fold]
    scale: Float[Tensor, "signals"]
    spread: Float[Tensor, "features"]

    @classmethod
    def start(
        cls,
        predictor: InteractionPredictor,
        demonstrations: DemonstrationSet,
        recipe: Recipe,
        model: AbstractJointModel,
        folds: Sequence[Tensor],
    ) -> _Search:
        training, scene = train(demonstrations, recipe), demonstrations.environments
        human = training.motions[HUMAN]
        size = human.values.abs().sum((0, 1)) / human.mask.sum((0, 1)).clamp_min(1)
        primitive = recipe.primitives[HUMAN].spanning(training.limit)
        scale = _positive(predictor.evidence.scale(primitive, human, training.paths), size)
        spread = torch.zeros(0, dtype=torch.float64) if scene is None else _spread(scene)
        parts = folds_of(demonstrations, recipe, folds, alike=not predictor.separate)
        return cls(predictor, training, model, parts, scale, spread)

    def with_features(self, features: AbstractFeatureMap) -> _Search:
        """The same with the environment through a feature map."""
        folds = [fold.with_features(features) for fold in self.folds]
        return replace(self, training=self.training.with_features(features), folds=folds)

    @property
    def noise(self) -> tuple[Tensor, Tensor]:
        """(sigma, sigma_e) as given, or the defaults."""
        given = self.predictor
        noise, scene = DEFAULT_NOISE * self.scale, DEFAULT_ENVIRONMENT_NOISE * self.spread
        if given.noise is not None:
            noise = given_noise(given.noise, len(self.scale), "noise")
        if given.environment_noise is not None and len(self.spread):
            scene = given_noise(given.environment_noise, len(self.spread), "environment_noise")
        return noise, scene

    def held_out(self) -> list[HeldOut]:
        """Each fold with the joint model fitted without it."""
        return [fold.with_model(self.model, self.noise) for fold in self.folds]

    def density(self) -> float:
        """Held-out log density of the target's future at that noise; without folds nothing is preferred."""
        return _mean([part.few().density() for part in self.held_out()])

    def group_densities(self) -> Float[Tensor, "groups"]:
        """The same for each group."""
        parts = [part.few() for part in self.held_out()]
        scores = torch.cat([part.densities() for part in parts])
        labels = [group for part in parts for group in part.left_out.groups]
        groups = list(dict.fromkeys(labels))
        member = torch.tensor([[label == group for label in labels] for group in groups])
        means = torch.where(member, scores, torch.nan).nanmean(-1)
        return means[means.isfinite()]

    def refined(self) -> Fitted:
        """Fitted to all demonstrations, with noise chosen and variances calibrated."""
        fitted = self.training.fitted(self.model, *self.noise)
        parts = self.held_out()
        if not parts:
            return fitted
        noise, scene_noise = self.noise
        few = [part.few() for part in parts]
        if self.predictor.noise is None:
            noise = self._climbed(few) * self.scale
            few = [part.given(noise=noise) for part in few]
        if self.predictor.environment_noise is None and len(self.spread):
            choices = [multiple * self.spread for multiple in ENVIRONMENT_MULTIPLES]
            scene_noise = max(choices, key=lambda choice: self._score(few, True, environment_noise=choice))
        parts = [part.given(noise=noise, environment_noise=scene_noise) for part in parts]
        found = {"noise": noise, "environment_noise": scene_noise, "num_folds": len(parts)}
        return replace(fitted, **found, **self._believed(parts))

    def _believed(self, parts: Sequence[HeldOut]) -> dict[str, object]:
        """Gate, trust and calibration, each with those before it."""
        found: dict[str, object] = {}
        with_scene = self.predictor.gate and len(self.spread) > 0
        if with_scene:
            found["gate"] = earned_gate(parts)
            parts = [part.given(gate=found["gate"]) for part in parts]
        if self.predictor.trust:
            found["trust"] = earned_trust(parts)
            parts = [part.given(trust=found["trust"]) for part in parts]
        if with_scene:
            found["scene_trust"] = earned_scene_trust(parts)
            parts = [part.given(scene_trust=found["scene_trust"]) for part in parts]
        if self.predictor.recalibrate:
            groups = [squares for part in parts for squares in part.standardised_errors().values()]
            by_group = self.predictor.recalibrate == "groups"
            found["inflation"] = _calibration_of_groups(groups) if by_group else _calibration(torch.cat(groups))
        return found

    def _climbed(self, parts: Sequence[HeldOut]) -> float:
        """The best multiple of sigma on a climb from the default one, unless not listening is better still."""
        scores: dict[int, float] = {}

        def score(place: int) -> float:
            if place not in scores:
                scores[place] = self._score(parts, False, noise=NOISE_MULTIPLES[place] * self.scale)
            return scores[place]

        last = len(NOISE_MULTIPLES) - 1
        best = NOISE_MULTIPLES.index(DEFAULT_NOISE)
        while True:
            near = max((place for place in (best, best - 1, best + 1) if 0 <= place <= last), key=score)
            if near == best:
                return NOISE_MULTIPLES[max((best, last), key=score)]
            best = near

    def _score(self, parts: Sequence[HeldOut], scene_only: bool, **changes: Tensor) -> float:
        """What held-out choices maximise: the density of the target's future, or of what is observed."""
        changed = [part.given(**changes) for part in parts]
        if self.predictor.criterion == "evidence":
            return _mean([part.evidence() for part in changed])
        return _mean([part.density(scene_only) for part in changed])


def _mean(scores: Sequence[Tensor]) -> float:
    return float(torch.stack(list(scores)).mean()) if scores else 0.0


def _simplest_search(searches: Sequence[_Search]) -> _Search:
    """The first that is not worse than the best by more than a standard error over groups.

    Clocks and feature maps are listed with the simplest first; with few groups the best of many is so by chance.
    """
    if len(searches) == 1 or not searches[0].folds:
        return searches[0]
    densities = [search.group_densities() for search in searches]
    best = max(densities, key=lambda density: float(density.mean()))
    for search, density in zip(searches, densities, strict=True):
        behind = best - density
        if float(behind.mean()) <= max(_TIE, float(behind.std()) / len(behind) ** 0.5 if len(behind) > 1 else 0.0):
            return search
    raise AssertionError("the best is not behind itself")


def _best_search(searches: Sequence[_Search]) -> _Search:
    """The one with the highest held-out density; of those that agree up to round-off, the first."""
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


def _calibration_of_groups(groups: Sequence[Float[Tensor, "samples"]]) -> float:
    """Factor with which 90 % intervals hold 90 % of a new group's samples, with probability 0.9.

    The factor of each group that was left out is one draw of what a new one needs, and what a tenth of new ones exceed
    is the (0.9 (G + 1))-th of G in order: that is how few people say less than many.
    """
    factors = sorted(_calibration(squares) for squares in groups if len(squares))
    rank = math.ceil(_LEVEL * (len(factors) + 1)) - 1
    return factors[min(rank, len(factors) - 1)] if factors else 1.0


def _spread(scene: EnvironmentFeatures) -> Float[Tensor, "features"]:
    """Standard deviation of each feature over the demonstrations that observed it."""
    count = scene.observed.sum(0).clamp_min(1)
    mean = scene.value.sum(0) / count
    squares = torch.where(scene.observed, scene.value - mean, 0.0).square().sum(0)
    return _positive((squares / count).sqrt(), mean.abs())


def _positive(spread: Tensor, size: Tensor) -> Tensor:
    """The spread, or the size (or 1) of what does not vary: it says nothing, but needs a noise above zero."""
    return torch.where(spread > 1e-9 * size, spread, torch.where(size > 0, size, 1.0))


def warn_where_nothing_is_held_out(demonstrations: DemonstrationSet) -> None:
    """Says which defaults stand where a choice on held-out groups would be, to who calls the caller."""
    if group_folds(demonstrations.groups):
        return
    labels = set(demonstrations.groups)
    what = f"are of one group ({labels.pop()!r})" if len(labels) == 1 else "are too few to leave a group out"
    warnings.warn(
        f"All {len(demonstrations)} demonstrations {what}: nothing can be left out, so the first "
        f"clock and feature map, sigma of {DEFAULT_NOISE} and sigma_e of {DEFAULT_ENVIRONMENT_NOISE} standard "
        "deviations are taken, everything observed is believed and variances are not calibrated. Record more people or "
        "scenes, or pass DemonstrationSet(demonstrations, groups) with groups that differ.",
        HeldOutWarning,
        stacklevel=3,
    )

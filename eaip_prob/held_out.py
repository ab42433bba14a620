"""Motions of groups left out, and how well a predictor that never saw them does."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import torch
from jaxtyping import Float
from torch import Tensor

from eaip_prob.data.demonstrations import DemonstrationSet
from eaip_prob.data.environment import EnvironmentFeatures
from eaip_prob.data.feature_map import AbstractFeatureMap
from eaip_prob.data.trajectory import Trajectory
from eaip_prob.evaluation.scores import gaussian_mixture_nll
from eaip_prob.evaluation.scoring import future_mask
from eaip_prob.forecast import Prediction
from eaip_prob.inference import predicted, seen_share
from eaip_prob.models import AbstractJointModel
from eaip_prob.phase import known_phase
from eaip_prob.training import HUMAN, Fitted, Recipe, Training, train
from eaip_prob.trust import NO_TRUST, Trust

SHARES_SEEN = (0.05, 0.2, 0.5, 0.8)
_MOTIONS_PER_FOLD = 32
_FEW_PER_FOLD = 20
_SCORED_SAMPLES = 25
_UNCERTAIN = 1e-6


@dataclass(frozen=True, eq=False)
class LeftOut:
    """Motions that took no part in a training.

    Args:
        human: (N, T, D_h).
        target: (N, T', D), every k-th sample.
        environment: of those motions, None where it has no part in predictions.
        groups: of each motion.
    """

    human: Trajectory
    target: Trajectory
    environment: EnvironmentFeatures | None
    groups: Sequence[int | str]

    @classmethod
    def of(cls, demonstrations: DemonstrationSet, target: str, fold: Tensor) -> LeftOut | None:
        """Some motions of a fold, evenly. Where the scene was not observed another joint answers: they have no part."""
        scene = demonstrations.environments
        if scene is not None:
            fold = fold[scene.observed[fold].any(-1)]
        if len(fold) == 0:
            return None
        some = fold[_evenly(len(fold), _MOTIONS_PER_FOLD)]
        return cls(
            demonstrations.trajectories(HUMAN).members(some.tolist()),
            _thinned(demonstrations.trajectories(target).members(some.tolist())),
            None if scene is None else scene[some],
            [demonstrations.groups[int(place)] for place in some],
        )

    def few(self) -> LeftOut:
        """Fewer of the motions, evenly: enough to compare many candidates on."""
        some = _evenly(len(self.groups), _FEW_PER_FOLD)
        return LeftOut(
            self.human.members(some.tolist()),
            self.target.members(some.tolist()),
            None if self.environment is None else self.environment[some],
            [self.groups[int(place)] for place in some],
        )

    @property
    def can_be_scored(self) -> bool:
        """Whether any sample of the target lies ahead of the shortest beginning."""
        return bool(self.future(SHARES_SEEN[0])[1].any())

    def future(self, share: float) -> tuple[Trajectory, Tensor]:
        """(the beginnings that a share of the usual duration shows, which samples of the target lie ahead)."""
        until = self.human.time[..., 0] + share * self.human.duration.median()
        return _beginning(self.human, until), future_mask(self.target, until)


@dataclass(frozen=True, eq=False)
class Fold:
    """A training without some groups, and motions of those.

    Args:
        training: on the other groups.
        left_out: motions to predict.
        alike: whether one joint answers with the scene and without it, so that both are asked for.
    """

    training: Training
    left_out: LeftOut
    alike: bool = False

    def with_features(self, features: AbstractFeatureMap) -> Fold:
        """With the environment through another map."""
        return replace(self, training=self.training.with_features(features))

    def with_model(self, model: AbstractJointModel, noise: tuple[Tensor, Tensor]) -> HeldOut:
        """With a joint model, not yet fitted."""
        return HeldOut(self.training.fitted(model, *noise), self.left_out, self.alike)


def folds_of(demonstrations: DemonstrationSet, recipe: Recipe, folds: Sequence[Tensor], alike: bool) -> list[Fold]:
    """One training for each fold whose motions can be scored; clock and primitives never see them either."""
    made = []
    for fold in folds:
        left_out = LeftOut.of(demonstrations, recipe.target, fold)
        out = set(fold.tolist())
        kept = demonstrations.subset([place for place in range(len(demonstrations)) if place not in out])
        scene = kept.environments
        blind = scene is not None and not bool(scene.observed.any(0).all())
        if left_out is not None and left_out.can_be_scored and not blind:
            made.append(Fold(train(kept, recipe), left_out, alike))
    return made


@dataclass(frozen=True, eq=False)
class HeldOut:
    """A fitted joint that never saw some motions, and those motions.

    Args:
        fitted: without them.
        left_out: the motions.
        alike: whether predictions without the scene count as well.
    """

    fitted: Fitted
    left_out: LeftOut
    alike: bool = False

    def given(self, **changes: object) -> HeldOut:
        """With other noise, gate or trust."""
        return replace(self, fitted=replace(self.fitted, **changes))

    def few(self) -> HeldOut:
        """On fewer of the motions."""
        return replace(self, left_out=self.left_out.few())

    def densities(self, scene_only: bool = False) -> Float[Tensor, "motions"]:
        """Log density of each motion's target, mean over its future after beginnings of several lengths, nats a sample.

        NaN for a motion of which nothing lies ahead.
        """
        scores = [self._density(part, mask) for part, mask in self._predictions(scene_only)]
        return torch.stack(scores).nanmean(0)

    def density(self, scene_only: bool = False) -> Tensor:
        """Mean of `densities` over all motions and beginnings."""
        scores = [self._density(part, mask) for part, mask in self._predictions(scene_only)]
        return torch.stack([score.nanmean() for score in scores]).mean()

    def evidence(self) -> Tensor:
        """Mean log density of what was observed, nats."""
        return torch.stack([part.log_evidence.mean() for part, _ in self._predictions()]).mean()

    def standardised_errors(self) -> dict[int | str, Float[Tensor, "samples"]]:
        """Squared errors of held-out samples in units of their predicted variance, of each group.

        Samples of which the weights leave nothing uncertain (a signal that is constant) have no part in it.
        """
        found: dict[int | str, list[Tensor]] = {}
        for prediction, mask in self._predictions():
            square = (prediction.mean - self.left_out.target.values).square() / prediction.variance
            least = torch.as_tensor(prediction.inflation)[..., None, None] * prediction.residual
            counts = mask & (prediction.variance > (1.0 + _UNCERTAIN) * least)
            for group, motion, kept in zip(self.left_out.groups, square, counts, strict=True):
                found.setdefault(group, []).append(motion[kept])
        return {group: torch.cat(parts) for group, parts in found.items()}

    def moved_by_scene(self) -> Moved:
        """How the scene alone moves the expected motion, and where it should have moved to."""
        nothing = self.left_out.human.hide(self.left_out.human.names)
        before, after = (self._predict(nothing, scene) for scene in (None, self.left_out.environment))
        return self._moved(before, after, self.left_out.target.mask)

    def moved_by(self, trust: str, share: float) -> tuple[float, Moved] | None:
        """How `trust` (in the motion) or `scene_trust` moves the expected motion from none to full.

        Args:
            trust: field of `Fitted`.
            share: of the usual duration that is seen.

        Returns:
            (share of the expected duration seen, sums); None where nothing is ahead.
        """
        seen, mask = self.left_out.future(share)
        if not bool(mask.any()):
            return None
        before, after = (
            self.given(**{trust: value})._predict(seen, self.left_out.environment) for value in (NO_TRUST, Trust())
        )
        place = seen_share(seen, after.phase).expand(len(mask))[mask.flatten(1).any(-1)]
        return float(place.mean()), self._moved(before, after, mask)

    def _moved(self, before: Prediction, after: Prediction, mask: Tensor) -> Moved:
        truth = self.left_out.target.values - before.mean
        moved = (after.mean - before.mean).expand(truth.shape)
        # Signals may differ in unit: each counts by its own spread, and not at all where that is round-off.
        count = mask.sum((0, 1)).clamp_min(1)
        variance = torch.where(mask, truth.square(), 0.0).sum((0, 1)) / count
        scale = torch.where(variance > self.fitted.residual, variance.rsqrt(), 0.0)
        truth, moved = truth * scale, moved * scale
        sums = [torch.where(mask, part, 0.0).sum((-2, -1)) for part in (moved * truth, moved.square(), truth.square())]
        return Moved(self.left_out.groups, *sums)

    def _predictions(self, scene_only: bool = False) -> Iterator[tuple[Prediction, Tensor]]:
        """Predictions from beginnings of several lengths, and which samples of the target lie ahead of each."""
        scene = self.left_out.environment
        scenes = [None, scene] if self.alike and scene is not None and not scene_only else [scene]
        for share in SHARES_SEEN:
            seen, mask = self.left_out.future(share)
            if not bool(mask.any()):
                continue
            for known in scenes:
                yield self._predict(seen, known), mask

    def _predict(self, seen: Trajectory, scene: EnvironmentFeatures | None) -> Prediction:
        told = self.fitted.phase.needs_duration
        phase = known_phase(seen, self.left_out.human.duration) if told else None
        return predicted(self.fitted, seen, scene, time=self.left_out.target.time, phase=phase)

    def _density(self, prediction: Prediction, mask: Tensor) -> Float[Tensor, "motions"]:
        kept = mask.flatten(1).any(-1)
        means = prediction.component_means.expand(len(mask), -1, -1, -1)
        variances = prediction.component_variances.expand(means.shape)
        log_weight = prediction.posterior.log_weight.expand(means.shape[:-2])
        truth = self.left_out.target.values
        density = torch.full_like(kept, torch.nan, dtype=torch.float64)
        nll = gaussian_mixture_nll(means[kept], variances[kept], log_weight[kept], truth[kept], mask[kept])
        density[kept] = -nll
        return density


@dataclass(frozen=True, eq=False)
class Moved:
    """Sums over the samples of each motion, for the slope of true on predicted deviations.

    Args:
        groups: of each motion.
        product: predicted times true deviation.
        power: squared predicted deviation.
        total: squared true deviation.
    """

    groups: Sequence[int | str]
    product: Float[Tensor, "motions"]
    power: Float[Tensor, "motions"]
    total: Float[Tensor, "motions"]


def _evenly(count: int, most: int) -> Tensor:
    return torch.linspace(0, count - 1, min(count, most)).round().long()


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

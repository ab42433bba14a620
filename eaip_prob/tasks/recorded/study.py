"""How well recorded motions of left-out people are predicted once a part of each was seen.

A motion is cut at a share of its own real duration, which only the judge knows; scores are on all that followed, in
real time. Every fold leaves whole groups (people, recordings) out, and everything is fitted and chosen without them.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass

import torch
from jaxtyping import Float
from torch import Tensor

from eaip_prob.data.demonstrations import Demonstration, DemonstrationSet
from eaip_prob.data.trajectory import Trajectory
from eaip_prob.errors import InputError
from eaip_prob.evaluation import Gain, future_mask, mixture_pit, paired_gain
from eaip_prob.forecast import Prediction
from eaip_prob.methods import EAIP, ENVIRONMENT, IP, KERNEL, MEAN, PAPER_EAIP, FittedMethods, MotionScores, score
from eaip_prob.tasks.recorded.folds import Fold, beginning
from eaip_prob.trust import Trust

GAINS = {
    "ip_over_mean": (MEAN, IP),
    "eaip_over_environment": (ENVIRONMENT, EAIP),
    "eaip_over_ip": (IP, EAIP),
    "eaip_kernel_over_eaip": (EAIP, KERNEL),
    "eaip_over_paper_eaip": (PAPER_EAIP, EAIP),
}
Key = tuple[str, int]  # (method, percent seen)


@dataclass(frozen=True, eq=False)
class Measured:
    """How one method did on some motions.

    Args:
        scores: one entry a motion.
        pit: (scored samples,), predicted probability of a value up to the truth.
    """

    scores: MotionScores
    pit: Float[Tensor, "samples"]


def measured(
    methods: FittedMethods, test: DemonstrationSet, names: Sequence[str], percents: Sequence[int]
) -> dict[Key, Measured]:
    """Scores of every method after every percentage of the motions in a test set."""
    human, truth, scene = test.trajectories("human"), test.trajectories("robot"), test.environments
    if scene is None:
        raise InputError("Expected demonstrations with environment features, got none.")
    results = {}
    for percent in percents:
        observed, cut = beginning(human, percent)
        mask = future_mask(truth, cut)
        for name in names:
            prediction = methods.predict(name, observed, scene, truth.time, human.duration)
            results[name, percent] = Measured(score(prediction, truth, cut), _levels(prediction, truth)[mask])
    return results


def _levels(prediction: Prediction, truth: Trajectory) -> Tensor:
    means = prediction.component_means.expand(*truth.batch_shape, -1, -1, -1)
    log_weight = prediction.posterior.log_weight.expand(means.shape[:-2])
    return mixture_pit(means, prediction.component_variances.expand(means.shape), log_weight, truth.values)


@dataclass(frozen=True, eq=False)
class Example:
    """One left-out motion and what was predicted of it.

    Args:
        place: of the motion among all demonstrations.
        motion: the motion.
        predictions: by (method, percent), read at the motion's own times.
    """

    place: int
    motion: Demonstration
    predictions: Mapping[Key, Prediction]


@dataclass(frozen=True, eq=False)
class Study:
    """All folds of an experiment together.

    Args:
        results: by (method, percent), motions in the order of `groups`.
        groups: person or recording of each motion.
        examples: some motions in detail.
        chosen: one row for each fold: the clock and noise that fitting chose.
    """

    results: Mapping[Key, Measured]
    groups: tuple[int | str, ...]
    examples: Sequence[Example]
    chosen: Sequence[Mapping[str, str]]

    @property
    def methods(self) -> list[str]:
        """Names, in the order of the tables."""
        return list(dict.fromkeys(method for method, _ in self.results))

    @property
    def percents(self) -> list[int]:
        """Percentages seen."""
        return list(dict.fromkeys(percent for _, percent in self.results))

    def summaries(self) -> dict[Key, Mapping[str, float]]:
        """{(method, percent): {"rmse", "nll", "coverage90"}} over all motions."""
        return {key: result.scores.summary() for key, result in self.results.items()}

    def gains(self) -> dict[Key, Gain]:
        """{(name of the gain, percent): reduction of per-motion rmse over the groups, in the target's units}."""
        rmse = {key: result.scores.motion_rmse for key, result in self.results.items()}
        return {
            (name, percent): paired_gain(rmse[baseline, percent], rmse[method, percent], self.groups)
            for name, (baseline, method) in GAINS.items()
            for percent in self.percents
            if (baseline, percent) in rmse and (method, percent) in rmse
        }

    def metrics(self) -> dict[str, float]:
        """Flat metrics: `rmse|nll|coverage90/method/percent` and `gain/name/percent/mean|low|high`."""
        metrics = {
            f"{name}/{method}/{percent}": value
            for (method, percent), row in self.summaries().items()
            for name, value in row.items()
        }
        for (name, percent), gain in self.gains().items():
            for part in ("mean", "low", "high"):
                metrics[f"gain/{name}/{percent}/{part}"] = getattr(gain, part)
        return metrics


def studied(
    demonstrations: DemonstrationSet,
    folds: Iterable[Fold],
    fit: Callable[[DemonstrationSet], FittedMethods],
    names: Sequence[str],
    percents: Sequence[int],
    examples: Sequence[int] = (),
) -> Study:
    """Fits and measures fold by fold.

    Args:
        demonstrations: all of them.
        folds: of `consecutive_folds`; a progress bar may be wrapped around them.
        fit: all methods from training demonstrations.
        names: methods to measure.
        percents: of each motion that are seen.
        examples: places of motions to keep in detail.
    """
    parts: list[dict[Key, Measured]] = []
    groups: list[int | str] = []
    shown: dict[int, Example] = {}
    chosen: list[Mapping[str, str]] = []
    for fold in folds:
        methods = fit(fold.training)
        parts.append(measured(methods, fold.test, names, percents))
        groups += fold.test.groups
        chosen.append(_chosen(methods, sorted(set(fold.test.groups))))
        for place in set(examples) & set(fold.places):
            shown[place] = _example(methods, place, demonstrations[place], percents)
    return Study(_joined(parts), tuple(groups), [shown[place] for place in examples], chosen)


def _joined(parts: Sequence[Mapping[Key, Measured]]) -> dict[Key, Measured]:
    joined = {}
    for key in parts[0]:
        scores = [part[key].scores for part in parts]
        columns = (torch.cat([getattr(s, f.name) for s in scores]) for f in dataclasses.fields(MotionScores))
        joined[key] = Measured(MotionScores(*columns), torch.cat([part[key].pit for part in parts]))
    return joined


def _example(methods: FittedMethods, place: int, motion: Demonstration, percents: Sequence[int]) -> Example:
    assert motion.human is not None and motion.robot is not None and motion.environment is not None
    predictions = {}
    for percent in percents:
        observed, _ = beginning(motion.human, percent)
        for name in (ENVIRONMENT, IP, EAIP):
            predictions[name, percent] = methods.predict(
                name, observed, motion.environment, motion.robot.time, motion.human.duration
            )
    return Example(place, motion, predictions)


def _chosen(methods: FittedMethods, left_out: Sequence[int | str]) -> dict[str, str]:
    ours, paper = methods.ours.require_fitted(), methods.paper.require_fitted()
    shuffled, alone = methods.shuffled.require_fitted(), ours.alone
    assert ours.features is not None and alone is not None
    return {
        "left out": f"{left_out[0]}-{left_out[-1]}" if len(left_out) > 2 else ", ".join(map(str, left_out)),
        "clock": type(ours.phase).__name__,
        "features": type(ours.features).__name__,
        "sigma": _numbers(ours.noise),
        "sigma_e": _numbers(ours.environment_noise),
        "gate": f"{ours.gate.value:.2f}",
        "gate shuffled": f"{shuffled.gate.value:.2f}",
        "trust": _slopes(ours.trust),
        "trust of ip": _slopes(alone.trust),
        "inflation": f"{ours.inflation:.2f}",
        "paper: sigma of forces": _numbers(paper.noise[:1]),
    }


def _slopes(trust: Trust) -> str:
    return " ".join(f"{slope.value:.2f}" for slope in trust.slopes)


def _numbers(values: Tensor) -> str:
    return " ".join(f"{value:.2g}" for value in values.tolist())

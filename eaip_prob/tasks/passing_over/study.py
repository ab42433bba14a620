"""The measurements of Sec. 4.1: how good are predictions and plans after a few samples."""

from __future__ import annotations

import warnings
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import torch
from jaxtyping import Float
from torch import Tensor

from eaip_prob.data.demonstrations import DemonstrationSet
from eaip_prob.data.environment import EnvironmentFeatures
from eaip_prob.data.trajectory import Trajectory
from eaip_prob.errors import ExtrapolationWarning, InputError
from eaip_prob.evaluation import dtw_to_motions, explained, paired_gain
from eaip_prob.forecast import Prediction
from eaip_prob.methods import EAIP, ENVIRONMENT, IP, MEAN, PAPER_EAIP, PAPER_IP, FittedMethods, MotionScores, score
from eaip_prob.tasks.passing_over.success import passed
from eaip_prob.tasks.passing_over.task import PassingOver

SCENARIOS = {"horizontal": ("y",), "both": ()}
PLAN_SAMPLES = 200
GAINS = {
    "ip_over_mean": (MEAN, IP),
    "eaip_over_environment": (ENVIRONMENT, EAIP),
    "eaip_over_ip": (IP, EAIP),
    "paper_eaip_over_paper_ip": (PAPER_IP, PAPER_EAIP),
}


@dataclass(frozen=True, eq=False)
class Beginnings:
    """Motions to be predicted, the rectangles they pass, and the training motions they are held against.

    Args:
        motions: (N, T, 2), complete, padded.
        scene: (N, 2), width and height, px.
        groups: N rectangle labels.
        references: {label: training motions of that rectangle}.
    """

    motions: Trajectory
    scene: EnvironmentFeatures
    groups: tuple[int | str, ...]
    references: Mapping[int | str, Trajectory]

    @classmethod
    def of(cls, demonstrations: DemonstrationSet, training: DemonstrationSet) -> Beginnings:
        """The motions of a set of demonstrations, held against those of another."""
        scene = demonstrations.environments
        assert scene is not None
        return cls(demonstrations.trajectories("human"), scene, demonstrations.groups, motions_of_groups(training))

    def seen(self, num_samples: int, hidden: Sequence[str] = ()) -> Trajectory:
        """The first samples, signals hidden from the observer masked."""
        return self.motions.first(num_samples).hide(hidden)

    def check_lengths(self, lengths: Sequence[int]) -> None:
        """Refuses beginnings after which a motion has no future to predict.

        Raises:
            InputError: a length outside the shortest motion.
        """
        shortest = int(self.motions.seen.sum(-1).amin())
        wrong = [length for length in lengths if not (isinstance(length, int) and 1 <= length < shortest)]
        if wrong:
            raise InputError(
                f"Expected samples_seen as integers from 1 to {shortest - 1}, which leaves every test motion a future, "
                f"got {wrong}."
            )

    def dtw(self, plans: Float[Tensor, "motions samples 2"]) -> Float[Tensor, ""]:
        """Summed Euclidean DTW cost of each plan to the training motions of its rectangle, mean over all, px."""
        total = plans.new_zeros(())
        for label, references in self.references.items():
            own = [i for i, group in enumerate(self.groups) if group == label]
            if own:
                total = total + dtw_to_motions(plans[own], references).sum()
        return total / len(self.groups)

    def success(self, plans: Float[Tensor, "motions samples 2"], bound: float) -> float:
        """Share of plans that pass over their rectangle."""
        return float(passed(plans, self.scene.value[:, 0], self.scene.value[:, 1], bound).double().mean())


def motions_of_groups(demonstrations: DemonstrationSet) -> dict[int | str, Trajectory]:
    """{group: its motions as one batch}."""
    members = {
        label: [i for i, group in enumerate(demonstrations.groups) if group == label] for label in demonstrations.groups
    }
    return {label: demonstrations.subset(index).trajectories("human") for label, index in members.items()}


def scored(
    methods: FittedMethods, test: Beginnings, method: str, num_samples: int, hidden: Sequence[str]
) -> tuple[Prediction, MotionScores]:
    """The prediction of one method after some samples, and its scores on what really followed."""
    observed = test.seen(num_samples, hidden)
    prediction = methods.predict(method, observed, test.scene, test.motions.time, test.motions.duration)
    return prediction, score(prediction, test.motions, observed.time[..., -1])


def table(
    methods: FittedMethods, test: Beginnings, names: Sequence[str], lengths: Sequence[int], bound: float
) -> Iterator[tuple[str, Mapping[str, float]]]:
    """("scenario/method/samples", scores) and ("gain/...", interval), row by row."""
    for scenario, hidden in SCENARIOS.items():
        for length in lengths:
            errors: dict[str, Tensor] = {}
            for method in names:
                prediction, scores = scored(methods, test, method, length, hidden)
                plans = prediction.plan(PLAN_SAMPLES).expand(len(test.groups), -1, -1)
                errors[method] = scores.motion_rmse
                extra = {"dtw": float(test.dtw(plans)), "success": test.success(plans, bound)}
                yield f"{scenario}/{method}/{length}", {**scores.summary(), **extra}
            for name, (baseline, method) in GAINS.items():
                if baseline in errors and method in errors:
                    gain = paired_gain(errors[baseline], errors[method], test.groups)
                    yield f"gain/{scenario}/{name}/{length}", {"mean": gain.mean, "low": gain.low, "high": gain.high}


def floor(test: Beginnings) -> Float[Tensor, ""]:
    """DTW distance of the real test motions to the training motions of their rectangle, mean over all, px."""
    costs = [
        dtw_to_motions(motion.values[motion.seen], test.references[group])
        for motion, group in zip((test.motions[i] for i in range(len(test.groups))), test.groups, strict=True)
    ]
    return torch.stack(costs).mean()


def summary(scores: Mapping[str, Mapping[str, float]], lengths: Sequence[int]) -> list[dict[str, Any]]:
    """Rows of a short table: rmse of each method against the samples seen, in both scenarios."""
    rows: dict[tuple[str, str], dict[str, Any]] = {}
    for name, row in scores.items():
        scenario, method, length = name.split("/")
        line = rows.setdefault((scenario, method), {"axes seen": scenario, "method": method})
        line[f"rmse (px) at {length}"] = row["rmse"]
        if int(length) == lengths[0]:
            line[f"DTW (px) at {length}"] = row["dtw"]
            line[f"pass at {length}"] = row["success"]
    return list(rows.values())


def feature_errors(
    methods: FittedMethods,
    test: Beginnings,
    levels: Sequence[float],
    noises: Sequence[float],
    generator: torch.Generator,
) -> Iterator[tuple[str, float]]:
    """("noise|bias/method/level/sigma_e", dtw) after 10 samples of both axes with errors in e, px (Fig. 7)."""
    observed = test.seen(10)
    draws = torch.randn(test.scene.value.shape, generator=generator, dtype=torch.float64)
    for kind, direction in {"noise": draws, "bias": torch.ones_like(draws)}.items():
        for level in levels:
            scene = EnvironmentFeatures(test.scene.names, test.scene.value + level * direction)
            for noise in noises:
                for name, predictor in {EAIP: methods.ours, PAPER_EAIP: methods.paper}.items():
                    # Rectangles far from the demonstrated ones are what is studied here.
                    with warnings.catch_warnings(action="ignore", category=ExtrapolationWarning):
                        prediction = predictor.with_noise(None, noise).predict(observed, scene, test.motions.time)
                    plans = prediction.plan(PLAN_SAMPLES)
                    yield f"{kind}/{name}/{level:g}/{noise:g}", float(test.dtw(plans))


def observation_noise(
    methods: FittedMethods,
    test: Beginnings,
    names: Sequence[str],
    levels: Sequence[float],
    generator: torch.Generator,
    num_samples: int = 50,
) -> Iterator[tuple[str, float]]:
    """("observation_noise/method/level", rmse) with noise of some px on the samples seen, both axes.

    The trajectories carry the sensor's covariance, as any sensor's specification would; only position evidence uses it.
    """
    observed = test.seen(num_samples)
    draws = torch.randn(observed.values.shape, generator=generator, dtype=torch.float64)
    for level in levels:
        sensor = level**2 * torch.eye(2, dtype=torch.float64).expand(num_samples, 2, 2)
        noisy = Trajectory(observed.time, observed.values + level * draws, observed.names, observed.mask, sensor)
        for method in names:
            prediction = methods.predict(method, noisy, test.scene, test.motions.time, test.motions.duration)
            result = score(prediction, test.motions, observed.time[..., -1]).summary()
            yield f"observation_noise/{method}/{level:g}", result["rmse"]


def paper_sigma(
    methods: FittedMethods, test: Beginnings, lengths: Sequence[int], factors: Sequence[float] = (0.1, 1.0, 10.0)
) -> Iterator[tuple[str, Mapping[str, float]]]:
    """("paper_sigma/method/factor/samples", scores): the published method with its chosen sigma times a factor."""
    fitted = methods.paper.fitted
    assert fitted is not None
    for factor in factors:
        predictor = methods.paper.with_noise(factor * fitted.noise)
        for length in lengths:
            observed = test.seen(length)
            for name, scene in {PAPER_IP: None, PAPER_EAIP: test.scene}.items():
                prediction = predictor.predict(observed, scene, test.motions.time)
                result = score(prediction, test.motions, observed.time[..., -1]).summary()
                dtw = float(test.dtw(prediction.plan(PLAN_SAMPLES)))
                yield f"paper_sigma/{name}/{factor:g}/{length}", {"rmse": result["rmse"], "dtw": dtw}


def novel_plans(
    methods: FittedMethods, task: PassingOver, num: int, generator: Callable[[int], torch.Generator]
) -> Iterator[tuple[tuple[float, float], Trajectory, Float[Tensor, "plans samples 2"]]]:
    """(size, beginnings, plans of `eaip` after 10 samples) for each rectangle that nobody demonstrated."""
    for number, (width, height) in enumerate(task.novel_sizes):
        motions = task.motions(width, height, num, generator(number))
        scene = EnvironmentFeatures(("width", "height"), torch.tensor([width, height], dtype=torch.float64))
        observed = motions.first(10)
        prediction = methods.ours.predict(observed, scene, motions.time)
        yield (width, height), observed, prediction.plan(PLAN_SAMPLES)


def decodable(demonstrations: DemonstrationSet, num_samples: int = 10) -> Mapping[str, float]:
    """R^2 of each feature from the first samples, whole rectangles left out."""
    scene = demonstrations.environments
    assert scene is not None
    beginnings = demonstrations.trajectories("human").first(num_samples).values.flatten(1)
    shares = explained(scene.value, beginnings, demonstrations.groups)
    return {name: float(share) for name, share in zip(scene.names, shares, strict=True)}

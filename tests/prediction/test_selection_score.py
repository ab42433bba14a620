from __future__ import annotations

from typing import Any

import numpy as np
import pytest
import torch
from scipy.stats import chi2, multivariate_normal, norm
from selection_world import BASIS, DURATION, FIXED, SAMPLES, demonstrations, deviation, fit

from eaip_prob.data.demonstrations import DemonstrationSet
from eaip_prob.held_out import SHARES_SEEN
from eaip_prob.models import GaussianJointModel, ShrinkageCovariance
from eaip_prob.selection import (
    DEFAULT_ENVIRONMENT_NOISE,
    DEFAULT_NOISE,
    ENVIRONMENT_MULTIPLES,
    NOISE_MULTIPLES,
)


class Slow:
    """The held-out scores of one fold by dense matrices, motion by motion.

    With the environment as a block the scenes that are asked for are given; without it (`blind`) there are none.
    """

    def __init__(
        self,
        motions: DemonstrationSet,
        test: list[int],
        estimator: ShrinkageCovariance = FIXED,
        scenes: tuple[bool, ...] = (False, True),
    ) -> None:
        train = [i for i in range(len(motions)) if i not in test]
        phase = torch.linspace(0, 1, SAMPLES, dtype=torch.float64)
        self.human = motions.trajectories("human").values[..., 0].numpy()
        self.robot = motions.trajectories("robot").values.numpy()
        scene = motions.environments
        assert scene is not None
        self.feature, self.num_scenes = scene.value.numpy(), len(train)
        self.rows = BASIS.design(phase)[0].numpy()
        blocks = [BASIS.encode(motions.trajectories(agent), phase, 1.0) for agent in ("human", "robot")]
        self.blind = scenes == (False,)
        weights = torch.cat([*blocks, scene.value[:, : not self.blind]], -1)[train]
        features = torch.arange(12, weights.shape[1])
        self.covariance = estimator.estimate(weights, [], torch.arange(4, 12), features).numpy()
        shown = np.einsum("tb,ndb->ntd", self.rows, blocks[1][train].reshape(-1, 2, 4).numpy())
        self.residual = np.maximum(((self.robot[train] - shown) ** 2).mean((0, 1)), 1e-300)
        self.mean, self.scenes = weights.mean(0).numpy(), scenes
        self.test = [test[int(place)] for place in np.linspace(0, len(test) - 1, min(len(test), 32)).round()]

    def prediction(
        self, i: int, seen: int, scene: bool, noise: float, scene_noise: float
    ) -> tuple[np.ndarray, np.ndarray, float]:
        """(mean, variance) (T, 2) and the log evidence."""
        design = np.zeros((seen + scene, len(self.mean)))
        design[:seen, :4] = self.rows[:seen]
        value, spread, growth = self.human[i, :seen], np.full(seen, noise**2), 1.0
        if scene:
            design[seen, 12] = 1.0
            value, spread = np.append(value, self.feature[i]), np.append(spread, scene_noise**2)
            away = (self.feature[i, 0] - self.mean[12]) ** 2 / (self.covariance[12, 12] + scene_noise**2)
            growth += away / self.num_scenes
        total = design @ self.covariance @ design.T + np.diag(spread)
        gain = self.covariance @ design.T @ np.linalg.inv(total)
        mean = self.mean + gain @ (value - design @ self.mean)
        covariance = self.covariance - gain @ design @ self.covariance
        matrix = np.kron(np.eye(2), self.rows)
        variance = np.einsum("ij,jk,ik->i", matrix, covariance[4:12, 4:12], matrix).reshape(2, -1).T + self.residual
        evidence = multivariate_normal.logpdf(value, design @ self.mean, total) if len(value) else 0.0
        return (matrix @ mean[4:12]).reshape(2, -1).T, growth * variance, evidence

    def scores(self, noise: float, scene_noise: float, scenes: tuple[bool, ...] | None = None) -> tuple[float, float]:
        """(log density of the future, log evidence)."""
        density, evidence = [], []
        for seen in beginnings():
            for scene in scenes or self.scenes:
                parts = [(i, *self.prediction(i, seen, scene, noise, scene_noise)) for i in self.test]
                logs = [norm.logpdf(self.robot[i], m, v**0.5)[seen:].mean() for i, m, v, _ in parts]
                density.append(np.mean(logs))
                evidence.append(np.mean([e for *_, e in parts]))
        return float(np.mean(density)), float(np.mean(evidence))

    def squares(self, noise: float, scene_noise: float) -> list[float]:
        """Squared standardised errors of all samples of the future."""
        result = []
        for seen in beginnings():
            for i in self.test:
                for scene in self.scenes:
                    mean, variance, _ = self.prediction(i, seen, scene, noise, scene_noise)
                    result.extend(((self.robot[i] - mean) ** 2 / variance)[seen:].ravel().tolist())
        return result


def beginnings() -> list[int]:
    time = np.linspace(0, DURATION, SAMPLES)
    return [int((time <= share * DURATION + 1e-12).sum()) for share in SHARES_SEEN]


def slow_climb(scores: list[float], start: int) -> int:
    """Uphill to the nearest peak, which the last place may overrule."""
    place = start
    while place > 0 and scores[place - 1] > scores[place] and scores[place - 1] >= max(scores[place : place + 2]):
        place -= 1
    while place < len(scores) - 1 and scores[place + 1] > scores[place]:
        place += 1
    return place if scores[place] >= scores[-1] else len(scores) - 1


def slow_folds(motions: DemonstrationSet, *arguments: Any) -> list[Slow]:
    groups = sorted(set(motions.groups))
    folds = [[i for i, group in enumerate(motions.groups) if group == one] for one in groups]
    return [Slow(motions, fold, *arguments) for fold in folds]


def slow_choice(motions: DemonstrationSet, kind: int, scenes: tuple[bool, ...]) -> tuple[float, float, float]:
    """(sigma, sigma_e, factor on variances)."""
    slow = slow_folds(motions, FIXED, scenes)
    scale, spread = deviation(motions)

    def score(noise: float, scene_noise: float, asked: tuple[bool, ...] | None = None) -> float:
        return float(np.mean([one.scores(noise, scene_noise, asked)[kind] for one in slow]))

    heard = [score(m * scale, DEFAULT_ENVIRONMENT_NOISE * spread) for m in NOISE_MULTIPLES]
    noise = NOISE_MULTIPLES[slow_climb(heard, NOISE_MULTIPLES.index(DEFAULT_NOISE))] * scale
    # Densities without the scene do not depend on sigma_e; those with it alone count.
    asked = (True,) if kind == 0 else None
    scene_noise = spread
    if scenes != (False,):
        scene_noise *= max(ENVIRONMENT_MULTIPLES, key=lambda m: score(noise, m * spread, asked))
    squares = np.concatenate([one.squares(noise, scene_noise) for one in slow])
    return noise, scene_noise, float(np.quantile(squares, 0.9, method="inverted_cdf") / chi2.ppf(0.9, 1))


@pytest.mark.parametrize(("criterion", "kind"), [("prediction", 0), ("evidence", 1)])
def test_choice_maximises_the_held_out_score(criterion: str, kind: int) -> None:
    motions = demonstrations(8)
    fitted = fit(motions, criterion=criterion)
    noise, scene_noise, inflation = slow_choice(motions, kind, (False, True))
    np.testing.assert_allclose(fitted.noise, [noise], rtol=1e-9)
    np.testing.assert_allclose(fitted.environment_noise, [scene_noise], rtol=1e-9)
    np.testing.assert_allclose(fitted.inflation, inflation, rtol=1e-6)


def test_thirty_two_motions_of_a_fold_are_scored() -> None:
    motions = demonstrations(80, seed=1)
    fitted = fit(motions, noise=0.3, environment_noise=5.0)
    squares = np.concatenate([one.squares(0.3, 5.0) for one in slow_folds(motions)])
    expected = np.quantile(squares, 0.9, method="inverted_cdf") / chi2.ppf(0.9, 1)
    np.testing.assert_allclose(fitted.inflation, expected, rtol=1e-6)


@pytest.mark.parametrize(("criterion", "kind"), [("prediction", 0), ("evidence", 1)])
def test_each_of_two_joints_has_choices_of_its_own(criterion: str, kind: int) -> None:
    motions = demonstrations(12, seed=4, groups=3)
    fitted = fit(motions, criterion=criterion, separate=True)
    for part, scenes in ((fitted, (True,)), (fitted.alone, (False,))):
        noise, scene_noise, inflation = slow_choice(motions, kind, scenes)
        assert part is not None and part.num_folds == 3
        np.testing.assert_allclose(part.noise, [noise], rtol=1e-9)
        np.testing.assert_allclose(part.inflation, inflation, rtol=1e-6)
        np.testing.assert_allclose(part.environment_noise, [scene_noise] if part is fitted else [], rtol=1e-9)


@pytest.mark.parametrize(("sensor", "num"), [(0.3, 8), (0.02, 20)])
def test_amount_maximises_the_held_out_density_at_the_default_noise(sensor: float, num: int) -> None:
    motions = demonstrations(num, sensor=sensor)
    fitted = fit(motions, model=GaussianJointModel(), recalibrate=False, criterion="evidence")
    scale, spread = deviation(motions)
    amounts = (0.001, 0.01, 0.1, 0.3, 0.6)
    density = [
        np.mean(
            [
                one.scores(DEFAULT_NOISE * scale, DEFAULT_ENVIRONMENT_NOISE * spread)[0]
                for one in slow_folds(motions, ShrinkageCovariance(amount))
            ]
        )
        for amount in amounts
    ]
    assert isinstance(fitted.model, GaussianJointModel)
    assert fitted.model.covariance == ShrinkageCovariance(amounts[int(np.argmax(density))])

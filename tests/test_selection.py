from __future__ import annotations

import dataclasses

import numpy as np
import pytest
import torch
from scipy.stats import chi2, multivariate_normal, norm

from eaip_prob.data.demonstrations import Demonstration, DemonstrationSet
from eaip_prob.data.environment import EnvironmentFeatures
from eaip_prob.data.trajectory import Trajectory
from eaip_prob.held_out import SHARES_SEEN
from eaip_prob.models import EmpiricalCovariance, GaussianJointModel, ShrinkageCovariance
from eaip_prob.phase import DTWClock, ElapsedClock, KnownPhase, MarginalClock
from eaip_prob.prediction import InteractionPredictor
from eaip_prob.primitives import ProMP
from eaip_prob.selection import (
    DEFAULT_ENVIRONMENT_NOISE,
    DEFAULT_NOISE,
    ENVIRONMENT_MULTIPLES,
    NOISE_MULTIPLES,
    _calibration,
    _Search,
)
from eaip_prob.training import Fitted, Training

BASIS, SAMPLES, DURATION = ProMP(num_basis=4), 12, 2.5
FIXED = ShrinkageCovariance(0.05)


def demonstrations(
    num: int, seed: int = 0, groups: int = 2, sensor: float = 0.3, tempo: float = 0.0, feature_noise: float = 0.5
) -> DemonstrationSet:
    """Both agents follow a hidden shape; one feature tells part of it."""
    generator = torch.Generator().manual_seed(seed)
    shape = torch.randn(num, 4, generator=generator, dtype=torch.float64)
    mixing = torch.randn(4, 8, generator=generator, dtype=torch.float64)
    robot = shape @ mixing + 0.3 * torch.randn(num, 8, generator=generator, dtype=torch.float64)
    noise = sensor * torch.randn(num, SAMPLES, 1, generator=generator, dtype=torch.float64)
    feature = 100.0 + 20.0 * (shape[:, 0] + feature_noise * torch.randn(num, generator=generator, dtype=torch.float64))
    length = torch.exp(tempo * torch.randn(num, generator=generator, dtype=torch.float64))
    phase = torch.linspace(0, 1, SAMPLES, dtype=torch.float64)
    result = []
    for i in range(num):
        time = phase * DURATION * length[i]
        human = Trajectory(time, BASIS.decode(6.0 * shape[i], phase) + noise[i], ("x",))
        scene = EnvironmentFeatures(("width",), feature[i, None])
        result.append(Demonstration(human, Trajectory(time, BASIS.decode(robot[i], phase), ("u", "v")), scene))
    return DemonstrationSet(result, [i * groups // num for i in range(num)])


def predictor(**arguments: object) -> InteractionPredictor:
    arguments = {"phase": ElapsedClock(), "model": GaussianJointModel(FIXED)} | arguments
    return InteractionPredictor(human=BASIS, robot=BASIS, **arguments)  # pyright: ignore[reportArgumentType]


def fit(motions: DemonstrationSet, **arguments: object) -> Fitted:
    fitted = predictor(**arguments).fit(motions).fitted
    assert fitted is not None
    return fitted


def deviation(motions: DemonstrationSet) -> tuple[float, float]:
    values, scene = motions.trajectories("human").values.numpy(), motions.environments
    assert scene is not None
    return float(values.std()), float(scene.value.numpy().std())


class Slow:
    """The held-out score of one fold by dense matrices, motion by motion."""

    def __init__(
        self,
        motions: DemonstrationSet,
        train: list[int],
        test: list[int],
        residual: np.ndarray,
        estimator: ShrinkageCovariance = FIXED,
    ) -> None:
        phase = torch.linspace(0, 1, SAMPLES, dtype=torch.float64)
        self.human = motions.trajectories("human").values[..., 0].numpy()
        self.robot = motions.trajectories("robot").values.numpy()
        scene = motions.environments
        assert scene is not None
        self.feature = scene.value.numpy()
        self.rows = BASIS.design(phase)[0].numpy()
        blocks = [BASIS.encode(motions.trajectories(agent), phase, 1.0) for agent in ("human", "robot")]
        weights = torch.cat([*blocks, scene.value], -1)[train]
        features = torch.tensor([12])
        self.covariance = estimator.estimate(weights, [], torch.arange(4, 12), features).numpy()
        self.mean, self.test, self.residual = weights.mean(0).numpy(), test, residual

    def prediction(
        self, i: int, seen: int, scene: bool, noise: float, scene_noise: float
    ) -> tuple[np.ndarray, np.ndarray, float]:
        """(mean, variance) (T, 2) and the log evidence."""
        design = np.zeros((seen + 1, 13))
        design[:seen, :4], design[seen, 12] = self.rows[:seen], 1.0
        value = np.append(self.human[i, :seen], self.feature[i])
        kept = slice(None if scene else seen)
        design, value = design[kept], value[kept]
        total = design @ self.covariance @ design.T + np.diag(np.append(np.full(seen, noise**2), scene_noise**2)[kept])
        gain = self.covariance @ design.T @ np.linalg.inv(total)
        mean = self.mean + gain @ (value - design @ self.mean)
        covariance = self.covariance - gain @ design @ self.covariance
        matrix = np.kron(np.eye(2), self.rows)
        variance = np.einsum("ij,jk,ik->i", matrix, covariance[4:12, 4:12], matrix).reshape(2, -1).T + self.residual
        evidence = multivariate_normal.logpdf(value, design @ self.mean, total)
        return (matrix @ mean[4:12]).reshape(2, -1).T, variance, evidence

    def scores(self, noise: float, scene_noise: float) -> tuple[float, float]:
        """(log density of the future, log evidence)."""
        density, evidence = [], []
        time = np.linspace(0, DURATION, SAMPLES)
        for share in SHARES_SEEN:
            seen = int((time <= share * DURATION + 1e-12).sum())
            for scene in (False, True):
                parts = [(i, *self.prediction(i, seen, scene, noise, scene_noise)) for i in self.test]
                logs = [norm.logpdf(self.robot[i], m, v**0.5)[seen:].mean() for i, m, v, _ in parts]
                density.append(np.mean(logs))
                evidence.append(np.mean([e for *_, e in parts]))
        return float(np.mean(density)), float(np.mean(evidence))

    def squares(self, noise: float, scene_noise: float) -> list[float]:
        """Squared standardised errors of all samples of the future."""
        result, time = [], np.linspace(0, DURATION, SAMPLES)
        for share in SHARES_SEEN:
            seen = int((time <= share * DURATION + 1e-12).sum())
            for i in self.test:
                for scene in (False, True):
                    mean, variance, _ = self.prediction(i, seen, scene, noise, scene_noise)
                    result.extend(((self.robot[i] - mean) ** 2 / variance)[seen:].ravel().tolist())
        return result


def slow_climb(scores: list[float], start: int) -> int:
    """Uphill to the nearest peak, which the last place may overrule."""
    place = start
    while place > 0 and scores[place - 1] > scores[place] and scores[place - 1] >= max(scores[place : place + 2]):
        place -= 1
    while place < len(scores) - 1 and scores[place + 1] > scores[place]:
        place += 1
    return place if scores[place] >= scores[-1] else len(scores) - 1


def slow_folds(motions: DemonstrationSet, residual: np.ndarray, estimator: ShrinkageCovariance = FIXED) -> list[Slow]:
    groups = sorted(set(motions.groups))
    folds = [[i for i, group in enumerate(motions.groups) if group == one] for one in groups]
    return [
        Slow(motions, [i for i in range(len(motions)) if i not in fold], fold, residual, estimator) for fold in folds
    ]


def slow_choice(motions: DemonstrationSet, residual: np.ndarray, kind: int) -> tuple[float, float, float]:
    slow = slow_folds(motions, residual)
    scale, spread = deviation(motions)

    def score(noise: float, scene_noise: float) -> np.ndarray:
        return np.mean([one.scores(noise, scene_noise) for one in slow], 0)

    heard = [float(score(m * scale, DEFAULT_ENVIRONMENT_NOISE * spread)[kind]) for m in NOISE_MULTIPLES]
    noise = NOISE_MULTIPLES[slow_climb(heard, NOISE_MULTIPLES.index(DEFAULT_NOISE))] * scale
    scene_noise = max(ENVIRONMENT_MULTIPLES, key=lambda m: score(noise, m * spread)[kind]) * spread
    squares = np.concatenate([one.squares(noise, scene_noise) for one in slow])
    return noise, scene_noise, float(np.quantile(squares, 0.9, method="inverted_cdf") / chi2.ppf(0.9, 1))


@pytest.mark.parametrize(("criterion", "kind"), [("prediction", 0), ("evidence", 1)])
def test_choice_maximises_the_held_out_score(criterion: str, kind: int) -> None:
    motions = demonstrations(8)
    fitted = fit(motions, criterion=criterion)
    noise, scene_noise, inflation = slow_choice(motions, fitted.residual.numpy(), kind)
    np.testing.assert_allclose(fitted.noise, [noise], rtol=1e-9)
    np.testing.assert_allclose(fitted.environment_noise, [scene_noise], rtol=1e-9)
    np.testing.assert_allclose(fitted.inflation, inflation, rtol=1e-6)


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
                for one in slow_folds(motions, fitted.residual.numpy(), ShrinkageCovariance(amount))
            ]
        )
        for amount in amounts
    ]
    assert isinstance(fitted.model, GaussianJointModel)
    assert fitted.model.covariance == ShrinkageCovariance(amounts[int(np.argmax(density))])


def test_amount_without_groups_and_a_given_one() -> None:
    for model, groups, amount in ((GaussianJointModel(), 1, 0.1), (GaussianJointModel(FIXED), 2, 0.05)):
        fitted = fit(demonstrations(8, groups=groups), model=model)
        assert isinstance(fitted.model, GaussianJointModel)
        assert fitted.model.covariance == ShrinkageCovariance(amount)


def test_clock_comes_first_with_the_middle_amount(monkeypatch: pytest.MonkeyPatch) -> None:
    asked: list[tuple[str, float | None]] = []
    density = _Search.density

    def noted(search: _Search) -> float:
        assert isinstance(search.model, GaussianJointModel) and isinstance(search.model.covariance, ShrinkageCovariance)
        asked.append((type(search.training.fitted.phase).__name__, search.model.covariance.amount))
        return density(search)

    monkeypatch.setattr(_Search, "density", noted)
    clocks = (ElapsedClock(), MarginalClock(num_durations=5))
    fit(demonstrations(24, sensor=0.05, tempo=0.25), phase=clocks, model=GaussianJointModel(), noise=0.05)
    clock = asked[2][0]
    assert asked[:2] == [("ElapsedClock", 0.1), ("MarginalClock", 0.1)]
    assert asked[2:] == [(clock, amount) for amount in (0.001, 0.01, 0.1, 0.3, 0.6)]


class Peaks:
    """A fold whose score at each multiple of sigma is given."""

    def __init__(self, scores: dict[float, float], scale: float) -> None:
        self.scores, self.scale, self.asked = scores, scale, list[float]()

    def score(self, noise: torch.Tensor, scene_noise: torch.Tensor, scene_only: bool = False) -> torch.Tensor:
        multiple = min(NOISE_MULTIPLES, key=lambda m: abs(m - float(noise) / self.scale))
        self.asked.append(multiple)
        return torch.tensor(self.scores[multiple], dtype=torch.float64)


def climbed(*scores: float) -> tuple[float, list[float]]:
    training = Training(demonstrations(2), {}, None, {}, None, {}, None)  # pyright: ignore[reportArgumentType]
    fold = Peaks(dict(zip(NOISE_MULTIPLES, scores, strict=True)), 40.0)
    scale, none = torch.tensor([40.0], dtype=torch.float64), torch.zeros(0, dtype=torch.float64)
    search = _Search(predictor(), training, GaussianJointModel(), [fold], scale, none)  # pyright: ignore[reportArgumentType]
    return search._climbed(none), fold.asked


def test_climb_finds_a_peak_at_either_end() -> None:
    assert climbed(9, 8, 7, 6, 5, 4, 3, 2, 1, 0)[0] == 0.002
    assert climbed(0, 1, 2, 3, 4, 5, 6, 7, 8, 9)[0] == 10.0
    assert climbed(0, 1, 2, 3, 4, 9, 6, 5, 4, 3)[0] == 0.1
    assert climbed(0, 1, 2, 9, 4, 3, 2, 1, 1, 1)[0] == 0.02


def test_climb_takes_not_listening_where_it_is_better_still() -> None:
    assert climbed(0, 1, 2, 5, 4, 3, 2, 3, 6, 8)[0] == 10.0
    assert climbed(0, 1, 2, 5, 4, 3, 2, 3, 4, 4.9)[0] == 0.02
    assert climbed(0, 1, 2, 5, 4, 3, 2, 3, 9, 4)[0] == 0.02


def test_climb_asks_for_each_score_once_and_stops_at_a_plateau() -> None:
    chosen, asked = climbed(0, 7, 7, 7, 7, 1, 1, 1, 1, 1)
    assert chosen == 0.02 and sorted(asked) == [0.01, 0.02, 0.05, 10.0]
    chosen, asked = climbed(0, 1, 2, 3, 4, 5, 6, 5, 4, 3)
    assert chosen == 0.3 and len(asked) == len(set(asked)) and set(asked) == {0.01, 0.02, 0.05, 0.1, 0.3, 1.0, 10.0}


@pytest.mark.parametrize("num", [1, 9, 10, 11, 999])
def test_calibration_is_the_quantile_over_that_of_chi_square(num: int) -> None:
    squares = torch.randn(num, generator=torch.Generator().manual_seed(0), dtype=torch.float64).square() * 7.0
    expected = np.quantile(squares.numpy(), 0.9, method="inverted_cdf") / chi2.ppf(0.9, 1)
    assert _calibration(squares) == pytest.approx(expected, rel=1e-9)


def test_calibrated_intervals_hold_nine_of_ten_held_out_samples() -> None:
    squares = torch.arange(1.0, 101.0, dtype=torch.float64)
    half = norm.ppf(0.95) ** 2 * _calibration(squares)
    assert int((squares <= half * (1 + 1e-9)).sum()) == 90


def test_calibration_of_nothing_of_no_error_and_of_a_motion_far_off() -> None:
    assert _calibration(torch.zeros(0, dtype=torch.float64)) == 1.0
    assert _calibration(torch.zeros(30, dtype=torch.float64)) == 1e-3
    squares = torch.linspace(0.1, 3.0, 100, dtype=torch.float64)
    far = torch.where(torch.arange(100) < 95, squares, 1e6)
    assert _calibration(far) == _calibration(squares)


def test_noise_follows_the_sensor() -> None:
    loud, quiet = (
        fit(demonstrations(16, sensor=sensor), criterion="evidence", environment_noise=5.0) for sensor in (1.0, 0.05)
    )
    assert float(loud.noise) > 3 * float(quiet.noise)


def test_given_noise_is_kept() -> None:
    fitted = fit(demonstrations(8), noise=0.123, environment_noise=[4.5])
    assert fitted.noise.tolist() == [0.123]
    assert fitted.environment_noise.tolist() == [4.5]
    assert fitted.inflation != 1.0
    one = fit(demonstrations(8), noise=0.123)
    assert one.noise.tolist() == [0.123] and float(one.environment_noise) in [
        pytest.approx(multiple * deviation(demonstrations(8))[1]) for multiple in ENVIRONMENT_MULTIPLES
    ]


def test_one_group_takes_the_defaults() -> None:
    motions = demonstrations(8, groups=1)
    fitted = fit(motions)
    scale, spread = deviation(motions)
    np.testing.assert_allclose(fitted.noise, [DEFAULT_NOISE * scale], rtol=1e-9)
    np.testing.assert_allclose(fitted.environment_noise, [DEFAULT_ENVIRONMENT_NOISE * spread], rtol=1e-9)
    assert fitted.inflation == 1.0


def test_units_do_not_matter() -> None:
    motions = demonstrations(8)
    other = []
    for one in motions:
        assert one.human is not None and one.robot is not None and one.environment is not None
        human = dataclasses.replace(one.human, values=one.human.values * 1000.0)
        robot = dataclasses.replace(one.robot, values=one.robot.values * 1e-3)
        other.append(Demonstration(human, robot, EnvironmentFeatures(("width",), one.environment.value * 50.0)))
    before, after = fit(motions), fit(DemonstrationSet(other, motions.groups))
    torch.testing.assert_close(after.noise, before.noise * 1000.0, rtol=1e-9, atol=0)
    torch.testing.assert_close(after.environment_noise, before.environment_noise * 50.0, rtol=1e-9, atol=0)
    np.testing.assert_allclose(after.inflation, before.inflation, rtol=1e-6)


def test_inflation_is_one_where_the_model_is_right() -> None:
    model = GaussianJointModel(EmpiricalCovariance())
    fitted = fit(demonstrations(160, sensor=0.01, feature_noise=0.0), noise=0.01, environment_noise=0.0, model=model)
    # 160 motions with 8 degrees of freedom each leave sqrt(2 / 1280) = 4 %; half of them train: 13 / 80 = 16 % more.
    assert 0.9 < fitted.inflation < 1.35


def test_inflation_grows_with_over_confidence() -> None:
    model = GaussianJointModel(EmpiricalCovariance())
    fitted = fit(demonstrations(16, sensor=0.01), noise=0.01, environment_noise=0.5, model=model)
    assert fitted.inflation > 2.0
    assert fit(demonstrations(16), noise=0.01, recalibrate=False).inflation == 1.0


def test_features_that_were_missed_do_not_widen_the_spread() -> None:
    motions = demonstrations(9, groups=1)
    part = []
    for i, one in enumerate(motions):
        assert one.environment is not None
        seen = torch.tensor([i % 3 != 0])
        part.append(dataclasses.replace(one, environment=dataclasses.replace(one.environment, observed=seen)))
    values = [float(one.environment.value) for i, one in enumerate(motions) if i % 3 and one.environment]
    fitted = fit(DemonstrationSet(part, motions.groups))
    np.testing.assert_allclose(fitted.environment_noise, [DEFAULT_ENVIRONMENT_NOISE * np.std(values)], rtol=1e-9)


def test_what_does_not_vary_still_has_noise() -> None:
    given, motions = demonstrations(6), []
    for one in given:
        assert one.human is not None
        still = dataclasses.replace(one.human, values=torch.full_like(one.human.values, 0.7))
        motions.append(dataclasses.replace(one, human=still, environment=EnvironmentFeatures(("width",), [0.0])))
    fitted = fit(DemonstrationSet(motions, given.groups))
    assert float(fitted.noise) > 1e-6 and float(fitted.environment_noise) > 1e-6
    assert np.isfinite(fitted.inflation)


def test_constant_signal_of_the_robot_leaves_the_calibration_alone() -> None:
    motions, still = demonstrations(10), []
    for one in motions:
        assert one.robot is not None
        values = torch.cat([one.robot.values, torch.zeros(SAMPLES, 1, dtype=torch.float64)], -1)
        still.append(dataclasses.replace(one, robot=Trajectory(one.robot.time, values, ("u", "v", "w"))))
    given = {"noise": 0.3, "environment_noise": 5.0}
    before, after = fit(motions, **given), fit(DemonstrationSet(still, motions.groups), **given)
    np.testing.assert_allclose(after.inflation, before.inflation, rtol=1e-6)


def test_clock_is_chosen_by_the_future_of_the_target() -> None:
    clocks = (ElapsedClock(), MarginalClock(num_durations=7))
    given = {"phase": clocks, "noise": 0.05, "environment_noise": 5.0}
    steady = demonstrations(24, sensor=0.05, tempo=0.25)
    assert isinstance(fit(steady, **given).phase, MarginalClock)
    assert isinstance(fit(demonstrations(24, sensor=0.05, groups=1), **given).phase, ElapsedClock)
    assert isinstance(fit(demonstrations(24, sensor=0.05), **given).phase, ElapsedClock)
    assert isinstance(fit(demonstrations(24, sensor=0.05), **given | {"phase": clocks[::-1]}).phase, MarginalClock)


def test_only_clock_is_kept() -> None:
    for clock in (MarginalClock(num_durations=5), DTWClock(num_samples=20), KnownPhase()):
        assert isinstance(
            fit(demonstrations(6, tempo=0.1), phase=clock, noise=0.3, environment_noise=5.0).phase, type(clock)
        )

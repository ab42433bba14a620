from __future__ import annotations

import math

import pytest
import torch

from eaip_prob.data import Demonstration, DemonstrationSet, EnvironmentFeatures, Trajectory
from eaip_prob.errors import InputError
from eaip_prob.evaluation import Gain
from eaip_prob.evidence import ForcingEvidence
from eaip_prob.methods import EAIP, ENVIRONMENT, IP, MEAN, METHODS, PAPER_EAIP, PAPER_IP, FittedMethods, MotionScores
from eaip_prob.models import EmpiricalCovariance, GaussianJointModel
from eaip_prob.phase import DTWClock, ElapsedClock
from eaip_prob.prediction import InteractionPredictor
from eaip_prob.primitives import DMP, ProMP
from eaip_prob.tasks.recorded import Measured, Study, beginning, consecutive_folds, measured, report, studied

NAMES = ("h1", "h2")


def people(num: int = 24, seed: int = 0, duration: float = 1.7) -> DemonstrationSet:
    """Ragged motions in which the robot follows the human and the environment sets where both end."""
    generator = torch.Generator().manual_seed(seed)
    made = []
    for _ in range(num):
        tempo, height, bend = torch.randn(3, generator=generator, dtype=torch.float64).tolist()
        span = duration * math.exp(0.15 * tempo)
        time = -0.3 + torch.arange(0.0, span, 0.05, dtype=torch.float64)
        s = (time + 0.3) / span
        rise = s.square() * (3 - 2 * s)
        human = torch.stack([40.0 + 9.0 * bend * s, (20.0 + 5.0 * height) * rise], -1)
        robot = (100.0 + (30.0 + 8.0 * height) * rise + 6.0 * bend * s)[:, None]
        noise = 0.2 * torch.randn(len(time), 3, generator=generator, dtype=torch.float64)
        made.append(
            Demonstration(
                Trajectory(time, human + noise[:, :2], NAMES),
                Trajectory(time, robot + noise[:, 2:], ("grip",)),
                EnvironmentFeatures(("size",), [0.05 + 0.01 * height]),
            )
        )
    return DemonstrationSet(made, [f"p{i % 6}" for i in range(num)])


def ours() -> InteractionPredictor:
    return InteractionPredictor(
        ProMP(num_basis=6), DMP(num_basis=5), ElapsedClock(), noise=0.5, environment_noise=0.001, recalibrate=False
    )


def paper() -> InteractionPredictor:
    dmp = DMP(num_basis=6, boundary="given")
    model = GaussianJointModel(covariance=EmpiricalCovariance(), environment="regression")
    return InteractionPredictor(
        dmp,
        dmp,
        DTWClock(num_samples=60),
        ForcingEvidence(),
        model,
        noise=300.0,
        environment_noise=0.001,
        criterion="evidence",
        num_samples=60,
        recalibrate=False,
    )


@pytest.fixture(scope="module")
def methods() -> FittedMethods:
    return FittedMethods.fit(ours(), paper(), people(), torch.Generator().manual_seed(0))


def test_folds_are_disjoint_whole_groups_in_order() -> None:
    demonstrations = people(11)
    folds = consecutive_folds(demonstrations, 3)
    assert sorted(place for fold in folds for place in fold.places) == list(range(11))
    assert [sorted(set(fold.test.groups)) for fold in folds] == [["p0", "p1"], ["p2", "p3"], ["p4", "p5"]]
    for fold in folds:
        assert not set(fold.training.groups) & set(fold.test.groups)
        assert [demonstrations[place] for place in fold.places] == list(fold.test)


def test_folds_sort_numbers_as_numbers() -> None:
    still = Trajectory([0.0, 1.0], [[0.0], [0.0]])
    demonstrations = DemonstrationSet([Demonstration(still)] * 5, [10, 9, 2, 11, 1])
    assert [fold.test.groups for fold in consecutive_folds(demonstrations, 2)] == [(2, 1), (10, 9, 11)]


@pytest.mark.parametrize("num_folds", [1, 7])
def test_impossible_folds_are_refused(num_folds: int) -> None:
    with pytest.raises(InputError, match="num_folds from 2 to the 6 groups"):
        consecutive_folds(people(6), num_folds)


@pytest.mark.parametrize("percent", [23, 47, 81])
def test_each_motion_is_cut_at_its_own_duration(percent: int) -> None:
    demonstrations = people(5)
    human = demonstrations.trajectories("human")
    seen, cut = beginning(human, percent)
    assert seen.mask.any((0, 2))[-1]
    for number, demonstration in enumerate(demonstrations):
        own = demonstration.human
        assert own is not None
        until = -0.3 + percent / 100 * float(own.time[-1] + 0.3)
        inside = own.time <= until
        assert float(cut[number]) == pytest.approx(until)
        assert int(seen.mask[number].all(-1).sum()) == int(inside.sum())
        assert torch.equal(seen.values[number][seen.mask[number].all(-1)], own.values[inside])


@pytest.mark.parametrize("percent", [0, 100])
def test_impossible_percentages_are_refused(percent: int) -> None:
    with pytest.raises(InputError, match="percentage above 0 and below 100"):
        beginning(people(2).trajectories("human"), percent)


# A force needs the sample after it, so that in a batch the published method sees one force less of shorter beginnings.
@pytest.mark.parametrize("name", [name for name in METHODS if name not in (PAPER_IP, PAPER_EAIP)])
def test_a_batch_of_ragged_beginnings_is_each_motion_alone(methods: FittedMethods, name: str) -> None:
    test = people(4, seed=1)
    together = measured(methods, test, [name], [31])[name, 31]
    for number, demonstration in enumerate(test):
        alone = measured(methods, DemonstrationSet([demonstration]), [name], [31])[name, 31]
        assert float(alone.scores.nll[0]) == pytest.approx(float(together.scores.nll[number]), rel=1e-5)
        assert float(alone.scores.squared_error[0]) == pytest.approx(
            float(together.scores.squared_error[number]), rel=1e-5
        )


def test_only_what_follows_the_cut_is_scored(methods: FittedMethods) -> None:
    test = people(3, seed=2)
    count = sum(int((d.robot.time > -0.3 + 0.47 * (d.robot.time[-1] + 0.3)).sum()) for d in test if d.robot is not None)
    result = measured(methods, test, [EAIP], [47])[EAIP, 47]
    assert len(result.pit) == count
    inside = ((result.pit >= 0.05) & (result.pit <= 0.95)).double()
    assert 0.0 <= float(inside.mean()) <= 1.0
    assert len(result.scores.nll) == 3


def test_folds_never_see_their_test_motions_and_come_back_in_order() -> None:
    demonstrations = people(18)
    fitted_to: list[set[int | str]] = []

    def fit(training: DemonstrationSet) -> FittedMethods:
        fitted_to.append(set(training.groups))
        return FittedMethods.fit(ours(), paper(), training, torch.Generator().manual_seed(0))

    folds = consecutive_folds(demonstrations, 2)
    study = studied(demonstrations, folds, fit, (MEAN, EAIP), (50,), [7, 0])
    assert fitted_to == [{"p3", "p4", "p5"}, {"p0", "p1", "p2"}]
    assert study.groups == folds[0].test.groups + folds[1].test.groups
    assert [example.motion for example in study.examples] == [demonstrations[7], demonstrations[0]]
    assert len(study.results[EAIP, 50].scores.nll) == 18
    assert study.methods == [MEAN, EAIP] and study.percents == [50]


def made_study(errors: dict[str, list[float]], groups: list[str]) -> Study:
    results = {}
    for name, values in errors.items():
        error = torch.tensor(values, dtype=torch.float64)
        scores = MotionScores(error.square(), torch.ones_like(error), torch.full_like(error, 0.9))
        results[name, 20] = Measured(scores, torch.tensor([0.5], dtype=torch.float64))
    return Study(results, tuple(groups), (), ())


def test_gains_average_motions_within_groups_first() -> None:
    study = made_study({MEAN: [5.0, 5.0, 5.0], IP: [4.0, 2.0, 5.0]}, ["a", "a", "b"])
    gain = study.gains()["ip_over_mean", 20]
    assert gain.mean == pytest.approx((2.0 + 0.0) / 2) and gain.num_groups == 2
    assert set(study.gains()) == {("ip_over_mean", 20)}


def test_metrics_have_flat_keys_and_pooled_errors() -> None:
    study = made_study({ENVIRONMENT: [3.0, 1.0], EAIP: [1.0, 1.0], PAPER_EAIP: [7.0, 1.0]}, ["a", "b"])
    metrics = study.metrics()
    assert metrics["rmse/environment/20"] == pytest.approx(math.sqrt(5.0))
    assert metrics["gain/eaip_over_environment/20/mean"] == pytest.approx(1.0)
    assert {"nll/eaip/20", "coverage90/eaip/20", "gain/eaip_over_paper_eaip/20/high"} <= set(metrics)
    assert all(math.isfinite(value) for value in metrics.values())


@pytest.mark.parametrize(
    ("gain", "words"),
    [
        (Gain(1.5, 0.5, 2.5, 6), "helps: rmse changes by -1.5 px (-2.5 to -0.5)"),
        (Gain(-1.5, -2.5, -0.5, 6), "does harm: rmse changes by +1.5 px (+0.5 to +2.5)"),
        (Gain(0.5, -1.0, 2.0, 6), "does not help here as far as can be told: rmse changes by -0.5 px (-2 to +1)"),
    ],
)
def test_verdicts_say_which_side_of_zero(gain: Gain, words: str) -> None:
    assert words in report.verdicts({("ip_over_mean", 20): gain}, "px")

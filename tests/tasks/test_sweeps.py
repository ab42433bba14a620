from __future__ import annotations

import math

import pytest
import torch

from eaip_prob.config import build
from eaip_prob.errors import InputError
from eaip_prob.recording import NullLogger
from eaip_prob.tasks.passing_over import PassingOver, passed
from eaip_prob.tasks.sweeps import charts, few_demonstrations, timing
from eaip_prob.tasks.sweeps.measuring import changed, measured, scattered

PREDICTOR = {
    "_target_": "eaip_prob.prediction.InteractionPredictor",
    "target": "human",
    "phase": {"_target_": "eaip_prob.phase.ElapsedClock"},
    "noise": 2.0,
    "environment_noise": 5.0,
}
TASK = {
    "_target_": "eaip_prob.tasks.passing_over.PassingOver",
    "rate": 50.0,
    "person": {"_target_": "eaip_prob.tasks.passing_over.CursorPerson"},
}
TIMING = {
    "predictor": PREDICTOR,
    "task": TASK,
    "tempo": {"dependent": 0.9, "independent": 0.0},
    "log_sd": [0, 0.25],
    "clocks": {"marginal": {"_target_": "eaip_prob.phase.MarginalClock"}, "default": None},
    "num_train": 2,
    "num_test": 1,
    "percent_seen": [20, 80],
    "seed": 4,
}
FEW = {
    "predictor": PREDICTOR,
    "task": TASK,
    "num_demonstrations": [5, 12],
    "repetitions": 2,
    "num_test": 4,
    "lengths": [125, 325],
    "percent_seen": [20, 80],
    "seed": 4,
    "variants": {"eaip": {}, "eaip_marginal": {"phase": {"_target_": "eaip_prob.phase.MarginalClock"}}},
    "panels": {"clocks": ["mean", "eaip", "eaip_marginal"]},
}


@pytest.mark.slow
def test_scores_are_those_of_each_motion_alone() -> None:
    task = build(TASK)
    training, test = (scattered(task, num, (150.0, 300.0), 1, stream) for num, stream in ((8, 1), (3, 0)))
    found = measured(PREDICTOR, training, test, ("mean", "environment", "ip", "eaip"), [30])
    fitted = build(PREDICTOR).fit(training)
    for method in ("mean", "environment", "ip", "eaip"):
        squares, inside = [], []
        for motion in test:
            human = motion.human
            count = int((human.time <= 0.3 * human.time[-1]).sum())
            seen = human.first(count)
            seen = seen.hide(seen.names) if method in ("mean", "environment") else seen
            scene = motion.environment if method in ("environment", "eaip") else None
            prediction = fitted.predict(seen, scene, human.time[count:])
            future = human.values[count:]
            squares.append(float((prediction.mean - future).square().mean()))
            low, high = prediction.interval(0.9)
            inside.append(float(((low <= future) & (future <= high)).double().mean()))
        assert found[f"rmse/{method}/30"] == pytest.approx(math.sqrt(sum(squares) / 3), rel=1e-6)
        assert found[f"coverage90/{method}/30"] == pytest.approx(sum(inside) / 3, abs=1e-9)


def test_unknown_methods_are_refused() -> None:
    motions = scattered(build(TASK), 3, (150.0, 300.0), 0, 0)
    with pytest.raises(InputError, match=r"methods among.*got \['paper_ip'\]"):
        measured(PREDICTOR, motions, motions, ["paper_ip"], [50])


def test_scattered_rectangles() -> None:
    many, fewer = (scattered(PassingOver(), num, (140.0, 300.0), 3, 1) for num in (60, 7))
    scene = many.environments
    assert scene is not None and scene.names == ("width", "height") and many.groups == tuple(range(60))
    low, high, mean = scene.value.amin(), scene.value.amax(), scene.value.mean(0)
    assert 140.0 <= float(low) < 155.0 and 285.0 < float(high) <= 300.0
    assert float((mean - 220.0).abs().max()) < 4 * 160.0 / (12 * 60) ** 0.5
    human = many.trajectories("human")
    width, height = scene.value.unbind(-1)
    assert bool(passed(human.values, width, height, 160.0, human.seen).all())
    for one, other in zip(many, fewer, strict=False):
        assert torch.equal(one.human.values, other.human.values)
    assert not bool((scattered(PassingOver(), 7, (140.0, 300.0), 3, 2).environments.value == scene.value[:7]).any())


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ((0, (1.0, 2.0), 0, 0), "num as an integer of at least 1"),
        ((1, (2.0, 1.0), 0, 0), "smallest, largest"),
        ((1, (0.0, 1.0), 0, 0), "smallest, largest"),
        ((1, (1.0, 2.0), -1, 0), "seed"),
        ((1, (1.0, 2.0), 0, -1), "stream"),
    ],
)
def test_scattered_refuses(arguments, message) -> None:
    with pytest.raises(InputError, match=message):
        scattered(PassingOver(), *arguments)


def test_parts_are_replaced_whole_and_nothing_else() -> None:
    replaced = changed(PREDICTOR, {"phase": {"_target_": "eaip_prob.phase.MarginalClock"}})
    assert replaced["phase"] == {"_target_": "eaip_prob.phase.MarginalClock"} and replaced["noise"] == 2.0
    assert PREDICTOR["phase"] == {"_target_": "eaip_prob.phase.ElapsedClock"}


def test_parts_of_timing() -> None:
    parts = {part.name: part.config for part in timing.parts(TIMING)}
    assert len(parts) == 8 and "dependent-marginal-0.25" in parts
    one = parts["dependent-marginal-0.25"]
    person = one["task"]["person"]
    assert (person["tempo_sd"], person["tempo_dependence"]) == (0.25, 0.9)
    assert one["predictor"]["phase"] == TIMING["clocks"]["marginal"]
    assert parts["independent-default-0"]["predictor"]["phase"] == PREDICTOR["phase"]
    assert TASK["person"] == {"_target_": "eaip_prob.tasks.passing_over.CursorPerson"}
    assert len({part.fingerprint for part in timing.parts(TIMING)}) == 8


def test_every_setting_is_part_of_the_fingerprint() -> None:
    changes = {"num_train": 3, "num_test": 2, "percent_seen": [50], "seed": 5}
    for settings in [TIMING | {name: value} for name, value in changes.items()]:
        pairs = zip(timing.parts(TIMING), timing.parts(settings), strict=True)
        assert all(one.name == other.name and one.fingerprint != other.fingerprint for one, other in pairs)
    changes = {"num_test": 5, "percent_seen": [50], "seed": 5, "lengths": [125, 300], "task": TASK | {"rate": 25.0}}
    for settings in [FEW | {name: value} for name, value in changes.items()]:
        pairs = zip(few_demonstrations.parts(FEW), few_demonstrations.parts(settings), strict=True)
        assert all(one.name == other.name and one.fingerprint != other.fingerprint for one, other in pairs)


def _results_of_timing() -> dict[str, dict[str, float]]:
    return {
        condition.name: {
            f"{score}/{method}/{percent}": 10.0 * place + number + 0.01 * percent
            for score in ("rmse", "nll", "coverage90")
            for number, method in enumerate(("eaip", "mean", "environment", "ip"), start=1)
            for percent in (20, 80)
        }
        for place, condition in enumerate(timing.conditions(TIMING))
    }


def test_metrics_and_charts_of_timing() -> None:
    results = _results_of_timing()
    metrics = timing.metrics(TIMING, results)
    assert len(metrics) == 8 * 3 * 4 * 2
    assert metrics["nll/independent/default/0.25/80"] == results["independent-default-0.25"]["nll/eaip/80"]
    assert metrics["rmse/dependent/marginal/0/20/ip"] == results["dependent-marginal-0"]["rmse/ip/20"]
    shown = {chart.name: chart for chart in timing.charts(TIMING, metrics, [20, 80])}
    assert list(shown) == ["rmse", "nll", "coverage90", "ratio"]
    panel = shown["rmse"].panels["independent, 80 % seen"]
    assert panel["default"] == {x: metrics[f"rmse/independent/default/{x:g}/80"] for x in (0.0, 0.25)}
    key = "rmse/dependent/marginal/0.25/20"
    ratio = shown["ratio"].panels["dependent, 20 % seen"]["marginal"][0.25]
    assert ratio == pytest.approx(metrics[key] / metrics[f"{key}/environment"])
    text = timing.report(TIMING, metrics)
    assert "80 % seen" in text and text.count("| dependent ") == 6 and "| 0.25 |" in text


def _results_of_few() -> dict[str, dict[str, float]]:
    return {
        f"{variant}-{num}-{repetition}": {
            f"{score}/{role}/{percent}": base + repetition + (1.0 if percent == 20 else 7.0)
            for score in ("rmse", "nll", "coverage90")
            for role, base in (("eaip", 0.0), ("mean", 1.0), ("environment", 2.0), ("ip", 3.0))
            for percent in (20, 80)
        }
        for variant in ("eaip", "eaip_marginal")
        for num in (5, 12)
        for repetition in (0, 1)
    }


def test_summaries_average_over_cuts_and_repetitions() -> None:
    results = _results_of_few()
    results["eaip_marginal-12-1"]["nll/eaip/80"] = 108.0
    summary = few_demonstrations.summaries(FEW, results)
    metrics = few_demonstrations.metrics(summary)
    assert len(metrics) == 3 * 3 * 5 * 2
    first, second = math.sqrt((1.0 + 49.0) / 2), math.sqrt((4.0 + 64.0) / 2)
    assert metrics["rmse/eaip/12"] == pytest.approx((first + second) / 2)
    assert metrics["rmse/mean/12"] == pytest.approx((second + math.sqrt((9.0 + 81.0) / 2)) / 2)
    assert metrics["nll/ip/5"] == pytest.approx(7.5) and metrics["nll/eaip/5"] == pytest.approx(4.5)
    assert metrics["nll/eaip_marginal/12"] == pytest.approx((4.0 + 55.0) / 2)
    reach = 12.7062047 * 0.5  # t quantile of one degree of freedom times the standard error of 4 and 5
    assert metrics["nll/eaip/5/low"] == pytest.approx(4.5 - reach, rel=1e-6)
    assert metrics["nll/eaip/5/high"] == pytest.approx(4.5 + reach, rel=1e-6)
    (chart,) = (chart for chart in few_demonstrations.charts(FEW, summary) if chart.name == "nll")
    assert chart.panels == {
        "clocks": {name: {n: metrics[f"nll/{name}/{n}"] for n in (5, 12)} for name in FEW["panels"]["clocks"]}
    }
    assert chart.bands["clocks"]["eaip"][5] == (metrics["nll/eaip/5/low"], metrics["nll/eaip/5/high"])


def test_one_repetition_has_no_interval() -> None:
    settings = FEW | {"repetitions": 1}
    summary = few_demonstrations.summaries(settings, _results_of_few())
    metrics = few_demonstrations.metrics(summary)
    assert set(metrics) == {
        f"{score}/{name}/{num}"
        for score in ("rmse", "nll", "coverage90")
        for name in ("mean", "environment", "ip", "eaip", "eaip_marginal")
        for num in (5, 12)
    }
    assert all(not any(chart.bands["clocks"].values()) for chart in few_demonstrations.charts(settings, summary))


@pytest.mark.parametrize("variants", [{"eaip_raw": {}}, {"eaip": {}, "ip": {}}])
def test_variants_that_collide_are_refused(variants) -> None:
    with pytest.raises(InputError, match="variants with 'eaip' among them and none called"):
        few_demonstrations.parts(FEW | {"variants": variants})


def test_repetitions_and_numbers_are_different_and_nested() -> None:
    seen = []
    for part in few_demonstrations.parts(FEW):
        config = part.config
        seen.append((config["num"], config["repetition"], len(config["methods"])))
    assert seen == [(num, rep, count) for rep in (0, 1) for num in (5, 12) for count in (4, 1)]


@pytest.mark.slow
def test_charts_are_drawn_and_recorded(tmp_path) -> None:
    summary = few_demonstrations.summaries(FEW, _results_of_few())
    shown = [*few_demonstrations.charts(FEW, summary)]
    charts.draw(tmp_path / "few", shown)
    metrics = timing.metrics(TIMING, _results_of_timing())
    charts.draw(tmp_path / "timing", timing.charts(TIMING, metrics, [20, 80]))
    drawn = [{path.stem for path in (tmp_path / name / "figures").glob("*.png")} for name in ("few", "timing")]
    assert drawn == [{"rmse", "nll", "coverage90"}, {"rmse", "nll", "coverage90", "ratio"}]
    charts.record(NullLogger(), shown, "report")
    charts.record(NullLogger(), timing.charts(TIMING, metrics, [20]), "report", scale=100.0)

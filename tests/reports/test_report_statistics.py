from __future__ import annotations

import math

import numpy as np
import pytest
import torch
from scipy import stats
from sweep_world import leave_run, leave_sweep

from eaip_prob.errors import InputError
from eaip_prob.evaluation import paired_gain
from eaip_prob.reports import Run, read_runs, section, sections, seed_interval


def run(model: str, seed: int, **metrics: float) -> Run:
    return Run(f"{model}{seed}", "finished", "x", {"model": model, "seed": seed}, (f"model={model}",), metrics)


@pytest.mark.parametrize("count", [2, 3, 10, 40])
def test_an_interval_is_that_of_scipy_and_of_a_paired_gain(count):
    values = np.random.default_rng(count).normal(300.0, 0.5, count)
    found = seed_interval(values.tolist())
    low, high = stats.t.interval(0.95, count - 1, values.mean(), stats.sem(values))
    assert (found.mean, found.low, found.high) == pytest.approx((values.mean(), low, high), rel=1e-12)
    sample = torch.tensor(values)
    gain = paired_gain(sample, torch.zeros_like(sample), range(count))
    assert (found.low, found.high) == pytest.approx((gain.low, gain.high), rel=1e-12)
    assert found.num_seeds == count


def test_95_of_100_intervals_hold_the_mean():
    draws = np.random.default_rng(0).normal(2.0, 3.0, (4000, 4))
    intervals = [seed_interval(row.tolist()) for row in draws]
    inside = np.mean([each.low <= 2.0 <= each.high for each in intervals])
    assert inside == pytest.approx(0.95, abs=4 * math.sqrt(0.95 * 0.05 / 4000))


def test_one_seed_has_no_interval_and_no_seed_is_refused():
    assert seed_interval([2.0]).low is seed_interval([2.0]).high is None
    with pytest.raises(InputError, match="at least one seed"):
        seed_interval([])


def test_equal_and_enormous_values():
    assert (seed_interval([0.1] * 3).low, seed_interval([0.1] * 3).high) == (0.1, 0.1)
    assert seed_interval([1e200, 3e200]).mean == pytest.approx(2e200)


def test_differences_are_paired_by_seed_over_the_seeds_that_both_have():
    rng = np.random.default_rng(1)
    a, b = rng.normal(50, 10, 4), rng.normal(0.5, 0.1, 4)
    runs = [run("a", seed, rmse=a[seed]) for seed in (0, 1, 2)]
    runs += [run("b", seed, rmse=a[seed] + b[seed]) for seed in (3, 2, 1)]
    one, two = section("x", runs).rows
    assert one.difference is None and one.value.mean == pytest.approx(a[:3].mean())
    assert two.value.num_seeds == 3 and two.value.mean == pytest.approx((a + b)[1:].mean())
    assert two.difference.num_seeds == 2 and two.difference.mean == pytest.approx(b[1:3].mean())
    test = stats.ttest_rel((a + b)[1:3], a[1:3]).confidence_interval(0.95)
    assert (two.difference.low, two.difference.high) == pytest.approx(tuple(test), rel=1e-9)


def test_a_slow_loop_gives_the_same_table():
    rng = np.random.default_rng(2)
    runs = [
        run(model, seed, **{f"{score}/{x}": float(rng.normal()) for score in ("rmse", "nll") for x in (5, 10)})
        for model in "abc"
        for seed in range(3)
    ]
    rows = {(row.setting.label, row.metric): row for row in section("x", runs, "model=b").rows}
    assert len(rows) == 3 * 4
    for (label, metric), row in rows.items():
        own = [each.metrics[metric] for each in runs if each.overrides == (label,)]
        base = [each.metrics[metric] for each in runs if each.overrides == ("model=b",)]
        assert row.value.mean == pytest.approx(sum(own) / 3)
        if label == "model=b":
            assert row.difference is None
        else:
            assert row.difference.mean == pytest.approx(sum(o - b for o, b in zip(own, base, strict=True)) / 3)
    assert list(dict.fromkeys(metric for _, metric in rows)) == ["nll/5", "nll/10", "rmse/5", "rmse/10"]


def test_a_metric_that_some_runs_lack_is_averaged_over_those_that_have_it():
    runs = [run("a", 0, rmse=1.0, floor=5.0), run("a", 1, rmse=3.0), run("b", 0, rmse=2.0), run("b", 1, floor=4.0)]
    rows = {(row.setting.label, row.metric): row for row in section("x", runs).rows}
    assert rows["model=a", "floor"].value.num_seeds == 1
    assert rows["model=b", "floor"].difference is None
    assert rows["model=b", "rmse"].difference.num_seeds == 1


def test_only_finished_runs_count(tmp_path):
    leave_sweep(tmp_path, {"a": {0: {"rmse": 1.0}, 1: {"rmse": 3.0}}, "b": {0: {"rmse": 4.0}}})
    leave_run(tmp_path / "c", {"model": "c", "seed": 0}, None, ["model=c", "seed=0"])
    (tmp_path / "model=a,seed=1" / "metrics.json").write_text("{")
    (found,) = sections(read_runs(tmp_path))
    assert [(row.setting.label, row.value.mean) for row in found.rows] == [("model=a", 1.0), ("model=b", 4.0)]
    assert len(found.settings) == 4
    assert {setting.label: list(seeds) for setting, seeds in found.counted.items()} == {
        "model=a": ["0"],
        "model=b": ["0"],
    }


def test_a_repeated_run_counts_once(tmp_path):
    leave_sweep(tmp_path / "2026-01-01", {"a": {0: {"rmse": 1.0, "seconds/total": 9.0}, 1: {"rmse": 2.0}}})
    leave_sweep(tmp_path / "2026-01-02", {"a": {0: {"rmse": 1.0, "seconds/total": 5.0}, 1: {"rmse": 6.0}}})
    (found,) = sections(read_runs(tmp_path))
    row = next(row for row in found.rows if row.metric == "rmse")
    assert (row.value.mean, row.value.num_seeds) == (3.5, 2)
    same, other = found.repeats["2026-01-01/model=a,seed=0"], found.repeats["2026-01-01/model=a,seed=1"]
    assert "2026-01-02/model=a,seed=0, with the same numbers" in same
    assert "1 metrics of which differ" in other


def test_experiments_are_kept_apart(tmp_path):
    leave_sweep(tmp_path / "x", {"a": {0: {"rmse": 1.0}}, "b": {0: {"rmse": 2.0}}}, experiment="handover")
    leave_sweep(tmp_path / "y", {"5": {0: {"rmse": 7.0}}, "10": {0: {"rmse": 8.0}}}, key="num", experiment="timing")
    runs = read_runs(tmp_path)
    one, two = sections(runs)
    assert (one.experiment, two.experiment) == ("handover", "timing")
    assert [row.value.mean for row in two.rows] == [7.0, 8.0]
    one, two = sections(runs, "num=10")
    assert (one.baseline.label, two.baseline.label) == ("model=a", "num=10")
    with pytest.raises(InputError, match="'model=a', 'model=b', 'num=5', 'num=10'"):
        sections(runs, "num=11")


def test_a_baseline_that_has_not_finished_yet_leaves_differences_open(tmp_path):
    leave_sweep(tmp_path, {"a": {0: None}, "b": {0: {"rmse": 1.0}}, "c": {0: {"rmse": 2.0}}})
    (found,) = sections(read_runs(tmp_path), "model=a")
    assert found.baseline.label == "model=a" and all(row.difference is None for row in found.rows)
    (found,) = sections(read_runs(tmp_path))
    assert found.baseline.label == "model=b" and found.rows[1].difference.mean == 1.0

from __future__ import annotations

import pytest
from sweep_world import leave_run, leave_sweep

from eaip_prob.errors import InputError
from eaip_prob.reports import SeedInterval, checked_patterns, page, read_runs, sections, selected, summary
from eaip_prob.reports.page import MOST_METRICS
from eaip_prob.reports.selecting import shown

PASSING = [
    f"{score}/{scenario}/{method}/{length}"
    for score in ("rmse", "nll", "coverage90", "dtw")
    for scenario in ("horizontal", "both")
    for method in ("ip", "eaip", "paper_eaip")
    for length in (100, 10, 50)
]


def default_patterns() -> list[str]:
    from eaip_prob.runs import experiment

    @experiment("report", repeatable=True)
    def run(cfg, folder):
        return {}

    return list(run.compose().metrics)


def write(folder, **more) -> str:
    runs = read_runs(folder)
    patterns = more.pop("metrics", ["*"])
    return page("a/sweep", runs, sections(runs, more.pop("baseline", None)), patterns, more)


def test_default_patterns_show_the_package_s_method():
    gains = [f"gain/both/eaip_over_ip/{n}/{end}" for n in (10, 50) for end in ("mean", "low", "high")]
    found = selected([*PASSING, *gains, "novel/success/50x50", "seconds/total"], default_patterns())
    assert len(found) == 3 * 2 * 3 and all("/eaip/" in metric for metric in found)
    assert found[:3] == ["rmse/both/eaip/10", "rmse/both/eaip/50", "rmse/both/eaip/100"]
    few = [f"{score}/{m}/{n}{end}" for score in ("rmse", "nll") for m in ("ip", "eaip") for n in (5, 40)
           for end in ("", "/low", "/high")]  # fmt: skip
    assert selected(few, default_patterns()) == ["rmse/eaip/5", "rmse/eaip/40", "nll/eaip/5", "nll/eaip/40"]
    timing = ["rmse/mostly/default/0.2/50", "rmse/mostly/default/0.2/50/ip", "rmse/mostly/absolute/0.2/50"]
    assert selected(timing, default_patterns()) == timing[:1]


def test_patterns_must_be_a_list_of_texts():
    for wrong in ("rmse/*", [], [1], None, {"a": "b"}):
        with pytest.raises(InputError, match=r"metrics as a list of patterns"):
            checked_patterns(wrong)


def test_numbers_read_well():
    assert shown(None) == ""
    assert shown(SeedInterval(2.0, None, None, 1)) == "2"
    assert shown(SeedInterval(-0.000123456, -1.0, 1.0, 2)) == "-0.0001235 [-1, 1]"
    assert shown(SeedInterval(123456.7, 1e-9, 1e12, 2)) == "123457 [1e-09, 1e+12]"


def test_a_page_shows_means_intervals_and_differences(tmp_path):
    values = {"a": {0: {"rmse": 1.0}, 1: {"rmse": 3.0}}, "b": {0: {"rmse": 2.0}, 1: {"rmse": 4.0}}}
    text = write(leave_sweep(tmp_path, values))
    lines = text.splitlines()
    assert lines[0] == "# Report on a/sweep" and lines[2] == "4 runs: 4 finished." and "## passing_over" in lines
    assert "| model=a | 0, 1  |        2 |" in lines
    assert "| rmse   | 2 [-10.71, 14.71] | 3 [-9.706, 15.71] |" in lines
    assert any("Differences to `model=a`" in line for line in lines)
    assert "| rmse   | **1 [1, 1]** |" in lines
    assert "One seed" not in text and "1 of 1 metric shown" in text


def test_one_seed_is_said_to_have_no_interval(tmp_path):
    text = write(leave_sweep(tmp_path, {"a": {0: {"rmse": 1.0}}, "b": {0: {"rmse": 2.0}}}))
    assert "One seed has no interval." in text and "| rmse   | 1       | 2       |" in text


def test_what_does_not_count_is_named(tmp_path):
    leave_sweep(tmp_path, {"a": {0: {"rmse": 1.0}}, "b": {0: {"rmse": 2.0}, 1: None}})
    leave_run(tmp_path / "model=c", {"model": "c", "seed": 0}, None, ["model=c"], error="Expected a cube | ball.\n")
    (tmp_path / "model=a,seed=0" / "metrics.json").write_text("")
    text = write(tmp_path)
    assert "4 runs: 1 finished, 1 unfinished, 1 failed, 1 damaged." in text
    assert "- `model=c` failed: Expected a cube | ball." in text
    assert "- `model=a,seed=0` damaged: metrics.json: " in text
    assert "- `model=b,seed=1` unfinished: no metrics so far" in text
    assert "| model=b | 0     |        1 |          1 |      0 |       0 |" in text


def test_many_runs_and_metrics_are_cut_and_said_to_be(tmp_path):
    leave_sweep(tmp_path, {"a": {0: {f"x/{n}": float(n) for n in range(MOST_METRICS + 10)}}})
    leave_sweep(tmp_path, {"b": {seed: None for seed in range(25)}})
    text = write(tmp_path)
    assert "- 5 more unfinished: see runs.csv" in text and text.count("unfinished: no metrics") == 20
    assert f"{MOST_METRICS} of 70 metrics shown (70 were asked for)" in text
    assert "| x/59   |" in text and "x/60 " not in text


def test_patterns_that_match_nothing_show_all_and_say_so(tmp_path):
    text = write(leave_sweep(tmp_path, {"a": {0: {"ms/predict": 1.0}}}), metrics=["rmse/*"])
    assert "| ms/predict |" in text and "metrics=['rmse/*'] match none" in text


def test_many_settings_are_split_into_tables(tmp_path):
    text = write(leave_sweep(tmp_path, {str(n): {0: {"rmse": 1.0 * n}} for n in range(8)}))
    heads = [line for line in text.splitlines() if line.startswith("| metric")]
    assert [line.count("model=") for line in heads] == [6, 2, 6, 1]


def test_nothing_finished_is_said(tmp_path):
    leave_run(tmp_path / "a", {"seed": 0})
    assert "No run has finished with metrics." in write(tmp_path)


def test_repeated_runs_are_named(tmp_path):
    for name in ("a", "b"):
        leave_sweep(tmp_path / name, {"x": {0: {"rmse": 1.0}}})
    runs = read_runs(tmp_path)
    assert "- `a/model=x,seed=0`: The same configuration and seed as b/model=x,seed=0" in summary(runs, sections(runs))


def test_figures_are_shown_below_their_experiment(tmp_path):
    text = write(leave_sweep(tmp_path, {"a": {0: {"rmse": 1.0}}}), passing_over=["rmse_eaip"])
    assert text.endswith("![rmse_eaip](figures/rmse_eaip.png)\n")

from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
TINY = [
    "num_train=3",
    "num_test=1",
    "num_plans=9",
    "samples_seen=[10,100]",
    "feature_errors=[0,50]",
    "feature_noises=[1,100]",
    "sample_noises=[0,3]",
    "phase=elapsed",
]


def run_script(folder: Path, *overrides: str) -> subprocess.CompletedProcess[str]:
    command = [sys.executable, "experiments/passing_over.py", f"run_dir={folder}", *overrides]
    environment = {**os.environ, "OMP_NUM_THREADS": "1"}
    return subprocess.run(command, cwd=ROOT, capture_output=True, text=True, timeout=300, check=False, env=environment)


@pytest.fixture(scope="module")
def tiny_run(tmp_path_factory):
    folder = tmp_path_factory.mktemp("passing_over")
    done = run_script(folder, *TINY)
    assert done.returncode == 0, done.stderr[-2000:]
    return folder


@pytest.mark.slow
def test_a_run_leaves_metrics_figures_and_a_recording(tiny_run):
    metrics = json.loads((tiny_run / "metrics.json").read_text())
    for scenario in ("horizontal", "both"):
        for method in ("mean", "environment", "ip", "eaip", "eaip_shuffled", "paper_ip", "paper_eaip"):
            for score in ("dtw", "rmse", "nll", "coverage90", "success"):
                assert f"{score}/{scenario}/{method}/100" in metrics
    for name in ("floor/dtw", "noise/eaip/50/100", "bias/paper_eaip/0/1", "observation_noise/ip/3", "seconds/total"):
        assert name in metrics
    assert {"novel/success/400x50", "decodable/width", "decodable/height"} <= set(metrics)
    names = {path.stem for path in (tiny_run / "figures").glob("*.png")}
    expected = {"figure_2", "figure_3a", "figure_3b", "figure_4a", "figure_4b", "figure_5", "figure_6", "figure_7"}
    assert expected <= names
    assert (tiny_run / "recording.rrd").stat().st_size > 10_000


@pytest.mark.slow
def test_seeing_more_helps_and_so_does_the_environment(tiny_run):
    metrics = json.loads((tiny_run / "metrics.json").read_text())
    assert metrics["rmse/both/ip/100"] < 0.6 * metrics["rmse/both/mean/100"]
    assert metrics["dtw/both/eaip/10"] < 0.6 * metrics["dtw/both/ip/10"]
    assert metrics["rmse/horizontal/eaip/100"] < metrics["rmse/horizontal/ip/100"]


@pytest.mark.slow
def test_two_runs_of_one_seed_give_the_same_numbers(tiny_run, tmp_path):
    assert run_script(tmp_path, *TINY, "recording=none").returncode == 0
    first, second = (json.loads((folder / "metrics.json").read_text()) for folder in (tiny_run, tmp_path))
    drop = "seconds/total"
    assert {k: v for k, v in first.items() if k != drop} == {k: v for k, v in second.items() if k != drop}


@pytest.mark.slow
def test_a_finished_folder_is_kept_and_another_configuration_refused(tiny_run):
    before = (tiny_run / "metrics.json").read_bytes()
    again = run_script(tiny_run, *TINY)
    other = run_script(tiny_run, *TINY, "seed=3")
    assert again.returncode == 0 and "finished before" in again.stdout
    assert other.returncode == 2 and (tiny_run / "metrics.json").read_bytes() == before


def test_an_unknown_part_is_one_sentence(tmp_path):
    done = run_script(tmp_path, "phase=none_such")
    assert done.returncode != 0 and "none_such" in done.stderr

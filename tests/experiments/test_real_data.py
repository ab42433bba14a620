from __future__ import annotations

import importlib.util
import json
import math
import os
import subprocess
import sys
from pathlib import Path
from types import ModuleType

import pytest

import eaip_prob.data
from eaip_prob.errors import MissingDataError
from eaip_prob.methods import METHODS

ROOT = Path(__file__).resolve().parents[2]
DATA = ROOT / ".." / "shared" / "data"
READERS = {"reach_to_grasp": "read_reach_to_grasp", "handover": "read_handover"}
FILES = {"reach_to_grasp": "reach_cube_train.npz", "handover": "kth_handover_train.npz"}
SMALL = ["percent_seen=[50]", "examples=[0]", "num_folds=2", "paper.num_samples=40"]
NOISE = {"reach_to_grasp": 2.0, "handover": 0.01}


def script(name: str) -> ModuleType:
    spec = importlib.util.spec_from_file_location(f"experiment_{name}", ROOT / "experiments" / f"{name}.py")
    assert spec is not None and spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def some(name: str):
    """A few real motions, of four people or of ten recordings."""
    demonstrations = getattr(eaip_prob.data, READERS[name])(DATA)
    first = sorted(set(demonstrations.groups))[: 4 if name == "reach_to_grasp" else 10]
    taken = [[i for i, group in enumerate(demonstrations.groups) if group == g][:8] for g in first]
    return demonstrations.subset([i for places in taken for i in places])


@pytest.mark.slow
# Of so few recordings some are far from all others.
@pytest.mark.filterwarnings("ignore::eaip_prob.errors.ExtrapolationWarning")
@pytest.mark.parametrize("name", READERS)
def test_a_small_run_on_real_motions(name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys) -> None:
    if not (DATA / FILES[name]).is_file():
        pytest.skip(f"{FILES[name]} is not there")
    motions = some(name)
    monkeypatch.setattr(eaip_prob.data, READERS[name], lambda folder: motions)
    run = script(name).run
    cfg = run.compose(SMALL)
    cfg.predictor = {
        "_target_": "eaip_prob.prediction.InteractionPredictor",
        "phase": {"_target_": "eaip_prob.phase.ElapsedClock"},
        "noise": NOISE[name],
        "environment_noise": 0.01,
    }
    metrics = run.execute(cfg, tmp_path)
    assert metrics is not None and metrics == json.loads((tmp_path / "metrics.json").read_text())
    for method in METHODS:
        assert metrics[f"rmse/{method}/50"] > 0
        assert math.isfinite(metrics[f"nll/{method}/50"])
        assert 0.0 <= metrics[f"coverage90/{method}/50"] <= 1.0
    for gain in ("ip_over_mean", "eaip_over_environment", "eaip_over_ip", "eaip_over_paper_eaip"):
        low, mean, high = (metrics[f"gain/{gain}/50/{part}"] for part in ("low", "mean", "high"))
        assert low <= mean <= high
    assert metrics["seconds/total"] > 0
    assert (tmp_path / "recording.rrd").stat().st_size > 1000
    drawn = {path.stem for path in (tmp_path / "figures").glob("*.png")}
    assert {"scores_rmse", "scores_nll", "scores_coverage90", "gains", "coverage", "pit", "example_1"} <= drawn
    assert "50 % seen: watching the motion" in capsys.readouterr().out


@pytest.mark.parametrize("name", READERS)
def test_absent_data_are_named(name: str, tmp_path: Path) -> None:
    run = script(name).run
    with pytest.raises(MissingDataError, match=FILES[name]):
        run.execute(run.compose([f"data_dir={tmp_path / 'nothing'}"]), tmp_path / "run")
    assert not (tmp_path / "run" / "metrics.json").exists()


@pytest.mark.slow
@pytest.mark.parametrize("name", READERS)
def test_absent_data_end_well_with_one_sentence(name: str, tmp_path: Path) -> None:
    command = [sys.executable, str(ROOT / "experiments" / f"{name}.py"), "data_dir=/nowhere", f"run_dir={tmp_path}"]
    done = subprocess.run(
        command, capture_output=True, text=True, cwd=tmp_path, env=os.environ | {"OMP_NUM_THREADS": "1"}, check=False
    )
    assert done.returncode == 0, done.stderr
    assert done.stdout.count("\n") == 1 and FILES[name] in done.stdout
    assert not (tmp_path / "metrics.json").exists()

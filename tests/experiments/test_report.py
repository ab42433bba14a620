from __future__ import annotations

import csv
import importlib.util
import os
import shutil
import subprocess
import sys
from pathlib import Path

import pyarrow.parquet
import pytest
from sweep_world import leave_run, leave_sweep

from eaip_prob.config import conf_dir
from eaip_prob.errors import DataFileError, InputError

ROOT = Path(__file__).parents[2]
SCRIPT = '''"""Doubles a number."""
from pathlib import Path
from eaip_prob.errors import ShapeError
from eaip_prob.runs import experiment

@experiment("tiny", conf=Path(__file__).parent / "conf")
def run(cfg, folder):
    if cfg.size == 3 and cfg.seed == 1:
        raise ShapeError("Expected a cube, got a ball.")
    return {"rmse/eaip/10": cfg.size + cfg.seed, "rmse/eaip/20": 2 * cfg.size + cfg.seed**2}

if __name__ == "__main__":
    run()
'''


@pytest.fixture(scope="module")
def module():
    spec = importlib.util.spec_from_file_location("experiment_report", ROOT / "experiments" / "report.py")
    assert spec is not None and spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


@pytest.fixture
def report(module):
    def report(runs: Path, *overrides: str):
        return module.run.execute(module.run.compose([f"runs='{runs}'", *overrides]), runs / "report")

    return report


@pytest.fixture
def sweep(tmp_path):
    values = {m: {s: {"rmse/eaip/10": n + s, "rmse/eaip/20": 2.0 * n + s} for s in (0, 1)} for n, m in enumerate("ab")}
    return leave_sweep(tmp_path / "sweep", values)


def start(folder: Path, script: str | Path, *arguments: str) -> subprocess.CompletedProcess[str]:
    environment = {**os.environ, "OMP_NUM_THREADS": "1"}
    command = [sys.executable, str(script), *arguments]
    return subprocess.run(
        command, cwd=folder, capture_output=True, text=True, timeout=120, check=False, env=environment
    )


@pytest.mark.slow
def test_a_real_sweep_with_a_refused_run_is_reported(tmp_path):
    shutil.copytree(conf_dir() / "recording", tmp_path / "conf" / "recording")
    shutil.copy(conf_dir() / "base.yaml", tmp_path / "conf")
    (tmp_path / "conf" / "tiny.yaml").write_text("defaults: [base, _self_]\nsize: 1\n")
    (tmp_path / "tiny.py").write_text(SCRIPT)
    swept = start(tmp_path, "tiny.py", "-m", "size=2,3", "seed=0,1,2", "hydra.sweep.dir=sweep")
    done = start(tmp_path, ROOT / "experiments" / "report.py", "runs=sweep", "baseline=2")
    assert done.returncode == 0, swept.stderr + done.stderr
    assert "- `seed=1,size=3` failed: Expected a cube, got a ball." in done.stdout
    assert "| rmse/eaip/10 | 3 [0.5159, 5.484]" in done.stdout and "are in sweep/report." in done.stdout
    assert (tmp_path / "sweep" / "report" / "figures" / "rmse_eaip.png").stat().st_size > 5000
    rows = pyarrow.parquet.read_table(tmp_path / "sweep" / "report" / "report.parquet").to_pylist()
    assert [(row["size"], row["num_seeds"]) for row in rows] == [(2, 3), (2, 3), (3, 2), (3, 2)]


def test_files_and_counts(report, sweep, capsys):
    metrics = report(sweep)
    assert metrics == {
        "num_finished": 4.0,
        "num_unfinished": 0.0,
        "num_failed": 0.0,
        "num_damaged": 0.0,
        "num_settings": 2.0,
        "num_rows": 4.0,
    }
    folder = sweep / "report"
    names = {"report.md", "report.csv", "report.parquet", "runs.csv", "figures"}
    assert names | {"config.yaml", "environment.json", "metrics.json"} == {path.name for path in folder.iterdir()}
    with (folder / "report.csv").open() as file:
        assert [row["model"] for row in csv.DictReader(file)] == ["a", "a", "b", "b"]
    printed = capsys.readouterr().out
    assert "| rmse/eaip/20 | 0.5 [-5.853, 6.853] | 2.5 [-3.853, 8.853] |" in printed
    assert "![rmse_eaip](figures/rmse_eaip.png)" in (folder / "report.md").read_text()
    assert "# Report on sweep" not in printed and "# Report on " in printed and "![" not in printed


def test_again_while_the_sweep_goes_on(report, sweep):
    shutil.rmtree(sweep / "model=b,seed=1")
    leave_run(sweep / "model=b,seed=1", {"model": "b", "seed": 1}, None, ["model=b", "seed=1"])
    first = report(sweep)
    assert (first["num_finished"], first["num_unfinished"]) == (3, 1)
    (sweep / "model=b,seed=1" / "metrics.json").write_text('{"rmse/eaip/10": 5.0, "other": 1.0}')
    (sweep / "report" / "notes.txt").write_text("mine")
    second = report(sweep, "metrics=['other']")
    assert (second["num_finished"], second["num_unfinished"], second["num_rows"]) == (4, 0, 5)
    text = (sweep / "report" / "report.md").read_text()
    assert "| other  |         | 1       |" in text and "unfinished" not in text
    assert {path.name for path in (sweep / "report" / "figures").iterdir()} == {"metrics.png"}
    assert (sweep / "report" / "notes.txt").read_text() == "mine"


def test_a_damaged_run_does_not_stop_the_others(report, sweep):
    (sweep / "model=a,seed=0" / "metrics.json").write_bytes(b'{"rmse/eaip/10": 0.')
    (sweep / "model=a,seed=1" / "config.yaml").write_bytes(b"\xff")
    metrics = report(sweep)
    assert (metrics["num_finished"], metrics["num_damaged"], metrics["num_settings"]) == (2, 2, 1)
    for path in sweep.glob("model=b*/environment.json"):
        path.write_text("")
    with pytest.raises(DataFileError, match=r"4 damaged; model=a,seed=0: metrics\.json"):
        report(sweep)


def test_a_single_run_can_be_reported(report, sweep):
    assert report(sweep / "model=a,seed=0")["num_finished"] == 1


def test_what_is_refused_is_one_sentence(report, module, sweep, tmp_path):
    with pytest.raises(InputError, match="holds none"):
        report(tmp_path / "empty")
    with pytest.raises(InputError, match=r"Expected baseline .* 'c'\. There are 'model=a', 'model=b'\."):
        report(sweep, "baseline=c")
    with pytest.raises(InputError, match="Expected metrics as a list"):
        report(sweep, "metrics=rmse")
    with pytest.raises(InputError, match=r"Expected runs, .* runs=FOLDER\."):
        module.run.execute(module.run.compose(), tmp_path / "none")
    with pytest.raises(InputError, match="axes"):
        report(sweep, "+axes.timing.colour=red")


@pytest.mark.slow
def test_the_command_line_without_runs(tmp_path):
    done = start(tmp_path, ROOT / "experiments" / "report.py")
    assert done.returncode == 2 and len(done.stderr.splitlines()) == 1 and "runs=FOLDER" in done.stderr

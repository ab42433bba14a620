from __future__ import annotations

import contextlib
import json
import os
import resource
import shutil
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

from eaip_prob.config import conf_dir

SCRIPT = '''"""Squares a number, slowly, and counts how often."""
import os, time
from pathlib import Path
from eaip_prob.errors import ShapeError
from eaip_prob.runs import experiment

@experiment("tiny", conf=Path(__file__).parent / "conf")
def run(cfg, folder):
    import torch
    with open(cfg.log, "a") as log:
        log.write(f"{cfg.number} {cfg.mood}\\n")
    if cfg.mood == "refused":
        raise ShapeError("Expected a cube, got a ball.")
    if cfg.mood == "bug":
        raise KeyError("lost")
    (folder / "figure.txt").write_text("x" * cfg.size)
    time.sleep(cfg.seconds)
    env = int(os.environ["OMP_NUM_THREADS"])
    return {"square": cfg.number**2, "torch_threads": torch.get_num_threads(), "omp_threads": env}

if __name__ == "__main__":
    run()
'''


@pytest.fixture
def folder(tmp_path):
    conf = tmp_path / "conf"
    shutil.copytree(conf_dir() / "recording", conf / "recording")
    shutil.copytree(conf_dir() / "hydra", conf / "hydra")
    shutil.copy(conf_dir() / "base.yaml", conf)
    keys = f"number: 0\nmood: good\nseconds: 0.0\nsize: 10\nlog: {tmp_path / 'log'}\n"
    (conf / "tiny.yaml").write_text(f"defaults: [base, _self_]\n{keys}")
    (tmp_path / "tiny.py").write_text(SCRIPT)
    return tmp_path


def command(*arguments: str) -> list[str]:
    return [sys.executable, "tiny.py", *arguments]


def start(folder: Path, *arguments: str, limit: int | None = None) -> subprocess.CompletedProcess[str]:
    def small_disk() -> None:
        resource.setrlimit(resource.RLIMIT_FSIZE, (limit, limit))

    prepare = small_disk if limit else None
    return subprocess.run(
        command(*arguments), cwd=folder, capture_output=True, text=True, timeout=300, check=False, preexec_fn=prepare
    )


def finished(folder: Path) -> dict[str, float]:
    paths = sorted((folder / "sweep").glob("*/metrics.json"))
    return {path.parent.name: json.loads(path.read_text())["square"] for path in paths}


def ran(folder: Path) -> list[str]:
    return sorted(line.split()[0] for line in (folder / "log").read_text().splitlines())


@pytest.mark.slow
def test_a_killed_sweep_goes_on_where_it_stopped(folder):
    sweep = ("-m", "number=1,2,3,4", "seconds=0.5", "run_dir=sweep")
    process = subprocess.Popen(command(*sweep), cwd=folder, start_new_session=True, stdout=subprocess.DEVNULL)
    deadline = time.monotonic() + 120
    while len(finished(folder)) < 2 and time.monotonic() < deadline:
        time.sleep(0.02)
    os.killpg(process.pid, signal.SIGKILL)
    process.wait()
    before = finished(folder)
    assert 2 <= len(before) < 4
    again = start(folder, *sweep)
    assert again.returncode == 0, again.stderr
    assert finished(folder) == {f"number={n},seconds=0.5": n * n for n in (1, 2, 3, 4)}
    # What was running when the kill came ran once more; nothing that had finished did.
    assert len(ran(folder)) <= 5
    assert again.stdout.count("finished before") == len(before)
    assert start(folder, *sweep).stdout.count("finished before") == 4


@pytest.mark.slow
@pytest.mark.parametrize("launcher", ["joblib", "submitit_local"])
def test_workers_have_their_threads_and_leave_what_is_finished(folder, launcher):
    sweep = ("-m", "number=1,2,3", "threads=1", "run_dir=sweep", f"hydra/launcher={launcher}")
    done = start(folder, *sweep)
    assert done.returncode == 0, done.stderr
    assert sorted(finished(folder).values()) == [1, 4, 9]
    for path in (folder / "sweep").glob("*/metrics.json"):
        metrics = json.loads(path.read_text())
        assert (metrics["torch_threads"], metrics["omp_threads"]) == (1, 1)
    (folder / "sweep" / "number=2,threads=1" / "metrics.json").unlink()
    assert start(folder, *sweep).returncode == 0
    assert ran(folder) == ["1", "2", "2", "3"]


@pytest.mark.slow
def test_one_refused_run_stops_no_other(folder):
    done = start(folder, "-m", "number=1,2", "mood=good,refused", "run_dir=sweep")
    assert done.returncode == 2
    assert done.stderr.count("mood=refused,number=1: Expected a cube, got a ball.") == 1
    assert "Not all runs of the sweep finished; the first that did not: Expected a cube" in done.stderr
    assert "Traceback" not in done.stderr
    assert sorted(finished(folder)) == ["mood=good,number=1", "mood=good,number=2"]
    said = (folder / "sweep" / "mood=refused,number=2" / "error.txt").read_text()
    assert said == "Expected a cube, got a ball.\n"


@pytest.mark.slow
def test_a_bug_in_one_run_stops_no_other(folder):
    done = start(folder, "-m", "number=1,2", "mood=bug,good", "run_dir=sweep")
    assert done.returncode == 1 and "KeyError: 'lost'" in done.stderr
    assert len(finished(folder)) == 2
    said = (folder / "sweep" / "mood=bug,number=1" / "error.txt").read_text()
    assert said.startswith("Traceback") and said.endswith("KeyError: 'lost'\n")


@pytest.mark.slow
def test_names_that_do_not_exist_are_refused_before_anything_runs(folder):
    done = start(folder, "-m", "number=1,2", "recording=none,film", "run_dir=sweep")
    assert done.returncode == 2 and "Could not find 'recording/film'" in done.stderr
    launcher = start(folder, "-m", "number=1", "hydra/launcher=raft")
    assert launcher.returncode == 2 and "pip install 'eaip_prob[sweeps]'" in launcher.stderr
    assert not (folder / "log").exists()


@pytest.mark.slow
def test_a_sweep_of_another_configuration_is_refused_run_by_run(folder):
    assert start(folder, "-m", "number=1,2", "run_dir=sweep").returncode == 0
    before = {path: path.read_bytes() for path in (folder / "sweep").glob("*/*")}
    (folder / "conf" / "tiny.yaml").write_text((folder / "conf" / "tiny.yaml").read_text().replace("10", "11"))
    done = start(folder, "-m", "number=1,2", "run_dir=sweep")
    assert done.returncode == 2 and done.stderr.count("nothing was overwritten") == 3
    assert {path: path.read_bytes() for path in (folder / "sweep").glob("*/*")} == before


@pytest.mark.slow
def test_a_full_disk_is_one_sentence_and_loses_nothing(folder):
    full = start(folder, "run_dir=full", "number=3", "size=100000", limit=20_000)
    assert full.returncode == 2, full.stderr
    assert full.stderr.startswith("Expected room for results in 'full', got: File too large. Make room")
    assert full.stderr.count("\n") == 1
    assert not (folder / "full" / "metrics.json").exists()
    with contextlib.chdir(folder / "full"):
        assert not [name for name in os.listdir() if name.startswith(".")]
    assert start(folder, "run_dir=full", "number=3", "size=100000").returncode == 0
    assert json.loads((folder / "full" / "metrics.json").read_text())["square"] == 9

from __future__ import annotations

import json
import os
import shutil
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
import torch
import yaml
from omegaconf import OmegaConf

from eaip_prob.config import conf_dir
from eaip_prob.errors import InputError, MissingDataError
from eaip_prob.runs import experiment

SCRIPT = '''"""Doubles a number, or refuses to."""
from pathlib import Path
from eaip_prob.errors import MissingDataError, ShapeError
from eaip_prob.runs import experiment

@experiment("tiny", conf=Path(__file__).parent / "conf")
def run(cfg, folder):
    if cfg.mood == "absent":
        raise MissingDataError("Expected data in the moon, found none.")
    if cfg.mood == "refused":
        raise ShapeError("Expected a cube, got a ball.")
    import os, torch
    env = int(os.environ["OMP_NUM_THREADS"])
    return {"double": 2 * cfg.part.number, "threads": torch.get_num_threads(), "env": env}

if __name__ == "__main__":
    run()
'''


@pytest.fixture
def folder(tmp_path):
    conf = tmp_path / "conf"
    shutil.copytree(conf_dir() / "recording", conf / "recording")
    shutil.copy(conf_dir() / "base.yaml", conf)
    (conf / "part").mkdir()
    (conf / "tiny.yaml").write_text("defaults: [base, part: three, _self_]\nmood: good\nsame: ${part.number}\n")
    (conf / "part" / "three.yaml").write_text("number: 3\n")
    (conf / "part" / "four.yaml").write_text("number: 4\n")
    (tmp_path / "tiny.py").write_text(SCRIPT)
    return tmp_path


@pytest.fixture
def tiny(folder):
    @experiment("tiny", conf=folder / "conf")
    def run(cfg, results):
        (results / "figure.txt").write_text("drawn")
        return {"part": {"double": 2 * cfg.part.number}, "threads": torch.get_num_threads()}

    return run


def start(folder: Path, *arguments: str, **environment: str) -> subprocess.CompletedProcess[str]:
    command = [sys.executable, "tiny.py", *arguments]
    env = {**os.environ, **environment}
    return subprocess.run(command, cwd=folder, env=env, capture_output=True, text=True, timeout=60)


def test_execute_leaves_a_finished_run(tiny, tmp_path):
    results = tmp_path / "a" / "b"
    metrics = tiny.execute(tiny.compose(["part=four", "seed=5", "threads=2"]), results)
    assert metrics == {"part/double": 8.0, "threads": 2.0}
    assert json.loads((results / "metrics.json").read_text()) == metrics
    config = yaml.safe_load((results / "config.yaml").read_text())
    assert config["same"] == 4
    assert config["seed"] == 5
    assert "run_dir" not in config
    assert list(config) == sorted(config)
    assert sorted(path.name for path in results.iterdir()) == [
        "config.yaml",
        "environment.json",
        "figure.txt",
        "metrics.json",
    ]


def test_the_environment_names_versions_and_neither_paths_nor_hosts(tiny, tmp_path):
    import platform

    tiny.execute(tiny.compose(["seed=7"]), tmp_path / "run")
    text = (tmp_path / "run" / "environment.json").read_text()
    environment = json.loads(text)
    assert environment["seed"] == 7
    assert environment["packages"]["numpy"] == np.__version__
    assert environment["python"] == platform.python_version()
    assert str(Path(__file__).parents[1]) not in text
    assert platform.node() not in text


def test_a_finished_run_is_left_alone(tiny, tmp_path):
    results = tmp_path / "run"
    tiny.execute(tiny.compose(), results)
    (results / "metrics.json").write_text("{}")
    assert tiny.execute(tiny.compose([f"run_dir={results}"]), results) is None
    assert (results / "metrics.json").read_text() == "{}"


def test_another_configuration_is_refused_and_overwrites_nothing(tiny, tmp_path):
    results = tmp_path / "run"
    tiny.execute(tiny.compose(), results)
    before = {path.name: path.read_bytes() for path in results.iterdir()}
    with pytest.raises(InputError, match="'run' .*another configuration.*Choose another run_dir"):
        tiny.execute(tiny.compose(["part=four"]), results)
    assert {path.name: path.read_bytes() for path in results.iterdir()} == before


def test_metrics_of_unknown_origin_are_refused(tiny, tmp_path):
    (tmp_path / "metrics.json").write_text("{}")
    with pytest.raises(InputError, match="nothing was overwritten"):
        tiny.execute(tiny.compose(), tmp_path)


def test_an_interrupted_run_is_run_again(tiny, tmp_path):
    results = tmp_path / "run"
    tiny.execute(tiny.compose(), results)
    (results / "metrics.json").unlink()
    assert tiny.execute(tiny.compose(), results) is not None


def test_open_references_are_refused(tiny, tmp_path):
    cfg = OmegaConf.create({"a": "${nowhere}"})
    with pytest.raises(InputError, match="nowhere"):
        tiny.execute(cfg, tmp_path)


def test_absent_data_leave_no_metrics(folder, tmp_path):
    @experiment("tiny", conf=folder / "conf")
    def run(cfg, results):
        raise MissingDataError("none")

    with pytest.raises(MissingDataError):
        run.execute(run.compose(), tmp_path / "run")
    assert not (tmp_path / "run" / "metrics.json").exists()


def test_help_tells_what_it_does_its_groups_and_keys(folder):
    answer = start(folder, "--help")
    assert answer.returncode == 0
    for part in ("Doubles a number, or refuses to.", "part: four, three", "mood: good", "run_dir=FOLDER"):
        assert part in answer.stdout
    assert not (folder / "runs").exists()


@pytest.mark.slow
def test_a_script_runs_once_and_refuses_another_configuration(folder):
    first = start(folder, "run_dir=here", "threads=2")
    assert (first.returncode, first.stderr) == (0, "")
    assert "Results are in here." in first.stdout
    assert json.loads((folder / "here" / "metrics.json").read_text()) == {"double": 6, "threads": 2, "env": 2}
    again = start(folder, "run_dir=here", "threads=2")
    assert again.returncode == 0
    assert "left as it is" in again.stdout
    other = start(folder, "hydra.run.dir=here", "part=four")
    assert other.returncode == 2
    assert "Choose another run_dir" in other.stderr
    assert "Traceback" not in other.stderr
    assert sorted(path.name for path in (folder / "here").iterdir()) == [
        "config.yaml",
        "environment.json",
        "metrics.json",
    ]


@pytest.mark.slow
def test_a_script_ends_by_the_kind_of_its_error(folder):
    absent = start(folder, "mood=absent")
    assert absent.returncode == 0
    assert absent.stdout == "Expected data in the moon, found none.\n"
    (results,) = (folder / "runs" / "tiny").iterdir()
    assert not (results / "metrics.json").exists()
    refused = start(folder, "mood=refused", "run_dir=r")
    assert (refused.returncode, refused.stderr) == (2, "Expected a cube, got a ball.\n")
    full = start(folder, "mood=refused", "run_dir=r", HYDRA_FULL_ERROR="1")
    assert full.returncode == 2
    assert "Traceback" in full.stderr

from __future__ import annotations

import importlib
import json
from pathlib import Path

import numpy as np
import pytest

from eaip_prob.data import Intrinsics, RGBDFrame
from eaip_prob.perception import fuse

FOLDER = Path(__file__).parents[2] / "experiments" / "benchmarks"
NAMES = {
    *(f"encode_{num}" for num in (90, 1000)),
    *(f"condition_{num}" for num in (20, 100, 200)),
    *("rollout_1", "rollout_500", "rollout_500_9"),
    *("dtw_200", "dtw_step", "predict"),
    *("update_expected_clock", "update_kernel", "stream_step"),
}
# Of the largest entry. A ridge of another kind, and Euler steps, are all that sets the two ways apart.
# Weights of a DMP that hardly move it vary by 1e10, which costs the variance of its positions eight digits of sixteen.
TOLERANCE = {"predict": 1e-7, "stream_step": 1e-7, "rollout_1": 0.02, "rollout_500": 0.02, "rollout_500_9": 0.02}


@pytest.fixture
def modules(monkeypatch):
    monkeypatch.syspath_prepend(str(FOLDER))
    return importlib.import_module("core"), importlib.import_module("_core_jobs")


@pytest.fixture
def problem(modules):
    return modules[1].Problem.of(seed=1)


@pytest.mark.slow
def test_core_leaves_medians_and_spreads(modules, tmp_path, capsys):
    core = modules[0].run
    metrics = core.execute(core.compose(["repetitions=2", "sample_ms=0.01"]), tmp_path)
    spreads = {f"spread/{name}/{level}" for name in NAMES for level in ("p10", "p90")}
    assert set(metrics) == {f"{kind}/{name}" for kind in ("ms", "plain") for name in NAMES} | spreads
    assert all(value > 0 for value in metrics.values())
    assert all(metrics[f"spread/{n}/p10"] <= metrics[f"ms/{n}"] <= metrics[f"spread/{n}/p90"] for n in NAMES)
    machine = json.loads((tmp_path / "machine.json").read_text())
    assert set(machine) == {"cpu", "cores", "load_before", "load_after"}
    table = [line for line in capsys.readouterr().out.splitlines() if line.startswith("|")]
    assert len({len(line) for line in table}) == 1
    assert len(table) == len(NAMES) + 2
    assert set(core.compose().targets) <= NAMES


@pytest.mark.slow
def test_both_ways_answer_alike(modules):
    for name, pair in modules[1].jobs(seed=1).items():
        if name.startswith("encode"):
            continue
        for ours, plain in zip(pair.package(), pair.plain(), strict=True):
            plain, scale = np.asarray(plain), np.abs(plain).max()
            ours = np.asarray(ours).reshape(plain.shape)
            assert np.abs(ours - plain).max() <= TOLERANCE.get(name, 1e-8) * scale, name


def test_both_encodings_represent_the_motions(modules, problem):
    pair = modules[1].encode(problem, 90)
    for weights in (pair.package(), pair.plain()):
        for agent, part, paths in zip(("human", "robot"), weights, (problem.human, problem.robot), strict=True):
            primitive = problem.fitted.primitives[agent]
            decoded = primitive.decode(np.asarray(part).reshape(90, -1), problem.phase, 2.0)
            assert float((decoded - paths[:90]).abs().max()) < 0.01


def test_jobs_take_turns_and_each_number_is_per_call(modules, monkeypatch):
    timing = importlib.import_module("_timing")
    clock, order = [0], []

    def job(name, nanoseconds):
        def call():
            order.append(name)
            clock[0] += nanoseconds

        return call

    monkeypatch.setattr(timing.time, "perf_counter_ns", lambda: clock[0])
    times = timing.interleaved({"short": job("short", 100_000), "long": job("long", 3_000_000)}, 2, sample_ms=0.5)
    assert times == {"short": pytest.approx([0.1, 0.1]), "long": pytest.approx([3.0, 3.0])}
    one_round = ["short"] * 6 + ["long"] * 2
    assert order[-16:] == one_round * 2


@pytest.mark.slow
def test_perception_leaves_medians_and_memory(modules, tmp_path, capsys):
    benchmark = importlib.import_module("perception").run
    small = ["repetitions=1", "moments=2", "frames=12"]
    metrics = benchmark.execute(benchmark.compose(small), tmp_path)
    names = {"render_rgbd_3", "render_colour_960", "noise", "track_3", "fuse_3", "yolo", "onnx"}
    names |= {f"loop/{stage}" for stage in ("gloves", "detector", "phase", "posterior", "plan", "total", "look")}
    assert {name for name in metrics if name.startswith("ms/")} == {f"ms/{name}" for name in names}
    assert all(metrics[f"ms/{name}"] > 0 for name in names) and metrics["memory/growth_mb"] >= 0
    assert "render_colour_960" in capsys.readouterr().out
    assert set(benchmark.compose().targets) <= names


def test_open3d_fuses_to_as_many_points(modules):
    jobs = importlib.import_module("_perception_jobs")
    frame = a_wall()
    ours = fuse([frame], ((-1.0, 1.0), (-1.0, 1.0), (0.5, 3.0)), 0.05)
    theirs = jobs.open3d_fused([frame], ((-1.0, 1.0), (-1.0, 1.0), (0.5, 3.0)), 0.05)
    # open3d's grid begins at the smallest coordinate, which cuts other rows of voxels at the rim
    assert len(ours) == pytest.approx(len(theirs.points), rel=0.1)


def a_wall():
    camera = Intrinsics(128, 96, 110.0, 110.0, 63.5, 47.5)
    depth = np.full((96, 128), 2.01, np.float32)
    return RGBDFrame(np.full((96, 128, 3), 90, np.uint8), depth, depth > 0, camera, np.eye(4), 0.0)

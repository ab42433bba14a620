from __future__ import annotations

import os

import pytest
from sweep_world import leave_run, leave_sweep

from eaip_prob.errors import DataFileError, InputError
from eaip_prob.reports import read_runs
from eaip_prob.reports.reading import natural
from eaip_prob.run_folder import RunFolder


def test_every_state_is_told_apart(tmp_path):
    leave_run(tmp_path / "a", {"seed": 1}, {"rmse": 2.5, "seconds/total": 3.0}, ["seed=1", "model=b"])
    leave_run(tmp_path / "b", {"seed": 2})
    leave_run(tmp_path / "c", {"seed": 3}, error="Traceback (most recent call last):\nValueError: too cold\n")
    leave_run(tmp_path / "d", {"seed": 4}, {"rmse": 1.0})
    (tmp_path / "d" / "metrics.json").write_text('{"rmse": ')
    runs = {run.name: run for run in read_runs(tmp_path)}
    assert {name: run.state for name, run in runs.items()} == {
        "a": "finished",
        "b": "unfinished",
        "c": "failed",
        "d": "damaged",
    }
    assert runs["a"].metrics == {"rmse": 2.5, "seconds/total": 3.0} and runs["a"].seconds == 3.0
    assert runs["a"].overrides == ("model=b",) and runs["a"].experiment == "passing_over"
    assert runs["c"].sentence == "ValueError: too cold"
    assert runs["d"].sentence.startswith("metrics.json: ") and runs["d"].seed == 4 and not runs["d"].metrics
    assert [run.seed for run in runs.values()] == [1, 2, 3, 4]


def test_what_the_package_writes_is_what_is_read(tmp_path):
    folders = [RunFolder(tmp_path / name) for name in ("good", "refused")]
    for folder in folders:
        folder.start("seed: 3\n", {"experiment": "handover", "overrides": ["seed=3"]})
    folders[0].finish({"rmse": 0.5})
    folders[1].fail(InputError("Expected a cube, got a ball."))
    good, refused = read_runs(tmp_path)
    assert (good.state, good.experiment, good.metrics) == ("finished", "handover", {"rmse": 0.5})
    assert (refused.state, refused.sentence) == ("failed", "Expected a cube, got a ball.")


def test_a_run_that_succeeded_after_a_failure_is_finished(tmp_path):
    leave_run(tmp_path / "a", {"seed": 1}, {"rmse": 2.5}, error="old")
    assert read_runs(tmp_path)[0].state == "finished"


@pytest.mark.parametrize(
    ("file", "content", "reason"),
    [
        ("config.yaml", b"a: [", "config.yaml: "),
        ("config.yaml", b"\xff\xfe\x00", "config.yaml: "),
        ("config.yaml", b"- 1", "expected a mapping, got list"),
        ("config.yaml", b"", "expected a mapping, got NoneType"),
        ("environment.json", b"{", "environment.json: "),
        ("metrics.json", b"[1]", "expected a mapping, got list"),
        ("metrics.json", b'{"rmse": NaN}', "one finite number as metric 'rmse'"),
        ("metrics.json", b'{"rmse": "low"}', "one finite number as metric 'rmse'"),
        ("metrics.json", b"", "metrics.json: "),
    ],
)
def test_a_damaged_file_is_named_and_does_not_stop_the_others(tmp_path, file, content, reason):
    leave_run(tmp_path / "bad", {"seed": 1}, {"rmse": 1.0})
    (tmp_path / "bad" / file).write_bytes(content)
    with pytest.raises(DataFileError, match="bad"):
        read_runs(tmp_path)
    leave_run(tmp_path / "good", {"seed": 2}, {"rmse": 2.0})
    bad, good = read_runs(tmp_path)
    assert bad.state == "damaged" and reason in bad.sentence and good.state == "finished"


def test_a_configuration_that_is_gone_or_a_folder_is_damage(tmp_path):
    leave_run(tmp_path / "gone", {}, {"rmse": 1.0})
    (tmp_path / "gone" / "config.yaml").unlink()
    leave_run(tmp_path / "odd", {"seed": 0})
    (tmp_path / "odd" / "metrics.json").mkdir()
    leave_run(tmp_path / "well", {"seed": 0}, {"rmse": 1.0})
    gone, odd, well = read_runs(tmp_path)
    assert gone.state == odd.state == "damaged" and well.state == "finished"
    assert str(tmp_path) not in gone.sentence + odd.sentence


def test_hidden_folders_reports_and_what_hydra_leaves_are_no_runs(tmp_path):
    leave_sweep(tmp_path, {"a": {0: {"rmse": 1.0}}})
    leave_run(tmp_path / ".submitit" / "1", {"seed": 0})
    leave_run(tmp_path / "report", {"runs": "x"}, {"num_finished": 1}, experiment="unnamed")
    leave_run(tmp_path / "elsewhere", {"runs": "x"}, {"num_finished": 1}, experiment="report")
    (tmp_path / "multirun.yaml").write_text("seed: 0")
    (tmp_path / "deep" / "config.yaml").parent.mkdir()
    (tmp_path / "deep" / "config.yaml").write_text("seed: 0")
    assert [run.name for run in read_runs(tmp_path)] == ["model=a,seed=0"]


def test_a_run_itself_and_runs_far_below(tmp_path):
    one = leave_run(tmp_path / "x" / "y" / "seed=1", {"seed": 1}, {"rmse": 1.0})
    assert [run.name for run in read_runs(one)] == ["seed=1"]
    assert [run.name for run in read_runs(str(tmp_path))] == [os.path.join("x", "y", "seed=1")]


def test_runs_come_in_the_order_of_their_numbers(tmp_path):
    leave_sweep(tmp_path, {"a": {seed: {"rmse": 1.0} for seed in (10, 9, 100)}})
    assert [run.seed for run in read_runs(tmp_path)] == [9, 10, 100]
    assert sorted(["x=-2", "x=1.5", "x=-10", "x=y"], key=natural) == ["x=-10", "x=-2", "x=1.5", "x=y"]


def test_nested_configurations_become_dotted_keys(tmp_path):
    parts = [{"_target_": "a.B"}, {"_target_": "a.C", "size": 2}]
    leave_run(tmp_path / "a", {"seed": 0, "task": {"sizes": [[1, 2]], "parts": parts, "none": {}}}, {})
    assert read_runs(tmp_path)[0].config == {
        "seed": 0,
        "task.sizes": [[1, 2]],
        "task.parts.0._target_": "a.B",
        "task.parts.1._target_": "a.C",
        "task.parts.1.size": 2,
        "task.none": {},
    }


def test_a_folder_without_runs_is_refused_in_one_sentence(tmp_path):
    with pytest.raises(InputError, match="'.*nothing', which is none"):
        read_runs(tmp_path / "nothing")
    with pytest.raises(InputError, match=r"holds none: no config\.yaml"):
        read_runs(tmp_path)
    (tmp_path / "file").write_text("")
    with pytest.raises(InputError, match="which is none"):
        read_runs(tmp_path / "file")

from __future__ import annotations

import json
import math
import os

import numpy as np
import pytest
import torch

from eaip_prob.errors import InputError
from eaip_prob.files import write_text
from eaip_prob.run_folder import RunFolder, flat_metrics


def test_a_folder_is_finished_by_its_metrics(tmp_path):
    folder = RunFolder(tmp_path / "seed=1")
    assert not folder.is_finished("a: 1")
    folder.start("a: 1", {"seed": 1})
    assert not folder.is_finished("a: 1")
    with pytest.raises(InputError, match="seed=1.*another configuration.*nothing was overwritten"):
        folder.is_finished("a: 2")
    folder.finish({"rmse": 0.5})
    assert folder.is_finished("a: 1")
    with pytest.raises(InputError, match="another configuration"):
        folder.is_finished("a: 2")
    assert json.loads((folder.path / "metrics.json").read_text()) == {"rmse": 0.5}


def test_a_refusal_is_a_sentence_and_a_bug_a_traceback(tmp_path):
    folder = RunFolder(tmp_path)
    folder.start("a: 1", {})
    folder.fail(InputError("Expected a cube, got a ball."))
    assert (tmp_path / "error.txt").read_text() == "Expected a cube, got a ball.\n"
    try:
        raise KeyError("lost")
    except KeyError as error:
        folder.fail(error)
    lines = (tmp_path / "error.txt").read_text().splitlines()
    assert lines[0].startswith("Traceback") and lines[-1] == "KeyError: 'lost'"


def test_only_a_refusal_that_left_no_result_gives_way(tmp_path):
    folder = RunFolder(tmp_path)
    folder.start("a: 1", {})
    folder.fail(InputError("no"))
    assert not folder.is_finished("a: 2")
    folder.start("a: 2", {})
    assert not (tmp_path / "error.txt").exists()
    folder.fail(InputError("no"))
    (tmp_path / "figure.png").touch()
    with pytest.raises(InputError, match="another configuration"):
        folder.is_finished("a: 1")
    assert not folder.is_finished("a: 2")


def test_metrics_are_flat_sorted_floats():
    flat = flat_metrics({"b": {"y": np.float32(0.5), "x": {"z": torch.tensor(2)}}, "a": True})
    assert list(flat.items()) == [("a", 1.0), ("b/x/z", 2.0), ("b/y", 0.5)]
    assert all(type(value) is float for value in flat.values())


@pytest.mark.parametrize("value", [math.nan, math.inf, -math.inf, "1", None, [1.0], torch.ones(2), 1j])
def test_what_is_no_finite_number_is_refused_by_its_key(value):
    with pytest.raises(InputError, match="'eaip/rmse'"):
        flat_metrics({"eaip": {"rmse": value}})


def test_one_key_twice_is_refused():
    with pytest.raises(InputError, match="twice"):
        flat_metrics({"a": {"b": 1}, "a/b": 2})


def test_a_write_that_fails_leaves_the_file(tmp_path, monkeypatch):
    target = tmp_path / "file"
    write_text(target, "old")
    monkeypatch.setattr(os, "replace", lambda *_: (_ for _ in ()).throw(OSError("full")))
    with pytest.raises(OSError, match="full"):
        write_text(target, "new")
    assert target.read_text() == "old"

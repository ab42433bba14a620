from __future__ import annotations

import math

import numpy as np
import pytest
import torch

from eaip_prob.data.frames import Intrinsics, RGBDFrame
from eaip_prob.errors import InputError, ShapeError
from eaip_prob.recording import AbstractRunLogger, Moment, NullLogger
from eaip_prob.recording.rerun_logger import RerunLogger

AT = Moment(2, 0.1)
DEPTH = np.ones((3, 4), np.float32)
FRAME = RGBDFrame(np.zeros((3, 4, 3), np.uint8), DEPTH, DEPTH > 0, Intrinsics(4, 3, 4.0, 4.0, 2.0, 1.0), np.eye(4), 0.1)
TIME = [0.0, 0.1, 0.3]
MEAN = [[0.0, 1.0], [2.0, 3.0], [4.0, 5.0]]


@pytest.fixture(params=["null", "rerun"])
def logger(request, tmp_path):
    made: AbstractRunLogger = NullLogger() if request.param == "null" else RerunLogger(tmp_path / "recording.rrd")
    with made:
        yield made


def test_every_call_is_accepted(logger):
    logger.blueprint("plots", {"scores": "rmse [m]"}, timeline="time", bounds=((0.0, 0.0), (1.0, 1.0)))
    logger.path("a", MEAN, color=(1, 2, 3), at=AT, label="a")
    logger.paths("b", torch.zeros(3, 4, 3), radius=1.0, at=AT)
    logger.box("c", [0, 0, 0], [1, 1, 1])
    logger.rectangle("d", 2, 3, corner=(1, 1), unit="m")
    logger.series("e", TIME, MEAN, ["x", "y"], samples_seen=[1, 5, 9], color=(1, 2, 3))
    logger.interval("f", TIME, np.zeros(3), np.ones(3))
    logger.prediction("g", TIME, MEAN, ["x", "y"], at=AT, lower=MEAN, upper=MEAN, samples=[MEAN], observed=MEAN[:2])
    logger.text("h", "# Title", at=AT)
    logger.array("i", 3.0, [])
    logger.camera("j", FRAME, at=AT)
    logger.cloud("k", torch.zeros(2, 3), np.zeros((2, 3), np.uint8), radius=0.01, at=AT)
    logger.points("l", [[0, 0, 1]], radius=2.0, color=(1, 2, 3, 4), labels=["m"], at=AT)
    logger.ellipsoids("n", torch.zeros(1, 3), [np.eye(3)], level=0.5, color=(1, 2, 3), labels=["o"], at=AT)


def test_the_null_logger_takes_the_arguments_of_the_other():
    NullLogger("recording.rrd", "test", recording_id="seed3").close()


REFUSALS = [
    (ShapeError, r"\(T, 2\) or \(T, 3\), got \(3,\)", lambda r: r.path("a", [1.0, 2.0, 3.0])),
    (ShapeError, "2 or 3 coordinates at 'a', got 4", lambda r: r.path("a", np.ones((3, 4)))),
    (ShapeError, r"\(N, T, D\).*got \(3, 2\)", lambda r: r.paths("a", MEAN)),
    (ShapeError, "at least one entry", lambda r: r.path("a", np.ones((0, 2)))),
    (
        InputError,
        r"finite numbers in values, got nan at index \(1, 0\)",
        lambda r: r.path("a", [[0, 0], [math.nan, 0]]),
    ),
    (InputError, "radius above zero", lambda r: r.path("a", MEAN, radius=0.0)),
    (InputError, r"whole numbers 0\.\.255, got \(1, 2, 256\)", lambda r: r.path("a", MEAN, color=(1, 2, 256))),
    (InputError, r"whole numbers 0\.\.255, got \(0\.5, 0, 0\)", lambda r: r.path("a", MEAN, color=(0.5, 0, 0))),
    (InputError, "entity such as .* got 'a b'", lambda r: r.path("a b", MEAN)),
    (InputError, "got ''", lambda r: r.text("", "x")),
    (InputError, "got '/a'", lambda r: r.text("/a", "x")),
    (InputError, r"got 1 > 0 at index \(1,\)", lambda r: r.box("a", [0, 1], [2, 0])),
    (ShapeError, "2 or 3 coordinates at 'a', got 4", lambda r: r.box("a", [0] * 4, [1] * 4)),
    (ShapeError, r"got \(2,\) and \(3,\)", lambda r: r.box("a", [0] * 2, [1] * 3)),
    (InputError, r"got 0 > -3", lambda r: r.rectangle("a", 2, -3)),
    (ShapeError, "each of the 3 rows at 'a', got 2 and 2", lambda r: r.series("a", TIME[:2], MEAN, ["x", "y"])),
    (ShapeError, "2 names and colors at 'a', got 1 and 1", lambda r: r.series("a", TIME, MEAN, ["x"])),
    (ShapeError, "one color or 2", lambda r: r.series("a", TIME, MEAN, ["x", "y"], color=[(1, 2, 3)])),
    (InputError, "increasing time at 'a'", lambda r: r.series("a", [0.0, 0.2, 0.1], MEAN, ["x", "y"])),
    (InputError, "increasing samples_seen", lambda r: r.series("a", TIME, MEAN, ["x", "y"], samples_seen=[1, 1, 2])),
    (InputError, "whole numbers at 'a'", lambda r: r.series("a", TIME, MEAN, ["x", "y"], samples_seen=[1, 1.5, 2])),
    (InputError, r"exchanged", lambda r: r.interval("a", TIME, [0, 1, 2], [0, 1, 1])),
    (ShapeError, r"shape \(3,\) at 'a'", lambda r: r.interval("a", TIME, [0, 1], [0, 1])),
    (ShapeError, r"mean \(T, 1\).*got \(3,\) and \(3, 2\)", lambda r: r.prediction("a", TIME, MEAN, ["x"], at=AT)),
    (InputError, "2 different names", lambda r: r.prediction("a", TIME, MEAN, ["x", "x"], at=AT)),
    (InputError, "or neither, got one", lambda r: r.prediction("a", TIME, MEAN, ["x", "y"], at=AT, lower=MEAN)),
    (
        ShapeError,
        r"samples with shape \(N, 3, 2\)",
        lambda r: r.prediction("a", TIME, MEAN, ["x", "y"], at=AT, samples=MEAN),
    ),
    (InputError, "2 different names in names", lambda r: r.array("a", MEAN, ["x"])),
    (ShapeError, "at least one number", lambda r: r.array("a", np.ones((0, 2)), ["x", "y"])),
    (InputError, "kind of layout among .* got '4-D'", lambda r: r.blueprint("4-D")),
    (InputError, "timeline among .* got 'log_time'", lambda r: r.blueprint("plane", timeline="log_time")),
    (InputError, "entity such as", lambda r: r.blueprint("plane", {"signals/": "x [px]"})),
]


@pytest.mark.parametrize(("error", "message", "call"), REFUSALS)
def test_refusals(logger, error, message, call):
    with pytest.raises(error, match=message):
        call(logger)


def test_a_refused_prediction_leaves_nothing():
    kept = []

    class Keeping(AbstractRunLogger):
        def _write(self, record):
            kept.append(record)

        def _finish(self):
            kept.clear()

    with pytest.raises(ShapeError):
        Keeping().prediction("a", TIME, MEAN, ["x", "y"], at=AT, observed=MEAN, samples=MEAN)
    assert kept == []


@pytest.mark.parametrize(("count", "time"), [(-1, 0.0), (1.5, 0.0), (1, math.nan)])
def test_moments_are_checked(count, time):
    with pytest.raises(InputError):
        Moment(count, time)


def test_a_prediction_for_the_past_has_no_fan(logger):
    logger.prediction("a", TIME, MEAN, ["x", "y"], at=Moment(9, 5.0))

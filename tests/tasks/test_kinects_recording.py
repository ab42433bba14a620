from __future__ import annotations

from collections import Counter
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from rerun.chunk import RrdReader

from eaip_prob.data.frames import Intrinsics, RGBDFrame
from eaip_prob.errors import InputError, ShapeError
from eaip_prob.perception import HandState
from eaip_prob.recording import AbstractRunLogger, NullLogger, RerunLogger
from eaip_prob.recording.records import Curves, Text
from eaip_prob.recording.sensor_records import CameraImages, Cloud, Ellipsoids, Markers
from eaip_prob.tasks.kinects import HandPath
from eaip_prob.tasks.kinects.recording import record_clip

LENS = Intrinsics(16, 12, 12.0, 12.0, 7.5, 5.5)
TIME = np.arange(31) / 30.0


def hand_path() -> HandPath:
    position = np.tile([[1.2, -0.3, 0.1], [1.2, 0.3, 0.1]], (len(TIME), 1, 1))
    position[:, :, 2] += TIME[:, None]
    return HandPath(TIME, position)


def frames(names=("left", "right")) -> list[list[RGBDFrame]]:
    pose = np.array([[0, 0, 1, 0], [-1, 0, 0, 0], [0, -1, 0, 0.1], [0, 0, 0, 1.0]])
    depth = np.full((12, 16), 1.5, np.float32)
    color = np.full((12, 16, 3), 90, np.uint8)
    return [[RGBDFrame(color, depth, depth > 0, LENS, pose, t, name=name) for name in names] for t in TIME]


def tracked(path: HandPath, error: float = 0.002, unseen: int = -1) -> list[HandState | None]:
    """Off by `error` along x from the third time on; the left hand not seen at one time."""
    states: list[HandState | None] = [None, None]
    for place in range(2, len(path.time)):
        covariance = np.tile(np.diag([1e-6, 4e-6, 1e-6]), (2, 1, 1))
        seen = np.array([place != unseen, True])
        position = path.position[place] + [error, 0.0, 0.0]
        states.append(HandState(float(path.time[place]), position, covariance, seen))
    return states


class Keeping(AbstractRunLogger):
    def __init__(self):
        self.kept = []

    def _write(self, record):
        self.kept.append(record)

    def _finish(self):
        pass


def kept(states, **options):
    logger = Keeping()
    record_clip(logger, hand_path(), iter(frames()), states, "still, test", **options)
    return logger.kept


def of(records: list[Any], kind: type, entity: str) -> list[Any]:
    return [record for record in records if isinstance(record, kind) and record.entity == entity]


def test_images_and_clouds_come_at_their_rates():
    found = kept(tracked(hand_path()), camera_rate=10.0, cloud_rate=3.0)
    images = of(found, CameraImages, "cameras/right")
    assert [record.at.samples_seen for record in images] == list(range(1, 32, 3))
    assert [record.frame.time for record in images] == [record.at.time for record in images]
    assert [record.at.samples_seen for record in of(found, Cloud, "cloud")] == [1, 11, 21, 31]
    assert len(of(kept(tracked(hand_path()), camera_rate=30.0), CameraImages, "cameras/left")) == 31


def test_round_off_in_the_times_moves_no_image():
    path = HandPath(TIME + 0.7, hand_path().position)
    logger = Keeping()
    record_clip(logger, path, frames(), [None] * len(TIME), "later")
    images = of(logger.kept, CameraImages, "cameras/left")
    assert [record.at.samples_seen for record in images] == list(range(1, 32, 3))


def test_hands_are_drawn_where_they_are_and_marked_when_not_seen():
    path = hand_path()
    found = kept(tracked(path, unseen=5))
    assert [r.positions[0].tolist() for r in of(found, Markers, "hands/right/true")] == path.position[:, 1].tolist()
    marks = of(found, Markers, "hands/left/tracked")
    assert [record.at.samples_seen for record in marks] == list(range(3, 32))
    np.testing.assert_allclose([r.positions[0] for r in marks], path.position[2:, 0] + [0.002, 0.0, 0.0])
    shapes = of(found, Ellipsoids, "hands/left/ellipsoid")
    assert Counter(record.color for record in marks) == Counter(record.color for record in shapes)
    assert [record.at.samples_seen for record in shapes if record.labels == ("left, not seen",)] == [6]
    assert len({record.color for record in marks}) == 2
    assert len({record.color for record in of(found, Markers, "hands/right/tracked")}) == 1
    assert {tuple(record.half_sizes[0].round(5)) for record in shapes} == {(0.0028, 0.0028, 0.00559)}


def test_curves_are_in_millimetres_from_the_first_state_on():
    found = kept(tracked(hand_path(), error=0.003, unseen=5))
    (error,) = of(found, Curves, "errors/left")
    np.testing.assert_allclose(error.values, 3.0)
    assert error.samples_seen.tolist() == list(range(3, 32))
    np.testing.assert_allclose(error.time, TIME[2:])
    (spread,) = of(found, Curves, "spread/right")
    np.testing.assert_allclose(spread.values, np.sqrt(2.0))
    assert of(found, Curves, "seen/left")[0].values[:, 0].tolist() == [float(k != 5) for k in range(2, 31)]
    (report,) = of(found, Text, "clip")
    assert report.markdown.startswith("# still, test") and "| median_mm | 3 |" in report.markdown


def test_a_camera_that_delivers_nothing_leaves_a_gap():
    steps = frames()
    steps[3] = steps[3][:1]
    steps[10] = []
    logger = Keeping()
    record_clip(logger, hand_path(), steps, [None] * len(TIME), "dark")
    assert len(of(logger.kept, CameraImages, "cameras/left")) == 11
    assert len(of(logger.kept, CameraImages, "cameras/right")) == 10
    assert [record.at.samples_seen for record in of(logger.kept, Cloud, "cloud")] == [1, 21, 31]
    assert not [record for record in logger.kept if isinstance(record, Curves)]


def contents(path: Path):
    chunks = RrdReader(path).stream().to_chunks()
    return [(chunk.entity_path, chunk.to_record_batch().drop_columns(["rerun.controls.RowId"])) for chunk in chunks]


def test_two_runs_compare_equal(tmp_path):
    for name, error in (("a", 0.001), ("b", 0.001), ("c", 0.002)):
        with RerunLogger(tmp_path / f"{name}.rrd", "kinects", "kinects-0") as logger:
            record_clip(logger, hand_path(), frames(), tracked(hand_path(), error), "still")
    one, same, other = (contents(tmp_path / f"{name}.rrd") for name in "abc")
    assert one == same != other
    assert {"/space/cameras/left/depth_camera/depth", "/space/cloud", "/report/clip"} <= {entity for entity, _ in one}


@pytest.mark.parametrize("change", [-1, 1])
def test_refusals(change):
    path, states = hand_path(), tracked(hand_path())
    steps = frames()[:change] if change < 0 else [*frames(), []]
    with pytest.raises(InputError, match=f"each of the 31 times of the path, got {31 + change}"):
        record_clip(NullLogger(), path, steps, states, "still")
    with pytest.raises(ShapeError, match="Expected truth"):
        record_clip(NullLogger(), path, frames(), states[:-1], "still")
    with pytest.raises(InputError, match="rates above zero, got 0"):
        record_clip(NullLogger(), path, frames(), states, "still", cloud_rate=0.0)

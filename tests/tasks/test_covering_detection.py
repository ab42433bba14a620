from __future__ import annotations

import importlib.util
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch

from eaip_prob.data import EnvironmentFeatures, Intrinsics
from eaip_prob.detection import BoxEncoder, Detections
from eaip_prob.errors import InputError
from eaip_prob.simulation import (
    Kinect,
    KinectModel,
    KinectNoise,
    LabelledFrame,
    OracleDetector,
    Table,
    Workspace,
    looking_at,
)
from eaip_prob.tasks.detection import (
    CoveringViews,
    Lift,
    ObjectScores,
    Placement,
    Sighting,
    by_cover,
    consequence,
    feature_study,
    sighting,
    table_1,
)

ROOT = Path(__file__).parents[2]
DEPTH = Intrinsics(64, 53, 45.68, 45.68, 31.8, 25.6, (0.0905, -0.2683, 0.0, 0.0, 0.0951))
COLOR = Intrinsics(96, 54, 53.0, 53.0, 47.8, 25.9, (0.054, -0.068, 0.0, 0.0, 0.0))
CAMERA = Kinect(
    "right", KinectModel(DEPTH, COLOR, (-0.05, 0.0, 0.0)), looking_at((0.55, -1.75, 1.15), (0.95, 0, -0.15))
)
ROOM = Workspace(Table(0.9, 0.6, 0.7, 0.03, 0.05, (0.7, 0.6, 0.4), (0.6, 0.5, 0.3)), thing_turn=-0.9)
PLACEMENT = Placement((1.0, 0.05), -0.7, 1.7)


def views(count=4, **changes):
    return replace(CoveringViews("table", CAMERA, count, KinectNoise(), 1, ROOM, PLACEMENT), **changes)


def test_the_object_is_in_view_in_the_first_half_and_covered_in_the_end():
    covered = [frame.objects[0].covered for frame in views(6).render()]
    assert max(covered[:3]) < 0.25 and covered[5] > 0.6
    assert np.all(np.diff(covered[3:]) > 0)


def test_frames_are_kept_and_read_back_unchanged(tmp_path):
    first = views().frames(tmp_path)
    (path,) = tmp_path.iterdir()
    written = path.stat().st_mtime_ns
    again = views().frames(tmp_path)
    assert path.stat().st_mtime_ns == written and len(first) == len(again) == 4
    for one, other in zip(first, again, strict=True):
        assert isinstance(other, LabelledFrame) and one.time == other.time and one.name == other.name
        assert np.array_equal(one.color, other.color) and np.array_equal(one.valid, other.valid)
        assert np.array_equal(one.depth[one.valid], other.depth[one.valid])
        assert other.objects[0].label == "table" and other.objects[0].covered == one.objects[0].covered
        assert np.array_equal(one.objects[0].box, other.objects[0].box)
        assert np.array_equal(one.objects[0].place, other.objects[0].place)


def test_whatever_changes_the_frames_changes_the_key():
    others = [
        views(5),
        views(seed=2),
        views(label="chair"),
        views(placement=replace(PLACEMENT, turn=0.0)),
        views(noise=KinectNoise(offset=0.01)),
        views(camera=Kinect("right", CAMERA.model, looking_at((0.5, -1.7, 1.2), (0.9, 0, 0)))),
        views(workspace=replace(ROOM, thing=replace(ROOM.thing, height=0.8))),
    ]
    assert len({one.key() for one in [*others, views()]}) == 8 and views().key() == views().key()


def test_placements_stay_in_their_range_and_follow_the_seed():
    drawn = [Placement.drawn(np.random.default_rng((0, i))) for i in range(50)]
    assert all(abs(one.position[0] - 0.95) <= 0.1 and abs(one.turn + 0.9) <= 0.7 for one in drawn)
    assert drawn[3] == Placement.drawn(np.random.default_rng((0, 3))) and len({one.turn for one in drawn}) == 50


def test_a_trial_has_two_frames_at_least():
    with pytest.raises(InputError, match="two frames"):
        views(1)


def said(share, found, iou=0.8, covered=0.1):
    return Sighting(share, covered, "chair", found, iou, Detections.none((9, 9)))


def test_scores_part_the_halves_and_count_what_was_answered_instead():
    scores = ObjectScores.of(
        [said(0.1, "chair"), said(0.4, "table", 0.2), said(0.5, "nothing", 0.0, 0.9), said(0.9, "table", 0.5, 0.9)]
    )
    assert (scores.first_half, scores.whole, scores.num_first_half, scores.num_whole) == (0.5, 0.25, 2, 4)
    assert scores.iou == pytest.approx(0.5) and scores.covered == pytest.approx(0.5)
    assert scores.confused == {"table": 2, "nothing": 1}
    (row,) = table_1({"stepladder": scores})
    assert row["paper, whole"] == pytest.approx(0.7898, abs=1e-4) and row["instead"] == "table 2, nothing 1"
    assert table_1({"other": scores})[0]["paper, whole"] is None
    with pytest.raises(InputError, match="first half"):
        ObjectScores.of([said(0.7, "chair")])


def test_accuracy_by_what_is_hidden_counts_each_frame_once():
    frames = [
        said(0.1, "chair", 0.9, 0.0),
        said(0.2, "table", 0.5, 0.19),
        said(0.6, "chair", 0.2, 0.2),
        said(0.9, "table", 0.0, 1.0),
    ]
    first, second, last = by_cover(frames)
    assert first == {"covered from": 0.0, "frames": 2, "right": 0.5, "IoU": pytest.approx(0.7)}
    assert second == {"covered from": 0.2, "frames": 1, "right": 1.0, "IoU": 0.2}
    assert (last["covered from"], last["frames"], last["right"]) == (0.8, 1, 0.0)


def test_a_sighting_says_what_was_found(tmp_path):
    frame = next(iter(views().render()))
    exact = sighting(OracleDetector(), frame)
    assert exact.right and exact.iou == 1.0 and exact.share == frame.time
    blind = sighting(OracleDetector(drop_out=1.0), frame)
    assert blind.found == "nothing" and blind.iou == 0.0 and not blind.right
    with pytest.raises(InputError, match="one labelled object"):
        sighting(OracleDetector(), replace(frame, objects=()))


def lifts(count, seed, error):
    """Objects of which a detector sees the height with an error."""
    rng = np.random.default_rng(seed)
    for height in rng.uniform(0.5, 1.1, count):
        wrong = height + error * rng.standard_normal()
        yield Lift(
            np.array([0.95, 0.0, height / 2 - 0.93, 0.5, 0.4, height]),
            EnvironmentFeatures(("height",), [height]),
            EnvironmentFeatures(("height",), [wrong], [[error**2]]),
        )


def test_a_lift_clears_the_object_and_says_little_at_first():
    (low,), (high,) = (list(lifts(1, seed, 0.0)) for seed in (1, 3))
    motions = [lift.motion(np.random.default_rng(5)) for lift in (low, high)]
    for lift, motion in zip((low, high), motions, strict=True):
        top = lift.place[2] + lift.place[5] / 2
        peak = float(motion.robot.values[:, 1].max())
        assert top + 0.05 < peak < top + 0.25
        at_peak = int(motion.robot.values[:, 1].argmax())
        assert abs(float(motion.robot.values[at_peak, 0])) < 0.2
    first = torch.stack([motion.human.values[:10, 0] for motion in motions])
    assert float((first[0] - first[1]).abs().max()) < 0.1 * abs(low.place[5] - high.place[5]) + 0.05


def test_the_environment_helps_as_far_as_it_is_exact():
    scores = {
        error: consequence(list(lifts(24, 1, error)), list(lifts(12, 2, error)), seed=0) for error in (0.005, 0.15)
    }
    good, bad = scores[0.005], scores[0.15]
    assert good["detected"]["rmse"] < 0.6 * good["none"]["rmse"]
    assert good["detected"]["rmse"] == pytest.approx(good["true"]["rmse"], rel=0.2)
    assert bad["detected"]["rmse"] > 1.5 * good["detected"]["rmse"]
    assert all(one["coverage90"] > 0.7 for one in (*good.values(), *bad.values()))


def test_the_study_of_features_measures_the_detectors_error(tmp_path):
    names = ("folding_table", "end_table")
    frames, sightings = {}, {}
    detector = OracleDetector(box_std=0.05)
    for number, name in enumerate(names):
        places = [replace(PLACEMENT, position=(0.9 + 0.05 * trial, 0.05 * number)) for trial in range(3)]
        frames[name] = [list(views(8, placement=place).render()) for place in places]
        sightings[name] = [[sighting(detector, frame) for frame in shown] for shown in frames[name]]
    rows, predictions, metrics = feature_study(BoxEncoder(), frames, sightings, names[:1], seed=0)
    width = frames[names[0]][0][0].objects[0].box[2]
    assert [row["feature"] for row in rows] == list(metrics["features_std"])
    assert metrics["features_std"]["width"] == pytest.approx(0.05 * width, rel=0.4)
    assert metrics["features_missed"] == 0.0
    assert [row["features"] for row in predictions] == ["true", "detected", "detected_as_exact", "none"]
    assert set(metrics["prediction"]["true"]) == {"rmse", "coverage90"}


@pytest.mark.slow
def test_the_experiment_changes_detector_and_encoder_by_a_word(tmp_path):
    spec = importlib.util.spec_from_file_location("detection_script", ROOT / "experiments" / "detection.py")
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    few = ["trials=2", "frames=2", "camera.color_size=[96,54]", f"clip_dir={tmp_path / 'clips'}", "detector=oracle"]
    plain = module.run.execute(module.run.compose(few), tmp_path / "plain")
    names = {name.split("/")[1] for name in plain if name.startswith("accuracy/")}
    assert len(names) == 8 and {"chair_4_legged", "end_table"} <= names
    assert all(plain[f"accuracy/{name}/{part}"] == 1.0 for name in names for part in ("first_half", "whole"))
    assert all(plain[f"iou/{name}"] == 1.0 and 0.0 < plain[f"covered/{name}"] < 1.0 for name in names)
    boxes = {"features_std/label", *(f"features_std/{name}" for name in ("center_x", "center_y", "width", "height"))}
    assert {name for name in plain if name.startswith("features_std/")} == boxes
    figures = {path.name for path in (tmp_path / "plain" / "figures").iterdir()}
    assert figures == {"figure_8_detections.png", "table_1.png", "over_time.png"}
    metric = module.run.execute(module.run.compose([*few, "encoder=metric_box"]), tmp_path / "metric")
    assert {name for name in metric if name.startswith("features_std/")} == {
        f"features_std/{name}" for name in ("x", "y", "z", "length_x", "length_y", "length_z")
    }
    same = {name for name in plain if name.split("/")[0] in ("accuracy", "covered", "iou")}
    assert {name: plain[name] for name in same} == {name: metric[name] for name in same}
    none = module.run.execute(module.run.compose([*few, "encoder=none"]), tmp_path / "none")
    assert {name: none[name] for name in same} == {name: plain[name] for name in same}

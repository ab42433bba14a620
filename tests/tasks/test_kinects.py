from __future__ import annotations

import importlib.util
import json
from pathlib import Path

import numpy as np
import pytest

from eaip_prob.data import Intrinsics, RGBDFrame
from eaip_prob.errors import InputError, ShapeError
from eaip_prob.perception import HandState, load_extrinsics
from eaip_prob.simulation import KinectNoise, Table, Workspace
from eaip_prob.tasks.kinects import MOTIONS, Scenario, hand_path, tracking_scores

ROOT = Path(__file__).parents[2]


def state(position, seen=(True, True), spread=0.01):
    covariance = np.tile(spread**2 * np.eye(3), (2, 1, 1))
    return HandState(0.0, np.asarray(position, float), covariance, np.asarray(seen))


@pytest.mark.parametrize("name", MOTIONS)
def test_paths_pass_their_way_points_at_rest(name):
    path = hand_path(name, rate=300.0)
    speed = np.linalg.norm(np.diff(path.position, axis=0), axis=-1) * 300.0
    assert speed.max() < 2.0
    for seconds, *hands in MOTIONS[name]:
        place = round(seconds * 300)
        np.testing.assert_allclose(path.position[place], hands, atol=1e-12)
        assert speed[min(place, len(speed) - 1)].max() < 1e-3


def test_hands_touch_and_cross():
    gap = np.linalg.norm(np.diff(hand_path("touching").position, axis=1), axis=-1).min()
    assert 2 * 0.048 <= gap < 2 * 0.048 + 0.01
    crossing = hand_path("crossing").position[:, :, 1]
    assert (crossing[0, 0] < crossing[0, 1]) and (crossing[36, 0] > crossing[36, 1])


@pytest.mark.parametrize(("arguments", "message"), [(("jump",), "motion among"), (("free", 0.0), "rate above zero")])
def test_bad_paths_are_refused(arguments, message):
    with pytest.raises(InputError, match=message):
        hand_path(*arguments)


def test_a_bag_that_is_let_go_stays_where_it_was():
    path = hand_path("bag")
    held = np.linalg.norm(path.lips - path.position, axis=-1)
    assert held[0].max() < 0.01 and np.ptp(path.lips, axis=0).max() == 0.0 and held[:, 1].max() > 0.3
    carried = hand_path("free")
    assert np.array_equal(carried.lips, carried.position)


def a_frame(name, time):
    camera, depth = Intrinsics(4, 3, 4.0, 4.0, 1.5, 1.0), np.full((3, 4), 2.0, np.float32)
    return RGBDFrame(np.zeros((3, 4, 3), np.uint8), depth, depth > 0, camera, np.eye(4), time, name=name)


def test_lost_cameras_deliver_nothing_while_they_are_lost():
    scenario = Scenario("free", lost={"right": (0.1, 0.3), "left": [0.2, 9.0]})
    frames = [[a_frame("left", t), a_frame("right", t)] for t in (0.0, 0.1, 0.2, 0.3)]
    names = [[frame.name for frame in step] for step in scenario.delivered(frames)]
    assert names == [["left", "right"], ["left"], [], ["right"]]


def test_a_scenario_changes_gloves_and_the_turn_of_the_object_and_nothing_else():
    room = Workspace(Table(0.9, 0.6, 0.7, 0.03, 0.05, (0.7, 0.6, 0.4), (0.6, 0.5, 0.3)), thing_turn=0.4)
    clip = Scenario("bag", glove_radius=0.06, thing_turn=0.0).clip(10.0, room, (), KinectNoise(), 3)
    assert clip.workspace.person.glove_radii == (0.06,) * 3 and clip.workspace.thing_turn == 0.0
    assert clip.seed == 3 and len(clip) == 28 and clip.workspace.thing == room.thing
    assert Scenario("bag").clip(10.0, room, (), KinectNoise(), 3).workspace.thing_turn == 0.4


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"glove_radius": 0.0}, "glove_radius above zero"),
        ({"lost": {"left": (1.0, 0.5)}}, "camera 'left'"),
        ({"lost": {"left": (1.0,)}}, "from, until"),
    ],
)
def test_bad_scenarios_are_refused(arguments, message):
    with pytest.raises(InputError, match=message):
        Scenario("free", **arguments)


def test_scores_count_seen_errors_ellipsoids_and_swaps():
    truth = np.tile([[0.0, 0.0, 0.0], [1.0, 0.0, 0.0]], (5, 1, 1))
    near = truth[0] + [0.002, 0.0, 0.0]
    far = truth[0] + [[0.0, 0.03, 0.0], [0.0, 0.0, 0.004]]
    states = [None, state(near), state(far, seen=(False, True)), state(truth[0][::-1]), state(near)]
    scores = tracking_scores(states, truth)
    assert scores.swaps == 1
    assert scores.seen == pytest.approx(7 / 8)
    assert scores.coverage95 == pytest.approx(5 / 8)
    # Seen: four times 2 mm, once 4 mm, twice 1 m.
    assert scores.median_mm == pytest.approx(2.0)
    assert scores.p95_mm == pytest.approx(1000.0)


def test_the_ellipsoid_is_that_of_95_per_cent():
    inside, outside = 2.79 * 0.01, 2.80 * 0.01  # the square root of chi2(0.95, 3) is 2.7955
    for distance, share in ((inside, 1.0), (outside, 0.0)):
        hands = np.zeros((1, 2, 3))
        assert tracking_scores([state(np.full((2, 3), distance / np.sqrt(3)))], hands).coverage95 == share


def test_nothing_tracked_has_no_error_and_other_times_are_refused():
    assert tracking_scores([None, None], np.zeros((2, 2, 3))).metrics() == {"seen": 0.0, "swaps": 0.0}
    with pytest.raises(ShapeError, match="truth with shape"):
        tracking_scores([None], np.zeros((2, 2, 3)))


@pytest.mark.slow
def test_the_experiment_calibrates_tracks_and_keeps_its_clips(tmp_path):
    spec = importlib.util.spec_from_file_location("kinects_script", ROOT / "experiments" / "kinects.py")
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    few = ["calibration.boards=9", "calibration.camera.color_size=[960,540]"]
    overrides = [*few, "play=[touching]", "rate=5", "+tracker.frame_time=0.2", f"clip_dir={tmp_path / 'clips'}"]
    metrics = module.run.execute(module.run.compose(overrides), tmp_path / "run")
    for poses in ("exact", "uncertain"):
        assert 0.0 < metrics[f"calibration/{poses}/mm"] < 20.0 and 0.0 < metrics[f"calibration/{poses}/deg"] < 1.0
    # as far off as the cameras are
    assert metrics["gloves/touching/median_mm"] < 2.0 + metrics["calibration/uncertain/mm"]
    assert metrics["gloves/touching/seen"] > 0.95 and metrics["gloves/touching/swaps"] == 0
    figures = {path.name for path in (tmp_path / "run" / "figures").iterdir()}
    assert figures == {"calibration.png", "errors.png", "views_touching.png"}
    assert (tmp_path / "run" / "recording.rrd").stat().st_size > 1e6
    assert set(load_extrinsics(tmp_path / "run" / "extrinsics.json")) == {"left", "overhead", "right"}
    (clip,) = (tmp_path / "clips").glob("*/*")
    before = clip.stat().st_mtime_ns
    again = module.run.execute(module.run.compose([*overrides, "recording=none"]), tmp_path / "again")
    assert clip.stat().st_mtime_ns == before
    same = {key: value for key, value in again.items() if not key.startswith("seconds")}
    assert same == {key: metrics[key] for key in same}
    assert json.loads((tmp_path / "again" / "metrics.json").read_text())["gloves/touching/swaps"] == 0

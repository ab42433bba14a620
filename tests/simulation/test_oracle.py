from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from detection_world import FLOOR, camera, cuboid, found, room, seen, shelf
from omegaconf import OmegaConf

from eaip_prob.config import build, conf_dir
from eaip_prob.data.frames import RGBDFrame
from eaip_prob.detection.base import CLASSES
from eaip_prob.errors import InputError
from eaip_prob.simulation import KinectNoise, Scene, render_depth
from eaip_prob.simulation.oracle import LabelledFrame, OracleDetector, TrueObject, render_labelled, true_object

HALF = cuboid("board", (0.6, -0.5, FLOOR), (0.9, -0.46, 0.6), (0.9, 0.9, 0.9))


def test_the_truth_is_that_of_whole_images():
    scene, view = room(shelf(), HALF), camera().color_view
    alone = render_depth(Scene([shelf()]), view).hit
    shown = render_depth(scene, view).instance == scene.index("thing")
    rows, columns = np.nonzero(alone)
    truth = true_object(scene, view, "thing", "bookshelf")
    assert 0.1 < truth.covered < 0.9 and truth.covered == pytest.approx(1.0 - (shown & alone).sum() / alone.sum())
    low, high = truth.box[:2] - truth.box[2:] / 2.0, truth.box[:2] + truth.box[2:] / 2.0
    assert low.tolist() == [columns.min() - 0.5, rows.min() - 0.5]
    assert high.tolist() == [columns.max() + 0.5, rows.max() + 0.5]
    assert truth.place == pytest.approx([0.95, 0.1, FLOOR + 0.45, 0.6, 0.3, 0.9])


def test_what_the_image_does_not_show_is_left_out():
    behind = cuboid("behind", (0.4, -3.0, 0.0), (0.7, -2.5, 0.5))
    astride = cuboid("astride", (0.5, -2.2, 0.9), (0.7, -1.5, 1.0))
    scene = room(shelf(), behind, astride)
    objects = {"thing": "table", "behind": "chair", "astride": "chair"}
    frame, labels = render_labelled(scene, camera(), 0.5, objects)
    assert "table" in [one.label for one in frame.objects] and frame.time == 0.5
    assert all(one.place[1] > -2.4 for one in frame.objects)
    assert labels.depth.shape == frame.depth.shape
    noisy = KinectNoise().apply(frame, labels, np.random.default_rng(0))
    assert isinstance(noisy, LabelledFrame) and noisy.objects is frame.objects
    for parts in ({"thing": "sofa"}, {"sofa": "chair"}):
        with pytest.raises(InputError, match="sofa"):
            render_labelled(scene, camera(), 0.0, parts)


def test_without_errors_the_oracle_answers_the_truth():
    frame = seen(room(shelf(), HALF))
    answer = OracleDetector().detect([seen(room(shelf()), "left"), frame])
    truth = frame.objects[0]
    assert answer.labels == ("bookshelf",) and answer.score.tolist() == [1.0]
    assert answer.box[0].tolist() == truth.box.tolist() and answer.place[0].tolist() == truth.place.tolist()
    assert not answer.box_covariance.any() and not answer.place_covariance.any()
    assert len(OracleDetector(largest_covered=truth.covered - 0.01).detect([frame])) == 0
    assert len(OracleDetector(largest_covered=truth.covered + 0.01).detect([frame])) == 1


def views(count: int) -> list[LabelledFrame]:
    frame = seen(room(shelf()))
    other = TrueObject("chair", np.array([60.0, 40.0, 30.0, 20.0]), 0.0, np.ones(6))
    return [replace(frame, time=index / 30.0, objects=(*frame.objects, other)) for index in range(count)]


def test_errors_have_the_size_that_is_asked_for():
    frames = views(600)
    exact, noisy = (OracleDetector(box_std=b, place_std=p) for b, p in ((0.0, 0.0), (0.04, 0.02)))
    pairs = [(noisy.detect([frame]), exact.detect([frame])) for frame in frames]
    box = np.concatenate([(one.box - other.box) / np.tile(other.box[:, 2:], 2) for one, other in pairs])
    place = np.concatenate([one.place - other.place for one, other in pairs])
    for error, std in ((box, 0.04), (place, 0.02)):
        count = len(error)
        assert np.abs(error.mean(0)).max() < 4.0 * std / np.sqrt(count)
        assert error.std(0) == pytest.approx(std, rel=4.0 / np.sqrt(2 * count))
        assert np.abs(np.corrcoef(error.T) - np.eye(error.shape[1])).max() < 4.0 / np.sqrt(count)
    one = pairs[0][0]
    expected = (0.04 * np.tile(frames[0].objects[0].box[2:], 2)) ** 2
    assert one.box_covariance[0].diagonal() == pytest.approx(expected, rel=0.2)
    assert one.place_covariance[1] == pytest.approx(0.0004 * np.eye(6))


def test_classes_go_wrong_and_objects_drop_out_as_often_as_asked():
    frames = views(600)
    answers = [OracleDetector(wrong_class=0.3, drop_out=0.2).detect([frame]) for frame in frames]
    labels = [label for answer in answers for label in answer.labels]
    count = 2 * len(frames)
    assert len(labels) / count == pytest.approx(0.8, abs=4.0 * np.sqrt(0.16 / count))
    share = [labels.count(name) / len(labels) for name in CLASSES]
    # A chair and a bookshelf in every frame: each is taken for each of the three others a tenth of the time.
    assert share == pytest.approx([0.4, 0.1, 0.1, 0.4], abs=0.06)
    assert answers[0].score.tolist() == [0.7] * len(answers[0])


def test_errors_follow_from_seed_camera_and_time_alone():
    first, second = views(2)
    detector = OracleDetector(box_std=0.1, seed=3)
    fresh = OracleDetector(box_std=0.1, seed=3).detect([second]).box
    detector.detect([first])
    assert detector.detect([second]).box.tolist() == fresh.tolist()
    assert detector.detect([first]).box.tolist() != fresh.tolist()
    assert OracleDetector(box_std=0.1, seed=4).detect([second]).box.tolist() != fresh.tolist()
    left = OracleDetector("left", box_std=0.1, seed=3).detect([replace(second, name="left")]).box
    assert left.tolist() != fresh.tolist()
    assert OracleDetector(drop_out=0.0, box_std=0.1, seed=3).detect([second]).box.tolist() == fresh.tolist()


def test_the_oracle_is_built_from_its_configuration():
    detector = build(OmegaConf.load(conf_dir() / "detector" / "oracle.yaml"))
    assert len(detector.detect([seen(room(shelf()))])) == 1


def test_what_cannot_be_answered_is_refused():
    frame = seen(room(shelf()))
    known = {name: getattr(frame, name) for name in RGBDFrame.__dataclass_fields__}
    with pytest.raises(InputError, match="render_labelled"):
        OracleDetector().detect([RGBDFrame(**known)])
    with pytest.raises(InputError, match="'left'"):
        OracleDetector("left").detect([frame])
    for wrong in ({"wrong_class": 1.2}, {"drop_out": -0.1}, {"box_std": -1.0}, {"place_std": float("nan")}):
        with pytest.raises(InputError, match=next(iter(wrong)).split("_")[0]):
            OracleDetector(**wrong)
    assert found(frame, frame.objects[0].box).image_size == (240, 135)

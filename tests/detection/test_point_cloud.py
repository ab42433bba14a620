from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from detection_world import COLOR, FLOOR, MIDDLE, SIZE, cuboid, faces, room, seen, shelf
from omegaconf import OmegaConf

from eaip_prob.config import build, conf_dir
from eaip_prob.detection.base import CLASSES
from eaip_prob.detection.point_cloud import PointCloudDetector, shape_of
from eaip_prob.errors import InputError
from eaip_prob.simulation import Part, joined

SHAPES = {"bookshelf": (0.62, 0.32, 0.9, 0.6), "table": (0.9, 0.6, 0.7, 0.85)}
BODY = cuboid("body", (-0.2, -0.3, FLOOR), (0.3, 0.3, 0.7))
ARM = cuboid("arm", (0.0, -0.60, 0.05), (0.8, -0.53, 0.12))
BAG = cuboid("bag", (0.8, -0.4, 0.3), (1.7, 0.4, 0.32), (0.8, 0.8, 0.8))
TRUTH = np.array([*MIDDLE, FLOOR + SIZE[2] / 2, *SIZE])


def frames(*parts, cameras=("left", "overhead", "right")):
    return [seen(room(*parts), name) for name in cameras]


def table(height: float) -> Part:
    """A top on one thin leg that no camera sees but for its foot."""
    low, high = (0.75, -0.2), (1.25, 0.3)
    foot = cuboid("foot", (*low, FLOOR), (*high, FLOOR + 0.06)).mesh
    top = cuboid("top", (*low, FLOOR + height - 0.06), (*high, FLOOR + height)).mesh
    return Part("thing", joined([foot, top]))


@pytest.mark.parametrize("others", [(), (BODY, ARM), (ARM, BAG)], ids=["alone", "robot", "bag"])
def test_the_object_is_found_whatever_is_held_above_it(others):
    answer = PointCloudDetector(SHAPES).detect(frames(shelf(), *others))
    assert answer.labels == ("bookshelf",) and answer.score[0] > 0.9
    assert np.abs(faces(answer.place[0]) - faces(TRUTH)).max() < 0.04
    assert faces(answer.place[0])[2] == pytest.approx(FLOOR, abs=1e-3)
    assert answer.place_covariance[0].diagonal().max() < 0.001


def test_the_box_in_the_image_is_that_of_the_whole_object():
    board = cuboid("board", (0.2, -1.0, 0.2), (1.5, -0.96, 0.4))
    given = frames(shelf(), board)
    truth = given[2].objects[0]
    answer = PointCloudDetector(SHAPES).detect(given)
    assert truth.covered > 0.1 and answer.image_size == (COLOR.width, COLOR.height)
    # The lowest row of voxels above the floor is three pixels high.
    assert (np.abs(answer.box[0] - truth.box) < [1.0, 2.0, 2.0, 3.5]).all()
    left = PointCloudDetector(SHAPES, "left").detect(given)
    assert left.box[0] == pytest.approx(given[0].objects[0].box, abs=3.0)


def test_the_box_is_where_the_colour_camera_sees_it():
    given = frames(shelf())
    beside = given[2].T_color_depth.copy()
    beside[0, 3] += 0.2
    moved = PointCloudDetector(SHAPES).detect([*given[:2], replace(given[2], T_color_depth=beside)])
    shift = moved.box[0, 0] - PointCloudDetector(SHAPES).detect(given).box[0, 0]
    assert shift == pytest.approx(COLOR.fx * 0.2 / 2.1, rel=0.1)  # 2.1 m away


def test_parts_above_each_other_are_one_object():
    answer = PointCloudDetector({"table": (0.5, 0.5, 0.7, 0.9), "chair": (0.5, 0.5, 1.0, 0.9)}).detect(
        frames(table(0.7))
    )
    assert answer.labels == ("table",) and answer.place[0, 5] == pytest.approx(0.7, abs=0.03)


def test_a_bag_that_touches_the_object_makes_its_top_uncertain():
    wide = cuboid("bag", (0.9, -0.4, FLOOR + 0.9), (1.7, 0.4, FLOOR + 0.94), (0.8, 0.8, 0.8))
    (free,), (tied,) = (
        PointCloudDetector(SHAPES).detect(frames(shelf(), *more)).place_covariance for more in ((), (wide,))
    )
    answer = PointCloudDetector(SHAPES).detect(frames(shelf(), wide))
    assert (tied.diagonal() > 10.0 * free.diagonal()).all()
    error = answer.place[0] - TRUTH
    assert error @ np.linalg.solve(tied, error) / 6.0 < 2.0 and np.abs(error[:2]).max() < 0.1


def test_nothing_is_found_where_nothing_stands():
    for parts in ((), (ARM, BAG), (cuboid("afar", (2.0, -0.3, FLOOR), (2.5, 0.3, 0.0)),)):
        scene = room(*parts, cuboid("thing", (9.0, 9.0, 0.0), (9.1, 9.1, 0.1)))
        answer = PointCloudDetector(SHAPES).detect([seen(scene, name) for name in ("left", "right")])
        assert len(answer) == 0 and answer.image_size == (COLOR.width, COLOR.height)
    blind = seen(room(shelf()))
    blind.valid[:] = False
    assert len(PointCloudDetector(SHAPES).detect([blind])) == 0


def test_the_nearest_shape_gives_the_name_and_its_score():
    detector = PointCloudDetector({"table": (0.8, 0.5, 0.7, 0.8), "chair": (0.6, 0.5, 0.7, 0.8)})
    label, score = detector._named(np.array([0.74, 0.5, 0.7, 0.8]))
    assert (label, score) == ("table", pytest.approx(1.0 / (1.0 + np.exp((0.06**2 - 0.14**2) / 0.02))))


def test_the_shape_does_not_depend_on_how_the_object_is_turned():
    generator = np.random.default_rng(0)
    points = generator.uniform([-0.4, -0.2, 0.0], [0.4, 0.2, 1.0], (4000, 3))
    turn = np.array([[np.cos(0.7), -np.sin(0.7), 0], [np.sin(0.7), np.cos(0.7), 0], [0, 0, 1.0]])
    for moved in (points, points @ turn.T + [1.0, 2.0, -0.93]):
        assert shape_of(moved, moved[:, 2].min()) == pytest.approx([0.8, 0.4, 1.0, 0.5], abs=0.01)


def test_the_detector_is_built_from_its_configuration():
    detector = build(OmegaConf.load(conf_dir() / "detector" / "point_cloud.yaml"))
    assert set(detector.shapes) == set(CLASSES)
    assert len(detector.detect(frames(shelf()))) == 1


def test_what_does_not_fit_is_refused():
    with pytest.raises(InputError, match="'right'"):
        PointCloudDetector(SHAPES).detect(frames(shelf(), cameras=("left",)))
    for wrong in ({}, {"sofa": (1, 1, 1, 1)}, {"table": (1.0, 1.0)}):
        with pytest.raises(InputError, match="shapes"):
            PointCloudDetector(wrong)
    with pytest.raises(InputError, match="largest_height"):
        PointCloudDetector(SHAPES, largest_height=0.0)

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from detection_world import FLOOR, MIDDLE, SIZE, camera, cuboid, faces, found, room, seen, shelf

from eaip_prob.data.frames import pixel_rays
from eaip_prob.detection._placing_loops import steady_points
from eaip_prob.detection.base import AbstractImageDetector, Detections
from eaip_prob.detection.placing import floor_height, joined_parts, placed
from eaip_prob.detection.placing_box import UprightBox, VoxelGrid, seen_box
from eaip_prob.errors import ShapeError
from eaip_prob.perception import clusters, registered
from eaip_prob.perception.fusion import PointCloud
from eaip_prob.simulation import KinectNoise
from eaip_prob.simulation.oracle import render_labelled

TRUTH = np.array([*MIDDLE, FLOOR + SIZE[2] / 2, *SIZE])
BEHIND = cuboid("person", (0.6, 0.75, FLOOR), (1.4, 1.0, 0.9), (0.2, 0.2, 0.6))
ARM = cuboid("arm", (0.0, -0.72, -0.35), (1.6, -0.68, -0.31), (0.7, 0.1, 0.1))
BAG = cuboid("bag", (0.4, -0.3, 0.32), (1.6, 0.5, 0.34), (0.8, 0.8, 0.8))


def of_shelf(*others, name="right"):
    frame = seen(room(shelf(), *others), name)
    return placed(found(frame, frame.objects[0].box), frame), frame


@pytest.mark.parametrize("others", [(), (BEHIND,), (BEHIND, BAG), (ARM, BAG)], ids=["alone", "behind", "bag", "arm"])
def test_a_box_on_the_floor_is_placed_whatever_is_around(others):
    placed_, _ = of_shelf(*others)
    error = faces(placed_.place[0]) - faces(TRUTH)
    assert np.abs(error).max() < 0.045  # coarse images: a pixel is 2 cm there
    assert abs(error[2]) < 1e-3  # it stands on the floor


def test_the_face_that_looks_away_is_the_uncertain_one():
    right, left = (of_shelf(name=name)[0].place_covariance[0] for name in ("right", "left"))
    for covariance in (right, left):
        assert np.linalg.eigvalsh(covariance).min() > 0.0
        assert covariance[4, 4] > 2.0 * covariance[5, 5] and covariance[4, 4] > 2.0 * covariance[3, 3]
    # A far face beyond the points moves centre and length together, towards opposite sides for the two cameras.
    assert right[1, 4] > 0.0 > left[1, 4]


def test_registered_colour_gives_the_same_place():
    frame = registered(seen(room(shelf())))
    shown = np.argwhere(frame.valid & (frame.color[..., 0].astype(int) - frame.color[..., 2] > 40))
    low, high = shown.min(0)[::-1], shown.max(0)[::-1]
    size = (frame.color.shape[1], frame.color.shape[0])
    detection = Detections(("table",), np.ones(1), np.array([[*(low + high) / 2, *(high - low + 1)]]), size)
    assert placed(detection, frame).place[0] == pytest.approx(TRUTH, abs=0.07)


def test_what_is_hidden_widens_the_covariance_on_its_side():
    whole, frame = of_shelf()
    wall = cuboid("wall", (0.5, -0.9, FLOOR), (0.72, -0.86, 0.9), (0.9, 0.9, 0.9))
    hidden = seen(room(shelf(), wall))
    answer = placed(found(hidden, frame.objects[0].box), hidden)
    error = answer.place[0] - TRUTH
    assert abs(error[3]) > 0.1  # what is seen is narrower
    assert answer.place_covariance[0, 3, 3] > 25.0 * whole.place_covariance[0, 3, 3]
    assert answer.place_covariance[0, 0, 3] < 0.0  # the lower face is the hidden one
    assert abs(error[3]) < 3.0 * np.sqrt(answer.place_covariance[0, 3, 3])


def test_without_enough_depth_there_is_no_place():
    _, frame = of_shelf()
    blind = replace(frame, valid=np.zeros_like(frame.valid))
    for other, box in ((blind, frame.objects[0].box), (frame, np.array([30.0, 110.0, 20.0, 20.0]))):
        answer = placed(found(other, box), other)
        assert np.isnan(answer.place).all() and np.isnan(answer.place_covariance).all()
    assert placed(Detections.none((240, 135)), frame).place.shape == (0, 6)


def test_each_detection_gets_its_own_place_and_nothing_is_written_to():
    other = cuboid("other", (0.3, -0.7, FLOOR), (0.6, -0.4, FLOOR + 0.4))
    frame = seen(room(shelf((1.2, 0.3)), other))
    both, _ = render_labelled(room(shelf((1.2, 0.3)), other), camera(), 0.0, {"thing": "chair", "other": "table"})
    boxes = np.stack([one.box for one in both.objects])
    before = (frame.depth.copy(), boxes.copy())
    answer = placed(Detections(("chair", "table"), np.array([0.9, 0.8]), boxes, (240, 135)), frame)
    for place, truth in zip(answer.place, both.objects, strict=True):
        assert np.abs(faces(place) - faces(truth.place)).max() < 0.06
    assert np.array_equal(before[0], frame.depth) and np.array_equal(before[1], boxes)


def test_a_given_floor_is_believed():
    _, frame = of_shelf()
    low = placed(found(frame, frame.objects[0].box), frame, floor=FLOOR - 0.01)
    assert faces(low.place[0])[2] == pytest.approx(FLOOR - 0.01)


def test_boxes_of_another_image_are_refused():
    _, frame = of_shelf()
    with pytest.raises(ShapeError, match=r"\(240, 135\).*\(960, 540\)"):
        placed(Detections.none((960, 540)), frame)


def test_the_floor_is_the_lowest_plane():
    generator = np.random.default_rng(0)
    plane = generator.uniform(-1.0, 1.0, (4000, 3)) * [1.0, 1.0, 0.003]
    strays = generator.uniform(-1.4, 1.0, (400, 3))
    points = np.concatenate([plane + [0.0, 0.0, -0.93], np.repeat(plane, 3, 0) + [0.0, 0.0, -0.2], strays])
    assert floor_height(points) == pytest.approx(-0.93, abs=1e-3)
    assert floor_height(strays) is None and floor_height(points[:0]) is None


def test_clusters_on_a_grid_are_those_of_a_flood():
    generator = np.random.default_rng(1)
    points = generator.uniform(0.0, 1.0, (1500, 3)) * [1.0, 1.0, 0.2]
    cells = {}
    for index, cell in enumerate(map(tuple, np.floor((points - points.min(0)) / 0.05).astype(int))):
        cells.setdefault(cell, []).append(index)
    left = {cell for cell, members in cells.items() if len(members) >= 3}
    full = sorted(index for cell in left for index in cells[cell])
    expected = set()
    while left:
        border, cluster = [left.pop()], []
        while border:
            cell = border.pop()
            cluster += cells[cell]
            near = {other for other in left if max(abs(a - b) for a, b in zip(cell, other, strict=True)) == 1}
            border, left = [*border, *near], left - near
        expected.add(frozenset(cluster))
    labels = VoxelGrid(points, 0.05, 3).clusters()
    assert np.flatnonzero(labels >= 0).tolist() == full and len(expected) > 3
    assert {frozenset(np.flatnonzero(labels == k).tolist()) for k in range(labels.max() + 1)} == expected
    assert VoxelGrid(points[:0]).clusters().shape == (0,)


def test_clusters_of_solid_things_are_those_of_open3d():
    generator = np.random.default_rng(2)
    points = np.concatenate(
        [generator.uniform(0.0, 0.3, (4000, 3)) + at for at in ([0, 0, 0], [0.5, 0, 0], [0, 0.6, 0])]
    )
    cloud = PointCloud(points, np.zeros(points.shape, np.uint8), np.ones(len(points)))
    labels, others = VoxelGrid(points).clusters(), clusters(cloud, 0.05)
    pairs = {(int(one), int(other)) for one, other in zip(labels, others, strict=True) if one >= 0}
    assert sorted(one for one, _ in pairs) == sorted(other for _, other in pairs) == [0, 1, 2]


def test_parts_far_beside_are_not_joined():
    points = np.array([[0.0, 0, 0], [0.3, 0.3, 0], [0.39, 0.1, 0.5], [0.1, 0.6, 0.0]])
    parts = [np.array([0, 1]), np.array([2]), np.array([3])]
    assert sorted(joined_parts(parts, points, least=1).tolist()) == [0, 1, 2]


def test_covariance_of_a_box_is_that_of_its_faces():
    generator = np.random.default_rng(3)
    low_std, high_std = np.array([0.01, 0.02, 0.03]), np.array([0.05, 0.01, 0.02])
    made = UprightBox.between(np.zeros(3), np.ones(3), low_std, high_std)
    low, high = generator.normal(0.0, low_std, (40000, 3)), generator.normal(1.0, high_std, (40000, 3))
    drawn = np.cov(np.concatenate([(low + high) / 2.0, high - low], 1), rowvar=False)
    assert made.covariance == pytest.approx(drawn, abs=6e-5)
    assert made.place.tolist() == [0.5, 0.5, 0.5, 1.0, 1.0, 1.0]


def test_what_hangs_together_with_the_object_makes_all_of_it_uncertain():
    points = np.random.default_rng(4).uniform(-0.5, 0.5, (500, 3))
    pose = camera().T_world_camera
    free, tangled = (seen_box(points, np.zeros(4), [pose], -0.5, held).covariance.diagonal() for held in (False, True))
    assert (tangled > 1.5 * free).all()


@pytest.mark.slow
def test_the_covariance_is_calibrated_over_noisy_views():
    generator, distances = np.random.default_rng(5), []
    for _ in range(25):
        size = generator.uniform([0.3, 0.25, 0.5], [0.8, 0.6, 1.0])
        thing = shelf(generator.uniform([0.8, -0.2], [1.1, 0.2]), size)
        frame, labels = render_labelled(room(thing, BEHIND), camera(), 0.0, {"thing": "table"})
        noisy = KinectNoise().apply(frame, labels, generator)
        truth = frame.objects[0]
        answer = placed(found(noisy, truth.box * generator.normal(1.0, [0.0, 0.0, 0.02, 0.02])), noisy)
        error = answer.place[0] - truth.place
        distances.append(error @ np.linalg.solve(answer.place_covariance[0], error) / 6.0)
    assert 0.2 < np.mean(distances) < 2.5


# A heap of bag at the feet, from before the object to beyond the box and out of the workspace.
HEAP = cuboid("bag", (-0.2, -0.6, FLOOR), (2.2, 0.05, FLOOR + 0.25), (0.8, 0.8, 0.8))


@pytest.mark.parametrize("names", [("right",), ("right", "overhead", "left")], ids=["one camera", "three"])
def test_a_bag_at_the_feet_does_not_make_the_object_larger(names):
    frames = [seen(room(shelf(), HEAP), name) for name in names]
    answer = placed(found(frames[0], frames[0].objects[0].box), frames[0], others=frames[1:])
    error = faces(answer.place[0]) - faces(TRUTH)
    assert np.abs(error).max() < 0.06
    # What of the feet the heap may hide is said.
    assert (np.sqrt(np.diag(answer.place_covariance[0]))[3:5] > 0.05).all()


@pytest.mark.parametrize("higher", [-0.02, 0.05], ids=["below the top", "above it"])
def test_a_bag_close_beside_the_whole_object_is_told_from_it_by_the_gap(higher):
    front = MIDDLE[1] - SIZE[1] / 2.0
    # Coarse voxels are as wide as 7 pixels, 14 cm here, and close the gap at all heights; fine ones are 8 cm wide.
    bag = cuboid("bag", (-0.2, front - 0.5, FLOOR), (2.2, front - 0.2, FLOOR + SIZE[2] + higher), (0.8, 0.8, 0.8))
    frames = [seen(room(shelf(), bag), name) for name in ("right", "overhead", "left")]
    answer = placed(found(frames[0], frames[0].objects[0].box), frames[0], others=frames[1:])
    assert np.abs(faces(answer.place[0]) - faces(TRUTH)).max() < 0.02
    assert (np.sqrt(np.diag(answer.place_covariance[0]))[3:5] > 0.05).all()  # the bag may have been touching it


def test_other_cameras_show_the_faces_that_one_does_not():
    wide = (0.7, 0.6, 0.5)  # the top alone tells of its far edge, which a wall of bag before it hides
    front = cuboid("bag", (0.5, -0.55, FLOOR), (1.4, -0.5, FLOOR + 0.75), (0.8, 0.8, 0.8))
    frames = [seen(room(shelf(MIDDLE, wide), front), name) for name in ("right", "overhead", "left")]
    box = frames[0].objects[0].box
    alone = placed(found(frames[0], box), frames[0])
    together = placed(found(frames[0], box), frames[0], others=frames[1:])
    truth = np.array([*MIDDLE, FLOOR + wide[2] / 2, *wide])
    assert np.abs(faces(together.place[0]) - faces(truth)).max() < 0.05
    deviation = [np.sqrt(np.diag(answer.place_covariance[0])) for answer in (alone, together)]
    assert np.isnan(deviation[0]).any() or deviation[1][4] < deviation[0][4]


def test_frames_of_another_moment_say_nothing_of_places():
    class Told(AbstractImageDetector):
        def detect_image(self, image):
            return found(early, early.objects[0].box)

    early, late = seen(room(shelf()), "right"), seen(room(shelf((0.95, 0.4))), "left", time=0.5)
    beside = replace(seen(room(shelf()), "left"), time=0.0)
    alone, with_late, with_beside = (
        Told().detect(frames).place for frames in ([early], [early, late], [early, beside])
    )
    assert np.array_equal(alone, with_late) and not np.array_equal(alone, with_beside)


def test_points_are_those_of_a_loop_over_pixels():
    frame = KinectNoise().apply(*render_labelled(room(shelf()), camera(), 0.0, {}), np.random.default_rng(0))
    height, width = frame.depth.shape
    expected = []
    for i in range(0, height, 2):
        for j in range(0, width, 2):
            rows, columns = range(max(i - 1, 0), min(i + 2, height)), range(max(j - 1, 0), min(j + 2, width))
            around = [(row, column) for row in rows for column in columns]
            depth = float(frame.depth[i, j])
            near = [at for at in around if frame.valid[at] and abs(float(frame.depth[at]) - depth) < 0.05 * depth]
            if frame.valid[i, j] and len(near) - 1 >= 3:
                point = frame.T_world_camera @ [*(frame.intrinsics.rays[i, j] * depth), depth, 1.0]
                expected += [point[:3]] if point[2] > -0.5 else []
    rays = pixel_rays(frame.intrinsics, 2)
    came = steady_points(frame.depth, frame.valid, rays, 2, 0.05, 3, frame.T_world_camera, -0.5)
    assert len(expected) > 100
    np.testing.assert_allclose(came, expected, atol=1e-12)


def test_clusters_of_chosen_voxels_are_those_of_their_points():
    points = np.random.default_rng(6).uniform(0.0, 1.0, (4000, 3))
    grid = VoxelGrid(points, 0.1)
    above = grid.clusters(grid.low >= 0.5)
    at = np.flatnonzero(above >= 0)
    assert 0 < len(at) < len(points) and points[at, 2].min() >= 0.45
    alone = VoxelGrid(points[at], 0.1, least=1).clusters()
    assert (above[at] == 0).all() and (alone == 0).all()

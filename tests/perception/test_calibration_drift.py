from __future__ import annotations

import numpy as np
import pytest
from scene_world import from_conf
from scipy.spatial.transform import Rotation

from eaip_prob.errors import InputError, ShapeError
from eaip_prob.perception.drift import drift
from eaip_prob.perception.registration import depth_colors
from eaip_prob.simulation import KinectNoise, render_rgbd


def clouds(generator, count=20000, noise=0.002):
    """A bumpy, patterned piece of a surface, sampled anew at each call."""
    x, y = generator.uniform(0.0, 0.8, (2, count))
    points = np.column_stack([x, y, 0.08 * np.sin(9.0 * x) * np.cos(7.0 * y)])
    colors = np.column_stack([127.0 + 120.0 * np.sin(25.0 * x), 127.0 + 120.0 * np.cos(18.0 * y), 90.0 + 0.0 * x])
    return points + generator.normal(0.0, noise, points.shape), colors.astype(np.uint8)


@pytest.mark.slow
@pytest.mark.parametrize(("shift", "angle"), [(0.0, 0.0), (0.006, 0.0), (0.004, 0.5), (0.015, 1.0)])
def test_drift_is_what_the_second_cloud_was_moved_by(shift, angle):
    rng = np.random.default_rng(1)
    (points_a, colors_a), (points_b, colors_b) = clouds(rng), clouds(rng)
    turn = Rotation.from_rotvec([0.0, 0.0, np.radians(angle)])
    centre = points_a.mean(0)
    moved = turn.apply(points_b - centre) + centre + (0.6 * shift, 0.0, 0.8 * shift)
    before = points_a.copy()
    found = drift(points_a, colors_a, moved, colors_b)
    assert found.error.millimetres == pytest.approx(1e3 * shift, abs=0.8)
    assert found.error.degrees == pytest.approx(angle, abs=0.1)
    assert found.overlap > 0.9
    np.testing.assert_array_equal(points_a, before)


@pytest.mark.slow
def test_clouds_apart_are_refused():
    points, colors = clouds(np.random.default_rng(2), count=2000)
    with pytest.raises(InputError, match="clouds of one scene, got 0%"):
        drift(points, colors, points + 3.0, colors)


def seen_cloud(camera, noise, seed):
    """Points and colours, near the object, of the covering scene as one camera says."""
    workspace = from_conf("workspace/bag_covering", thing=from_conf("object/brown_bookshelf"))
    hands = np.array([[1.35, -0.3, 0.1], [1.35, 0.3, 0.1]])
    scene = workspace.scene(hands, np.array([[0.75, 0.3, 0.1], [0.75, -0.3, 0.1]]))
    frame = noise.apply(*render_rgbd(scene, camera, 0.0), np.random.default_rng(seed))
    colors, seen = depth_colors(frame)
    use, points = seen[frame.valid], frame.points()
    use &= (np.abs(points - (1.1, 0.0, 0.0)) < (1.2, 1.2, 1.5)).all(1)
    return points[use], colors[frame.valid][use]


def drifted(camera, shift, degrees):
    """A camera that turned about its own place, as the motion of its points in the world."""
    place, result = camera.T_world_camera[:3, 3], np.eye(4)
    result[:3, :3] = Rotation.from_rotvec([0.0, 0.0, np.radians(degrees)]).as_matrix()
    result[:3, 3] = place - result[:3, :3] @ place + np.array([0.6, 0.8, 0.0]) * shift
    return result


@pytest.mark.slow
def test_a_camera_that_was_moved_is_told_from_one_that_was_not():
    left, overhead, _ = from_conf("rig/three_kinects").cameras(from_conf("camera/kinect_v2"))
    points, colors = seen_cloud(left, KinectNoise(), 1)
    other = seen_cloud(overhead, KinectNoise(), 2)
    for shift, degrees in ((0.0, 0.0), (0.01, 0.5)):
        move = drifted(left, shift, degrees)
        moved, before = points @ move[:3, :3].T + move[:3, 3], left.T_world_camera.copy()
        found = drift(moved, colors, *other)
        truth = np.linalg.norm(points.mean(0) - moved.mean(0))
        assert found.needs_calibration == (shift > 0.0)
        assert found.error.position == pytest.approx(truth, abs=0.005)
        assert found.error.degrees == pytest.approx(degrees, abs=0.3)
        np.testing.assert_array_equal(left.T_world_camera, before)


@pytest.mark.parametrize(
    ("points", "colors", "error", "message"),
    [
        (np.zeros((300, 2)), np.zeros((300, 2), np.uint8), ShapeError, r"points_b \(P, 3\)"),
        (np.zeros((300, 3)), np.zeros((299, 3), np.uint8), ShapeError, "a colour for each"),
        (np.zeros((9, 3)), np.zeros((9, 3), np.uint8), InputError, "200 or more"),
        (np.full((300, 3), np.nan), np.zeros((300, 3), np.uint8), InputError, "finite points in points_b"),
    ],
)
def test_bad_clouds_are_refused(points, colors, error, message):
    good = np.zeros((300, 3))
    with pytest.raises(error, match=message):
        drift(good, good.astype(np.uint8), points, colors)

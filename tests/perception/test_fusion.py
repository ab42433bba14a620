from __future__ import annotations

from dataclasses import replace

import glove_world as world
import numpy as np
import pytest

from eaip_prob.errors import InputError, ShapeError
from eaip_prob.perception.fusion import PointCloud, clusters, from_open3d, fuse, inliers, to_open3d
from eaip_prob.perception.glove_offset import depth_sigma

HANDS = world.gloves((0.9, -0.3, 0.1), (0.8, 0.3, 0.2))
CROP = ((0.2, 1.5), (-0.8, 0.8), (-0.5, 0.9))


@pytest.fixture(scope="module")
def frames():
    return [world.frame(name, HANDS, 0.0, scale=0.25) for name in world.CAMERAS]


def test_every_voxel_is_the_weighted_mean_of_its_points(frames):
    sums: dict[tuple, np.ndarray] = {}
    for frame in frames:
        points, z = frame.points(), frame.depth[frame.valid].astype(float)
        for point, weight in zip(points, 1.0 / depth_sigma(z) ** 2, strict=True):
            if all(low <= value < high for value, (low, high) in zip(point, CROP, strict=True)):
                key = tuple(np.floor(point / 0.02).astype(int))
                sums[key] = sums.get(key, np.zeros(4)) + weight * np.append(point, 1.0)
    cloud = fuse(frames, CROP, voxel=0.02)
    found = {tuple(np.floor(p / 0.02).astype(int)): (p, v) for p, v in zip(cloud.points, cloud.variance, strict=True)}
    assert len(cloud) == len(sums) == len(found) > 50
    for key, total in sums.items():
        np.testing.assert_allclose(found[key][0], total[:3] / total[3], atol=1e-9)
        assert found[key][1] == pytest.approx(1.0 / total[3])


def test_colours_are_those_of_the_surface(frames):
    cloud = fuse(frames, CROP, voxel=0.005)
    away = np.stack([np.linalg.norm(cloud.points - center, axis=1) for center, _, _ in HANDS])
    glove, painted = np.abs(away.min(0) - 0.05) < 1e-3, cloud.colors.any(1)
    green = np.abs(cloud.colors.astype(int) - world.GREEN).max(1) < 30
    assert green[glove & painted].mean() > 0.8 and not green[~glove].any()


def test_cloud_does_not_depend_on_the_order_of_the_cameras(frames):
    one, other = fuse(frames, CROP), fuse(frames[::-1], CROP)
    key = [np.lexsort(np.floor(cloud.points / 0.01).T) for cloud in (one, other)]
    np.testing.assert_allclose(one.points[key[0]], other.points[key[1]], atol=1e-12)
    np.testing.assert_array_equal(one.colors[key[0]], other.colors[key[1]])


def test_variance_is_that_of_the_mean():
    """A wall at 2 m seen a hundred times: the spread of a voxel's point along the line of sight."""
    generator, found = np.random.default_rng(0), []
    camera = world.KINECT.scaled(32, 26)
    clean = np.full((26, 32), 2.0)
    for _ in range(100):
        depth = (clean + depth_sigma(clean) * generator.standard_normal(clean.shape)).astype(np.float32)
        color = np.zeros((26, 32, 3), np.uint8)
        frame = world.RGBDFrame(color, depth, depth > 0, camera, np.eye(4), 0.0)
        cloud = fuse([frame, frame], ((-9, 9), (-9, 9), (1, 3)), voxel=4.0)  # four voxels: signs of x and y
        found.append((cloud.points[:, 2], cloud.variance))
    z, variance = np.array([a for a, _ in found]), np.array([b for _, b in found])
    # the same frame twice: twice the information is claimed, half of it is there
    assert z.var(0) / variance.mean(0) == pytest.approx(np.full(4, 2.0), rel=0.5)


def test_empty_space_is_an_empty_cloud(frames):
    cloud = fuse(frames, ((5.0, 6.0), (0.0, 1.0), (0.0, 1.0)))
    assert len(cloud) == 0 and len(inliers(cloud)) == 0 and len(clusters(cloud)) == 0


@pytest.mark.parametrize(
    ("change", "message"),
    [({"frames": []}, "at least one frame"), ({"voxel": 0.0}, "above zero"), ({"crop": ((1, 0),) * 3}, "lowest")],
)
def test_wrong_arguments_are_named(frames, change, message):
    with pytest.raises(InputError, match=message):
        fuse(**{"frames": frames, **change})


def test_voxels_far_too_small_are_refused(frames):
    with pytest.raises(InputError, match="larger voxel"):
        fuse(frames, voxel=1e-7)


def test_open3d_and_back(frames):
    cloud = fuse(frames, CROP)
    again = from_open3d(to_open3d(cloud), variance=1e-6)
    np.testing.assert_array_equal(again.points, cloud.points)
    np.testing.assert_array_equal(again.colors, cloud.colors)


def test_gloves_are_two_clusters(frames):
    cloud = fuse(frames, ((0.6, 1.1), (-0.5, 0.5), (0.0, 0.5)), voxel=0.005)
    label = clusters(cloud, distance=0.05, least=4)
    assert set(label[label >= 0]) == {0, 1}
    assert np.ptp(cloud.points[label == 0, 1]) < 0.12


def test_parts_of_a_cloud_belong_together():
    with pytest.raises(ShapeError, match="variance"):
        PointCloud(np.zeros((2, 3)), np.zeros((2, 3), np.uint8), np.zeros(3))


def test_frames_of_different_times_are_refused(frames):
    late = [frames[0], replace(frames[1], time=1 / 30), frames[2]]
    with pytest.raises(InputError, match=r"'left' at 0\.000 s and 'overhead' at 0\.033 s.*apart=SECONDS"):
        fuse(late, CROP)
    half = [frames[0], replace(frames[1], time=1 / 61), frames[2]]
    for given, apart in ((half, 1 / 60), (late, 0.05)):
        cloud = fuse(given, CROP, apart=apart)
        assert np.array_equal(cloud.points, fuse(frames, CROP).points)

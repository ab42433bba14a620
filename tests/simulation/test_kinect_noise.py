from __future__ import annotations

import dataclasses
import math

import numpy as np
import pytest
from scene_world import small_camera, two_boxes

from eaip_prob.data.frames import Intrinsics, RGBDFrame
from eaip_prob.errors import InputError, ShapeError
from eaip_prob.simulation import KinectNoise, Labels, camera_generators, render_rgbd

QUIET = KinectNoise(axial=0.0, lateral=0.0, flying=0.0, color=0.0)
CAMERA = Intrinsics(200, 150, 150.0, 150.0, 99.5, 74.5)


def plane(depth=2.0, incidence=0.0, color=100):
    image = np.broadcast_to(np.asarray(depth, np.float32), (150, 200)).copy()
    frame = RGBDFrame(
        np.full((150, 200, 3), color, np.uint8), image, np.ones((150, 200), bool), CAMERA, np.eye(4), time=0.0
    )
    angle = np.full((150, 200), incidence, np.float32)
    return frame, Labels(image, np.zeros((150, 200), np.int32), np.zeros((150, 200, 3), np.float32), angle)


def step():
    return plane(np.where(np.arange(200) < 100, 1.0, 2.0)[None])


def beyond(x):
    return math.erfc(x / math.sqrt(2)) / 2


def rng(seed=0):
    return np.random.default_rng(seed)


@pytest.mark.parametrize(("depth", "incidence"), [(0.8, 0.0), (2.0, 0.6), (3.5, 1.2)])
def test_the_spread_of_depth_is_the_published_one(depth, incidence):
    noise = dataclasses.replace(QUIET, axial=1.0, step=1e-6)
    error = noise.apply(*plane(depth, incidence), rng()).depth.astype(float) - depth
    tilt = 0.1 * depth**1.5 * incidence**2 / (np.pi / 2 - incidence) ** 2
    sigma = (1.5 - 0.5 * depth + 0.3 * depth**2 + tilt) / 1000
    assert error.std() == pytest.approx(sigma, rel=4 / np.sqrt(2 * error.size))
    assert abs(error.mean()) < 4 * sigma / np.sqrt(error.size)
    assert noise.sigma(np.float32(depth), np.float32(incidence)) == pytest.approx(sigma, rel=1e-5)


def test_axial_is_a_multiple_and_offset_a_shift():
    both = dataclasses.replace(QUIET, axial=2.0, offset=-0.03)
    error = both.apply(*plane(), rng()).depth.astype(float) - 2.0
    assert error.mean() == pytest.approx(-0.03, abs=2e-4) and error.std() == pytest.approx(0.0034, rel=0.05)


def test_depth_is_rounded_to_steps():
    depth = dataclasses.replace(QUIET, axial=1.0).apply(*plane(), rng()).depth.astype(float)
    assert np.abs(depth * 1000 - np.rint(depth * 1000)).max() < 1e-3 and len(np.unique(depth)) > 5


@pytest.mark.parametrize(("depth", "seen"), [(0.499, False), (0.501, True), (4.499, True), (4.501, False)])
def test_only_what_is_in_range_is_measured(depth, seen):
    frame = QUIET.apply(*plane(depth), rng())
    assert frame.valid.all() == frame.valid.any() == seen


@pytest.mark.parametrize(("degrees", "seen"), [(84.9, True), (85.1, False)])
def test_a_grazing_surface_is_lost(degrees, seen):
    frame = QUIET.apply(*plane(incidence=np.radians(degrees)), rng())
    assert frame.valid.all() == frame.valid.any() == seen


def test_flying_pixels_lie_between_both_sides_of_an_edge_and_nowhere_else():
    frame = dataclasses.replace(QUIET, flying=0.4).apply(*step(), rng())
    flying = (frame.depth > 1.001) & (frame.depth < 1.999)
    assert set(np.flatnonzero(flying.any(0))) == {99, 100}
    share = flying[:, 99:101].mean()
    assert share == pytest.approx(0.4, abs=4 * np.sqrt(0.24 / 300))
    assert frame.depth[flying].mean() == pytest.approx(1.5, abs=4 * np.sqrt(1 / 12 / flying.sum()))


def test_the_lateral_error_moves_edges_by_its_share_of_pixels():
    # At 1 m, 150 px of focal length make 0.006 m into 0.9 px, at 2 m into 0.45 px.
    frame = dataclasses.replace(QUIET, lateral=0.006).apply(*step(), rng())
    near_side = (frame.depth[:, 99] > 1.5).mean()
    far_side = (frame.depth[:, 100] < 1.5).mean()
    assert near_side == pytest.approx(beyond(0.5 / 0.9), abs=4 * np.sqrt(0.25 / 150))
    assert far_side == pytest.approx(beyond(0.5 / 0.45), abs=4 * np.sqrt(0.15 / 150))
    assert (frame.depth[:, :95] == 1.0).all() and (frame.depth[:, 106:] == 2.0).all()


def test_colour_noise_has_its_spread_and_no_bias():
    color = dataclasses.replace(QUIET, color=4.0).apply(*plane(color=100), rng()).color.astype(float)
    assert color.std() == pytest.approx(np.sqrt(16 + 1 / 12), rel=0.02)
    assert color.mean() == pytest.approx(100.0, abs=4 * 4 / np.sqrt(color.size))
    assert dataclasses.replace(QUIET, color=9.0).apply(*plane(color=254), rng()).color.min() > 150


def test_one_seed_gives_one_frame_and_each_camera_its_own():
    pair = render_rgbd(two_boxes(), small_camera(), 0.0)
    before = pair[0].depth.copy(), pair[1].depth.copy(), pair[1].incidence.copy(), pair[0].color.copy()
    draws = [camera_generators(seed, ["left", "right"]) for seed in (3, 3, 4)]
    frames = [KinectNoise().apply(*pair, generators[name]) for generators in draws for name in ("left", "right")]
    same = [np.array_equal(frames[0].depth, frame.depth) for frame in frames]
    assert same == [True, False, True, False, False, False]
    after = pair[0].depth, pair[1].depth, pair[1].incidence, pair[0].color
    assert all(np.array_equal(a, b) for a, b in zip(before, after, strict=True))
    only_left = camera_generators(3, ["left"])["left"]
    assert np.array_equal(KinectNoise().apply(*pair, only_left).depth, frames[0].depth)


def test_what_is_no_noise_is_refused():
    with pytest.raises(InputError, match="at least zero"):
        KinectNoise(lateral=-0.1)
    with pytest.raises(InputError, match="near < far"):
        KinectNoise(near=5.0)
    frame, labels = plane()
    with pytest.raises(ShapeError, match="came with the frame"):
        KinectNoise().apply(frame, render_rgbd(two_boxes(), small_camera(), 0.0)[1], rng())
    assert labels.hit.all()

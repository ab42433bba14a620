from __future__ import annotations

from dataclasses import replace

import cv2
import numpy as np
import pytest

from eaip_prob.data.frames import Intrinsics, RGBDFrame
from eaip_prob.errors import InputError, ShapeError
from eaip_prob.perception.registration import color_at, depth_colors, registered

# the published Kinect v2, a quarter of its size; see the module on simulated noise for the sources
DEPTH = Intrinsics(512, 424, 365.456, 365.456, 254.878, 205.395, (0.0905, -0.2683, 0.0, 0.0, 0.0951)).scaled(128, 106)
COLOR = Intrinsics(1920, 1080, 1060.7, 1058.6, 956.4, 519.0, (0.054, -0.068, 0.0, 0.0, 0.0)).scaled(480, 270)
FAR, NEAR = 2.0, 1.0
LEFT, RIGHT, TOP, BOTTOM = -0.15, 0.2, -0.12, 0.16  # of the near plane, m
RED, GREEN = (200, 10, 10), (10, 200, 10)


def beside(x=-0.12, y=0.01, z=0.005, angle=0.02):
    turn, _ = cv2.Rodrigues(np.array([angle, -angle, 0.5 * angle]))
    transform = np.eye(4)
    transform[:3, :3], transform[:3, 3] = turn, (x, y, z)
    return transform


def on_near(points):
    return (points[..., 0] > LEFT) & (points[..., 0] < RIGHT) & (points[..., 1] > TOP) & (points[..., 1] < BOTTOM)


def crossing(origin, directions, z):
    """Where rays from `origin` (3,) meet the plane at depth z in depth camera coordinates."""
    return origin + directions * ((z - origin[2]) / directions[..., 2])[..., None]


def scene(T_color_depth):
    """Frame of a red plane behind a green rectangle, and the truth: which pixels the colour camera cannot see."""
    rays = np.concatenate([DEPTH.rays, np.ones((*DEPTH.rays.shape[:2], 1))], -1)
    near = on_near(rays * NEAR)
    depth = np.where(near, NEAR, FAR).astype(np.float32)
    turn = T_color_depth[:3, :3]
    origin = -turn.T @ T_color_depth[:3, 3]
    looks = np.concatenate([COLOR.rays, np.ones((*COLOR.rays.shape[:2], 1))], -1) @ turn
    color = np.where(on_near(crossing(origin, looks, NEAR))[..., None], GREEN, RED).astype(np.uint8)
    points = rays * depth[..., None]
    hidden = ~near & on_near(crossing(origin, points - origin, NEAR))
    frame = RGBDFrame(color, depth, np.ones_like(near), DEPTH, np.eye(4), 0.0, COLOR, T_color_depth)
    return frame, near, hidden


def grown(mask, pixels=1):
    return cv2.dilate(mask.astype(np.uint8), np.ones((2 * pixels + 1, 2 * pixels + 1), np.uint8)).astype(bool)


def inside_color(frame):
    points = np.concatenate([DEPTH.rays, np.ones((106, 128, 1))], -1) * frame.depth[..., None]
    pixels = COLOR.project(points @ frame.T_color_depth[:3, :3].T + frame.T_color_depth[:3, 3])
    return (pixels > -0.5).all(-1) & (pixels[..., 0] < 479.5) & (pixels[..., 1] < 269.5)


@pytest.mark.parametrize("x", [-0.12, 0.12])
def test_hidden_pixels_get_no_colour_and_all_others_theirs(x):
    frame, near, hidden = scene(beside(x))
    color, seen = depth_colors(frame)
    assert hidden.sum() > 150
    assert not (seen & hidden & ~grown(~hidden)).any()
    apart = ~grown(hidden, 2) & inside_color(frame)
    assert seen[apart].all()
    sure = seen & ~(grown(near) & grown(~near))  # the edge of the rectangle is between pixels
    assert (color[sure & near] == GREEN).all()
    assert (color[sure & ~near] == RED).all()
    assert (color[~seen] == 0).all()


def test_colours_are_taken_where_opencv_projects_the_points():
    ramp = np.zeros((270, 480, 3), np.uint8)
    ramp[..., 0], ramp[..., 1] = np.arange(480) // 2, np.arange(270)[:, None] // 2
    frame, _, _ = scene(beside())
    frame = replace(frame, color=ramp)
    color, seen = depth_colors(frame)
    points = np.concatenate([DEPTH.rays, np.ones((106, 128, 1))], -1)[seen] * frame.depth[seen][:, None]
    turn, _ = cv2.Rodrigues(frame.T_color_depth[:3, :3])
    pixels, _ = cv2.projectPoints(points, turn, frame.T_color_depth[:3, 3], COLOR.matrix, np.array(COLOR.distortion))
    expected = np.rint(pixels[:, 0]).astype(int) // 2
    assert np.abs(color[seen][:, :2].astype(int) - expected).max() <= 1
    assert (color[seen][:, :2] == expected).mean() > 0.999  # a pixel's half is rounded either way


def test_what_the_colour_camera_has_no_image_of_is_not_seen():
    frame, _, _ = scene(beside())
    _, seen = depth_colors(frame)
    outside = ~inside_color(frame)
    assert outside[:8].any() and not seen[outside].any()


@pytest.mark.parametrize("axis", [0, 1])
def test_a_steep_surface_does_not_hide_itself(axis):
    # 65 degrees from facing the camera, with noise of a few millimetres
    slope = np.tan(np.radians(65.0))
    depth = 1.5 / (1.0 - slope * DEPTH.rays[..., axis])
    valid = (depth > 0.6) & (depth < 4.0)
    noise = np.random.default_rng(4).normal(0.0, 0.003, depth.shape)
    depth = np.where(valid, depth + noise, 0.0).astype(np.float32)
    frame, _, _ = scene(beside(-0.052, 0.0, 0.0))
    frame = replace(frame, depth=depth, valid=valid)
    _, seen = depth_colors(frame)
    assert seen[valid & inside_color(frame)].mean() > 0.995


def test_some_pixels_get_what_all_would():
    frame, near, hidden = scene(beside())
    color, seen = depth_colors(frame)
    rng = np.random.default_rng(5)
    for chosen in (hidden, near, rng.random(near.shape) > 0.99):
        pixels = rng.permutation(np.argwhere(chosen)[:, ::-1])
        some_color, some_seen = color_at(frame, pixels)
        np.testing.assert_array_equal(some_color, color[pixels[:, 1], pixels[:, 0]])
        np.testing.assert_array_equal(some_seen, seen[pixels[:, 1], pixels[:, 0]])


def test_a_registered_frame_stays_as_it_is():
    frame, _, _ = scene(beside())
    color, seen = depth_colors(frame)
    once = registered(frame)
    assert once.color_intrinsics is None and once.T_color_depth is None
    np.testing.assert_array_equal(once.color, color)
    assert registered(once) is once
    again, seen_again = depth_colors(once)
    np.testing.assert_array_equal(again, color)
    np.testing.assert_array_equal(seen_again, seen)


def test_pixels_without_depth_have_no_colour_and_hide_nothing():
    frame, near, _ = scene(beside())
    depth = np.where(near, np.float32(np.nan), frame.depth)
    frame = replace(frame, depth=depth, valid=~near)
    color, seen = depth_colors(frame)
    assert not seen[near].any() and (color[near] == 0).all()
    assert seen[~near & inside_color(frame)].all()


def test_cameras_at_one_place_hide_nothing():
    frame, _, _ = scene(beside(0.0, 0.0, 0.0))
    assert depth_colors(frame)[1][inside_color(frame)].all()


def test_images_stay_as_they_were():
    frame, _, _ = scene(beside())
    before = frame.color.copy(), frame.depth.copy()
    registered(frame)
    np.testing.assert_array_equal(frame.color, before[0])
    np.testing.assert_array_equal(frame.depth, before[1])


@pytest.mark.parametrize(
    ("pixels", "error", "message"),
    [
        (np.zeros((3, 3), int), ShapeError, r"pixels with shape \(P, 2\), got \(3, 3\)"),
        (np.zeros(2, int), ShapeError, "Give"),
        (np.zeros((3, 2)), InputError, "integers, got float64"),
        (np.array([[128, 0]]), InputError, "inside 128 x 106 px, got columns 128"),
        (np.array([[0, -1]]), InputError, "rows -1"),
    ],
)
def test_bad_pixels_are_refused(pixels, error, message):
    frame, _, _ = scene(beside())
    with pytest.raises(error, match=message):
        color_at(frame, pixels)


def test_no_pixels_have_no_colours():
    frame, _, _ = scene(beside())
    color, seen = color_at(frame, np.zeros((0, 2), int))
    assert color.shape == (0, 3) and seen.shape == (0,)

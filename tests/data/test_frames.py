from __future__ import annotations

from dataclasses import replace

import cv2
import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st

from eaip_prob.data.frames import Intrinsics, RGBDFrame
from eaip_prob.data.lens import distorted, fold_radius, undistorted
from eaip_prob.errors import InputError, ShapeError, UnitsError

KINECT_DEPTH = Intrinsics(512, 424, 365.456, 365.456, 254.878, 205.395, (0.0905, -0.2683, 0.0, 0.0, 0.0951))
KINECT_COLOR = Intrinsics(1920, 1080, 1060.7, 1058.6, 956.4, 519.0, (0.054, -0.068, 0.0, 0.0, 0.0))
SKEWED = Intrinsics(640, 480, 520.0, 500.0, 300.0, 260.0, (-0.2, 0.07, 0.004, -0.003, 0.01))
CAMERAS = [KINECT_DEPTH, KINECT_COLOR, SKEWED]
SMALL = Intrinsics(6, 4, 5.0, 5.5, 2.4, 1.7)


def corners(camera):
    columns, rows = np.meshgrid(np.linspace(0, camera.width - 1, 9), np.linspace(0, camera.height - 1, 7))
    return np.stack([columns, rows], -1).reshape(-1, 2)


def frame(**changes):
    depth = np.linspace(0.5, 3.0, 24, dtype=np.float32).reshape(4, 6)
    given = {
        "color": np.zeros((4, 6, 3), dtype=np.uint8),
        "depth": depth,
        "valid": np.ones((4, 6), dtype=bool),
        "intrinsics": SMALL,
        "T_world_camera": np.eye(4),
        "time": 0.1,
    }
    return RGBDFrame(**(given | changes))


def rotated(angle, offset):
    cos, sin = np.cos(angle), np.sin(angle)
    transform = np.eye(4)
    transform[:3, :3] = [[cos, 0.0, sin], [0.0, 1.0, 0.0], [-sin, 0.0, cos]]
    transform[:3, 3] = offset
    return transform


@pytest.mark.parametrize("camera", CAMERAS)
def test_projection_equals_opencv(camera):
    points = np.random.default_rng(1).uniform([-0.9, -0.6, 1.0], [0.9, 0.6, 3.0], (200, 3))
    theirs, _ = cv2.projectPoints(points, np.zeros(3), np.zeros(3), camera.matrix, np.array(camera.distortion))
    np.testing.assert_allclose(camera.project(points), theirs[:, 0], atol=1e-9)


@pytest.mark.parametrize("camera", CAMERAS)
def test_rays_equal_opencv(camera):
    pixels = corners(camera)
    rays = camera.unproject(pixels, np.ones(len(pixels)))
    criteria = (cv2.TERM_CRITERIA_COUNT | cv2.TERM_CRITERIA_EPS, 500, 1e-14)
    theirs = cv2.undistortPoints(
        pixels[:, None], camera.matrix, np.array(camera.distortion), R=None, P=None, criteria=criteria
    )
    np.testing.assert_allclose(rays[:, :2], theirs[:, 0], atol=1e-9)


@pytest.mark.parametrize("camera", CAMERAS)
def test_every_corner_comes_back_to_round_off(camera):
    pixels, depth = corners(camera), np.linspace(0.5, 4.5, 63)
    points = camera.unproject(pixels, depth)
    np.testing.assert_allclose(points[:, 2], depth)
    np.testing.assert_allclose(camera.project(points), pixels, atol=1e-10)


@given(
    st.lists(st.floats(-0.3, 0.3), min_size=3, max_size=3),
    st.lists(st.floats(-0.01, 0.01), min_size=2, max_size=2),
    st.floats(0.0, 6.28),
)
@example([0.125, 0.25, -0.25], [0.0, 0.0], 0.0)
@settings(max_examples=50, deadline=None)
def test_distortion_has_an_inverse_inside_the_fold(radial, tangential, angle):
    coefficients = (radial[0], radial[1], *tangential, radial[2])
    radius = np.linspace(0.0, 0.9 * min(fold_radius(coefficients), 1.1), 20)
    x, y = radius * np.cos(angle), radius * np.sin(angle)
    back_x, back_y = undistorted(*distorted(x, y, coefficients), coefficients)
    np.testing.assert_allclose(np.hypot(back_x - x, back_y - y), 0.0, atol=1e-8)


def test_a_pixel_that_no_direction_reaches_is_marked():
    # r (1 - r^2 / 3) is at most 2/3, at r = 1
    coefficients = (-1.0 / 3.0, 0.0, 0.0, 0.0, 0.0)
    assert fold_radius(coefficients) == pytest.approx(1.0)
    x, _ = undistorted(np.array([0.5, 0.66, 0.68, -5.0]), np.zeros(4), coefficients)
    assert np.isfinite(x).tolist() == [True, True, False, False]
    assert (np.abs(x[:2]) < 1.0).all()


@pytest.mark.parametrize("radial", [(-0.2, 0.0, 0.0), (0.1, -0.3, 0.02), (0.3, -0.1, -0.05), (0.09, -0.27, 0.01)])
def test_the_fold_is_where_the_distortion_has_its_first_maximum(radial):
    radius = np.linspace(0.0, 3.0, 300_001)
    coefficients = (radial[0], radial[1], 0.0, 0.0, radial[2])
    bent, _ = distorted(radius, np.zeros_like(radius), coefficients)
    assert fold_radius(coefficients) == pytest.approx(radius[np.argmax(np.diff(bent) < 0)], abs=2e-5)


def test_nothing_folds_back_into_the_image():
    wide = np.array([1.9, 0.0, 1.0])  # the polynomial sends it to column 1 580
    assert 0 < KINECT_COLOR.fx * distorted(wide[0], wide[1], KINECT_COLOR.distortion)[0] < 960
    assert np.isnan(KINECT_COLOR.project(wide)).all()
    assert np.isfinite(KINECT_COLOR.project(np.array([1.3, 0.0, 1.0]))).all()


def test_nothing_behind_the_camera_is_seen():
    pixels = KINECT_DEPTH.project(np.array([[0.1, 0.1, 1.0], [0.1, 0.1, -1.0], [0.1, 0.1, 0.0]]))
    assert np.isnan(pixels).all(-1).tolist() == [False, True, True]


def test_batches_equal_single_points():
    points = np.random.default_rng(2).uniform([-0.5, -0.5, 1.0], [0.5, 0.5, 2.0], (2, 5, 3))
    each = np.array([[SKEWED.project(point) for point in row] for row in points])
    np.testing.assert_array_equal(SKEWED.project(points), each)
    np.testing.assert_allclose(SKEWED.unproject(each, points[..., 2]), points, atol=1e-12)


def test_rays_are_those_of_the_pixels():
    rays = SMALL.rays
    assert rays.shape == (4, 6, 2)
    np.testing.assert_allclose(rays[3, 1], [(1 - 2.4) / 5.0, (3 - 1.7) / 5.5])


def test_scaled_images_see_the_same_directions():
    half = KINECT_COLOR.scaled(960, 540)
    # the centre of a pixel of the half image is the corner between four of the whole
    whole = KINECT_COLOR.unproject(np.array([[800.5, 300.5]]), np.ones(1))
    np.testing.assert_allclose(half.unproject(np.array([[400.0, 150.0]]), np.ones(1)), whole, atol=1e-12)
    assert half.scaled(1920, 1080).cx == pytest.approx(KINECT_COLOR.cx)


def test_points_are_those_of_a_slow_loop():
    T_world_camera = rotated(0.4, (0.3, -0.2, 1.1))
    valid = np.random.default_rng(3).random((4, 6)) > 0.4
    seen = frame(valid=valid, T_world_camera=T_world_camera)
    expected = []
    for row, column in np.argwhere(valid):
        z = float(seen.depth[row, column])
        local = [(column - SMALL.cx) / SMALL.fx * z, (row - SMALL.cy) / SMALL.fy * z, z, 1.0]
        expected.append((T_world_camera @ local)[:3])
    np.testing.assert_allclose(seen.points(), expected, atol=1e-12)


def test_a_frame_without_depth_has_no_points():
    nothing = frame(depth=np.full((4, 6), np.nan, dtype=np.float32), valid=np.zeros((4, 6), dtype=bool))
    assert nothing.points().shape == (0, 3)


@pytest.mark.parametrize(
    ("changes", "error", "message"),
    [
        ({"depth": np.ones((6, 4), np.float32)}, ShapeError, r"depth with shape \(4, 6\), got \(6, 4\)"),
        ({"depth": np.ones((4, 6))}, InputError, "depth as an array of float32, got float64"),
        ({"depth": [[1.0]]}, InputError, "depth as an array of float32, got list"),
        ({"valid": np.ones((4, 6), np.uint8)}, InputError, "valid as an array of bool, got uint8"),
        ({"valid": np.ones((4, 5), bool)}, ShapeError, "valid with shape"),
        ({"color": np.zeros((4, 6), np.uint8)}, ShapeError, "color with shape"),
        ({"color": np.zeros((4, 6, 3), np.float32)}, InputError, "color as an array of uint8, got float32"),
        ({"color": np.zeros((4, 6, 4), np.uint8)}, ShapeError, r"got \(4, 6, 4\)"),
        ({"depth": np.full((4, 6), 1500.0, np.float32)}, UnitsError, "millimetres"),
        ({"depth": np.full((4, 6), 500.0, np.float32)}, UnitsError, "got 500"),
        ({"depth": np.zeros((4, 6), np.float32)}, InputError, "above zero where valid"),
        ({"depth": np.full((4, 6), np.inf, np.float32)}, InputError, "finite"),
        ({"intrinsics": replace(SMALL, width=7)}, ShapeError, "depth with shape"),
        ({"color_intrinsics": SMALL}, InputError, "color_intrinsics and T_color_depth together"),
        ({"T_color_depth": np.eye(4)}, InputError, "color_intrinsics and T_color_depth together"),
        ({"color_intrinsics": replace(SMALL, height=5), "T_color_depth": np.eye(4)}, ShapeError, "color with shape"),
        ({"color_intrinsics": SMALL, "T_color_depth": 2 * np.eye(4)}, InputError, "T_color_depth finite"),
        ({"T_world_camera": np.eye(3)}, ShapeError, r"T_world_camera with shape \(4, 4\)"),
        ({"T_world_camera": np.diag([1.0, 1.0, -1.0, 1.0])}, InputError, "mirrors"),
        ({"T_world_camera": np.diag([1.01, 1.01, 1.01, 1.0])}, InputError, "scales"),
        ({"T_world_camera": np.full((4, 4), np.nan)}, InputError, "T_world_camera finite"),
        ({"T_world_camera": np.eye(4)[[0, 1, 3, 2]]}, InputError, "last row"),
    ],
)
def test_bad_frames_are_refused(changes, error, message):
    with pytest.raises(error, match=message):
        frame(**changes)


@pytest.mark.parametrize(
    "changes",
    [
        {"width": 0},
        {"height": 3.5},
        {"fx": 0.0},
        {"fx": np.nan},
        {"fy": np.inf},
        {"fy": -5.0},
        {"cx": 100.0},
        {"cy": np.nan},
        {"distortion": (0.1, 0.2)},
        {"distortion": (0.1, 0.2, np.nan, 0.0, 0.0)},
    ],
)
def test_bad_intrinsics_are_refused(changes):
    with pytest.raises(InputError, match="Expected"):
        replace(SMALL, **changes)


def test_valid_pixels_need_a_ray():
    # distorted radii reach 0.48 at the upper left corner, the lens images up to 0.385
    folding = replace(SMALL, distortion=(-1.0, 0.0, 0.0, 0.0, 0.0))
    with pytest.raises(InputError, match="folds back inside"):
        frame(intrinsics=folding)
    reached = np.isfinite(folding.rays[..., 0])
    assert 0 < reached.sum() < 24
    assert np.isfinite(frame(intrinsics=folding, valid=reached).points()).all()


def test_what_was_given_stays_as_it_was():
    depth = np.full((4, 6), 1.0, np.float32)
    seen = frame(depth=depth)
    seen.points()
    assert (depth == 1.0).all() and seen.depth is depth

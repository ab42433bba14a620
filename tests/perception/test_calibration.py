from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from camera_rig import (
    BOARD,
    CAMERAS,
    COLOR,
    POSITION_STD,
    ROTATION_STD,
    WORKSPACE,
    board_poses,
    disturbed,
    seen_corners,
)
from scipy.optimize import approx_fprime
from scipy.spatial.transform import Rotation

from eaip_prob.errors import InputError, ShapeError
from eaip_prob.perception._bundle import Bundle, cross_matrix, left_jacobian
from eaip_prob.perception.board import BoardCorners
from eaip_prob.perception.board_view import BoardView
from eaip_prob.perception.calibration import calibrate
from eaip_prob.perception.extrinsics import Extrinsics, workspace_error
from eaip_prob.perception.lens_std import LensStd

INTRINSICS = {name: COLOR for name in CAMERAS}
COVARIANCE = np.diag([ROTATION_STD**2] * 3 + [POSITION_STD**2] * 3)


def error_of(found):
    return workspace_error([found[name].T_world_camera for name in CAMERAS], list(CAMERAS.values()), WORKSPACE)


def gaps_of(found):
    """(6,) of each camera: rotation vector and position along the world's axes, estimated less true."""
    gaps = {}
    for name, pose in found.items():
        turn = Rotation.from_matrix(pose.T_world_camera[:3, :3] @ CAMERAS[name][:3, :3].T).as_rotvec()
        gaps[name] = np.concatenate([turn, pose.T_world_camera[:3, 3] - CAMERAS[name][:3, 3]])
    return gaps


def test_exact_boards_give_the_cameras_exactly():
    rng = np.random.default_rng(1)
    poses = board_poses(12, rng)
    found = calibrate(seen_corners(poses, rng, pixel_std=0.0), BOARD, INTRINSICS, poses)
    error = error_of(found)
    assert error.millimetres < 1e-4 and error.degrees < 1e-5
    assert list(found) == list(CAMERAS)
    assert all(one.residual < 1e-4 for one in found.values())


def test_noise_of_corners_moves_cameras_by_less_than_a_millimetre():
    rng = np.random.default_rng(2)
    poses = board_poses(12, rng)
    views = seen_corners(poses, rng, pixel_std=0.1)
    found = calibrate(views, BOARD, INTRINSICS, poses)
    error = error_of(found)
    assert error.millimetres < 0.5 and error.degrees < 0.02
    for name, one in found.items():
        assert one.residual == pytest.approx(0.1 * np.sqrt(2.0), rel=0.15)
        assert one.num_boards == sum(view.camera == name for view in views)


def test_uncertain_boards_average_out():
    rng = np.random.default_rng(3)
    poses = board_poses(25, rng)
    views, told = thinned(seen_corners(poses, rng), 3), disturbed(poses, rng)
    error = error_of(calibrate(views, BOARD, INTRINSICS, told, COVARIANCE))
    assert error.millimetres < 2.0 and error.degrees < 0.12
    # believing the poses is worse
    assert error_of(calibrate(views, BOARD, INTRINSICS, told)).millimetres > 1.3 * error.millimetres


@pytest.mark.slow
@pytest.mark.parametrize("lens_std", [None, LensStd()])
@pytest.mark.parametrize("uncertain", [False, True])
def test_covariances_are_those_of_the_errors(uncertain, lens_std):
    rng = np.random.default_rng(4)
    distances = []
    for _ in range(25):
        poses = board_poses(9, rng)
        told = disturbed(poses, rng) if uncertain else poses
        views = seen_corners(poses, rng, pixel_std=0.1)
        views = thinned(views, 3)
        lenses = INTRINSICS if lens_std is None else {name: lens_std.drawn(COLOR, rng) for name in CAMERAS}
        known = COVARIANCE if uncertain else None
        found = calibrate(views, BOARD, lenses, told, known, pixel_std=0.1, min_boards=1, lens_std=lens_std)
        gaps = gaps_of(found)
        for name, one in found.items():
            distances.append(gaps[name] @ np.linalg.solve(one.covariance, gaps[name]))
    # squared Mahalanobis distances with 6 degrees of freedom: mean 6, here of 25 draws that cameras may share
    mean = np.mean(distances) / 6.0
    assert abs(mean - 1.0) < 4.0 * np.sqrt(2.0 / 6.0 / 25.0)
    assert mean > 0.6


def thinned(views, step):
    return [replace_corners(view, view.corners.ids[::step], view.corners.pixels[::step]) for view in views]


def replace_corners(view, ids, pixels):
    return replace(view, corners=BoardCorners(ids, pixels))


LENS_STD = LensStd()


@pytest.mark.parametrize("uncertain", [False, True])
def test_a_wrong_lens_is_refined(uncertain):
    rng = np.random.default_rng(14)
    poses = board_poses(12, rng)
    views = seen_corners(poses, rng, pixel_std=0.02)
    told = disturbed(poses, rng) if uncertain else poses
    lenses = {name: LENS_STD.drawn(COLOR, rng) for name in CAMERAS}
    known = (told, COVARIANCE if uncertain else None, 0.02)
    found = calibrate(views, BOARD, lenses, *known, lens_std=LENS_STD)
    exact = calibrate(views, BOARD, lenses, *known)
    assert error_of(found).millimetres < 5.0 < 0.5 * error_of(exact).millimetres
    for name in CAMERAS:
        assert abs(found[name].intrinsics.fx - COLOR.fx) < 0.3 * abs(lenses[name].fx - COLOR.fx) + 0.5
        assert exact[name].intrinsics == lenses[name]


def test_what_is_exact_of_a_lens_stays():
    rng = np.random.default_rng(15)
    poses = board_poses(9, rng)
    given = replace(COLOR, fx=1063.0, distortion=(0.054, -0.068, 0.001, -0.001, 0.002))
    views = thinned(seen_corners(poses, rng), 4)
    found = calibrate(
        views, BOARD, dict.fromkeys(CAMERAS, given), poses, lens_std=LensStd(5.0, 0.0, (0.01, 0.0, 0.0, 0.0, 0.0))
    )
    for one in found.values():
        assert (one.intrinsics.cx, one.intrinsics.distortion[1:]) == (given.cx, given.distortion[1:])
        assert one.intrinsics.fx != given.fx and one.intrinsics.distortion[0] != given.distortion[0]


def test_views_that_scatter_count_less():
    rng = np.random.default_rng(16)
    poses = board_poses(12, rng)
    views = seen_corners(poses, rng, pixel_std=0.02)
    bad = [
        replace_corners(view, view.corners.ids, view.corners.pixels + rng.normal(0.0, 0.5, view.corners.pixels.shape))
        if view.board in (1, 5, 9)
        else view
        for view in views
    ]
    error = error_of(calibrate(bad, BOARD, INTRINSICS, poses, pixel_std=0.02))
    without = error_of(calibrate([one for one in views if one.board not in (1, 5, 9)], BOARD, INTRINSICS, poses))
    assert error.millimetres < 1.5 * without.millimetres + 0.02


@pytest.mark.parametrize(
    "changes", [{"focal": -1.0}, {"centre": np.inf}, {"distortion": (0.1, 0.1)}, {"distortion": (0, 0, 0, 0, np.nan)}]
)
def test_bad_deviations_of_a_lens_are_refused(changes):
    with pytest.raises(InputError, match="Expected standard deviations not below zero"):
        LensStd(**changes)


def test_the_predicted_error_is_that_of_drawn_poses():
    rng = np.random.default_rng(17)
    root = rng.normal(0.0, 1e-4, (6, 6)) * np.array([1.0, 1.0, 1.0, 3.0, 3.0, 3.0])[:, None]
    one = Extrinsics(CAMERAS["left"], root @ root.T, 0.1, 5, COLOR)
    squares = []
    for draw in rng.normal(size=(1000, 6)) @ root.T:
        moved = one.T_world_camera.copy()
        moved[:3, :3] = Rotation.from_rotvec(draw[:3]).as_matrix() @ moved[:3, :3]
        moved[:3, 3] += draw[3:]
        squares.append(workspace_error([moved], [one.T_world_camera], WORKSPACE).position ** 2)
    spread = np.std(squares) / np.sqrt(len(squares))
    assert abs(np.mean(squares) - one.workspace_std(WORKSPACE) ** 2) < 4.0 * spread
    with pytest.raises(ShapeError, match="points of the workspace"):
        one.workspace_std(np.zeros((0, 3)))


def test_one_wrong_board_does_not_move_the_cameras():
    rng = np.random.default_rng(5)
    poses = board_poses(12, rng)
    views = seen_corners(poses, rng)
    told = poses.copy()
    told[1, :3, 3] += (0.1, -0.05, 0.0)
    assert error_of(calibrate(views, BOARD, INTRINSICS, told)).millimetres < 6.0


@pytest.mark.parametrize("lens_std", [None, LensStd().vector])
@pytest.mark.parametrize("whitening", [None, np.diag([1.0, 2.0, 3.0, 0.5, 0.7, 0.9]) + 0.1])
def test_derivatives_are_those_of_finite_differences(whitening, lens_std):
    rng = np.random.default_rng(6)
    camera = replace(COLOR, distortion=(0.05, -0.07, 0.004, -0.003, 0.01))
    poses = np.column_stack([rng.normal(0.0, 0.4, (2, 3)), rng.uniform(-0.3, 0.3, (2, 3))])
    cameras = np.column_stack([rng.normal(0.0, 0.3, (2, 3)), [[0.1, 0.2, 2.0], [-0.2, 0.1, 1.7]]])
    bundle = Bundle(
        [camera, COLOR], np.array([0, 0, 1, 1]), np.array([0, 1, 1, 0]), rng.uniform(-0.3, 0.3, (4, 3)),
        np.zeros((4, 2)), poses, whitening, np.array([0.5, 0.6, 0.7, 0.8]), lens_std,
    )  # fmt: skip
    at = bundle.start(cameras) + rng.normal(0.0, 0.02, bundle.start(cameras).shape)
    numeric = np.array(
        [approx_fprime(at, lambda x, i=i: bundle.residuals(x)[i], 1e-7) for i in range(len(bundle.residuals(at)))]
    )
    exact = bundle.jacobian(at).toarray()
    np.testing.assert_allclose(exact, numeric, atol=2e-3, rtol=2e-5)


@pytest.mark.parametrize("size", [0.0, 1e-6, 0.3, 3.0])
def test_left_jacobian_turns_changes_of_a_rotation_vector_into_rotations(size):
    vector, change = size * np.array([0.6, -0.48, 0.64]), 1e-6 * np.array([1.0, 2.0, -3.0])
    turned = Rotation.from_rotvec(vector + change) * Rotation.from_rotvec(vector).inv()
    np.testing.assert_allclose(left_jacobian(vector) @ change, turned.as_rotvec(), atol=1e-11)
    np.testing.assert_allclose(cross_matrix(vector) @ change, np.cross(vector, change))


def a_view(camera="left", board=0, count=12):
    rng = np.random.default_rng(7)
    poses = board_poses(1, rng)
    view = seen_corners(poses, rng)[0]
    return BoardView(camera, board, BoardCorners(view.corners.ids[:count], view.corners.pixels[:count]))


@pytest.mark.parametrize(
    ("views", "message"),
    [
        ([], "'left', but the board was never seen"),
        ([a_view()], "3 or more poses in camera 'left', but it gave a pose at 1, of 1 views"),
        ([a_view(board=2)] * 4, "gave a pose at 1, of 4 views"),
        ([a_view(count=3)], "gave a pose at 0, of 1 views"),
        ([a_view(count=8)], "gave a pose at 0, of 1 views"),  # all in the first row of corners
        ([a_view("front")], "got board 0 in 'front'"),
        ([a_view(board=9)], "boards 0 to 3, got board 9"),
        ([replace_corners(a_view(), np.array([0, 40]), np.zeros((2, 2)))], "corners 0 to 39"),
    ],
)
def test_views_that_are_not_enough_are_refused(views, message):
    with pytest.raises(InputError, match=message):
        calibrate(views, BOARD, {"left": COLOR}, board_poses(4, np.random.default_rng(8)))


@pytest.mark.parametrize(
    ("changes", "error", "message"),
    [
        ({"board_poses": np.eye(4)}, ShapeError, r"board_poses with shape \(B, 4, 4\)"),
        ({"board_poses": np.stack([np.eye(4), np.diag([1, 1, -1, 1.0])])}, InputError, r"board_poses\[1\]"),
        ({"pose_covariance": np.eye(3)}, ShapeError, r"pose_covariance with shape \(6, 6\)"),
        ({"pose_covariance": np.zeros((6, 6))}, InputError, "None if poses are exact"),
        ({"pose_covariance": np.eye(6) - 0.5}, InputError, "negative variance"),
        ({"pose_covariance": np.eye(6) + np.eye(6, k=1)}, InputError, "symmetric"),
        ({"pixel_std": 0.0}, InputError, "pixel_std above zero"),
        ({"intrinsics": {}}, InputError, "at least one camera"),
    ],
)
def test_bad_arguments_are_refused(changes, error, message):
    given = {"intrinsics": {"left": COLOR}, "board_poses": np.eye(4)[None]} | changes
    with pytest.raises(error, match=message):
        calibrate([], BOARD, **given)


def test_errors_in_the_workspace_are_those_of_a_loop():
    moved = CAMERAS["left"].copy()
    moved[:3, :3] = Rotation.from_rotvec([0.0, 0.02, 0.0]).as_matrix() @ moved[:3, :3]
    moved[:3, 3] += (0.001, 0.0, -0.002)
    squares = []
    for point in WORKSPACE:
        local = np.linalg.solve(CAMERAS["left"], np.append(point, 1.0))
        squares.append(np.sum(((moved @ local)[:3] - point) ** 2))
    both = workspace_error([CAMERAS["right"], moved], [CAMERAS["right"], CAMERAS["left"]], WORKSPACE)
    assert both.position == pytest.approx(np.sqrt(np.mean(squares)))
    assert both.rotation == pytest.approx(0.02)
    assert (both.millimetres, both.degrees) == (1e3 * both.position, np.degrees(both.rotation))


def test_errors_of_nothing_are_refused():
    with pytest.raises(ShapeError, match="as many true poses"):
        workspace_error([np.eye(4)], [], WORKSPACE)
    with pytest.raises(ShapeError, match="points of the workspace"):
        workspace_error([np.eye(4)], [np.eye(4)], np.zeros((0, 3)))

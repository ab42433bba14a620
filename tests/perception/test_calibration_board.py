from __future__ import annotations

from dataclasses import replace

import cv2
import numpy as np
import pytest
from camera_rig import BOARD, CAMERAS, COLOR, WORKSPACE, board_poses, disturbed
from scipy.spatial.transform import Rotation

from eaip_prob.data.frames import inverse
from eaip_prob.errors import InputError, ShapeError
from eaip_prob.perception.board import BoardCorners, CharucoBoard, board_pose, detect_board
from eaip_prob.perception.board_view import BoardView
from eaip_prob.perception.calibration import calibrate
from eaip_prob.perception.extrinsics import workspace_error
from eaip_prob.perception.lens_std import LensStd
from eaip_prob.simulation.board_image import board_image

# a small image of a wide lens, in which 5 x 4 squares are as large as nine in a whole one
CAMERA = COLOR.scaled(480, 270)
SMALL = CharucoBoard(5, 4, 0.1, 0.075, "DICT_4X4_50")


def held(turn, centre, board=SMALL):
    pose = np.eye(4)
    pose[:3, :3] = Rotation.from_rotvec(turn).as_matrix()
    pose[:3, 3] = np.array(centre) - pose[:3, :3] @ np.array([*board.size, 0.0]) / 2.0
    return pose


@pytest.mark.parametrize("turn", [(0.0, 0.0, 0.0), (0.4, -0.2, 0.5), (-0.3, 0.6, -2.0)])
def test_corners_are_found_where_opencv_projects_them(turn):
    pose = held(turn, (0.1, -0.02, 0.9))
    image = board_image(SMALL, CAMERA, pose, noise=2.0, generator=np.random.default_rng(1))
    found = detect_board(image, SMALL)
    expected, _ = cv2.projectPoints(
        SMALL.corners[found.ids],
        cv2.Rodrigues(pose[:3, :3])[0],
        pose[:3, 3],
        CAMERA.matrix,
        np.array(CAMERA.distortion),
    )
    gaps = found.pixels - expected[:, 0]
    assert len(found.ids) == 12
    assert np.sqrt(np.mean(gaps**2)) < 0.1 and np.abs(gaps.mean(0)).max() < 0.05


def test_one_image_gives_the_pose():
    pose = held((0.5, -0.3, 0.4), (0.1, 0.05, 0.7))
    found = board_pose(detect_board(board_image(SMALL, CAMERA, pose), SMALL), SMALL, CAMERA)
    change = inverse(pose) @ found
    assert np.linalg.norm(change[:3, 3]) < 0.002
    assert Rotation.from_matrix(change[:3, :3]).magnitude() < np.radians(0.3)


def test_the_places_are_those_of_opencv():
    theirs = cv2.aruco.CharucoBoard((9, 6), 0.07, 0.0525, cv2.aruco.getPredefinedDictionary(cv2.aruco.DICT_5X5_100))
    np.testing.assert_allclose(BOARD.corners, theirs.getChessboardCorners(), atol=1e-7)


def test_from_behind_nothing_is_found():
    behind = held((0.0, np.pi, 0.0), (0.0, 0.0, 0.8))
    image = board_image(SMALL, CAMERA, behind)
    assert len(np.unique(image)) > 1 and image.max() < 200  # its back is there, without print
    assert detect_board(image, SMALL) is None


def test_where_no_board_is_nothing_is_found():
    away = held((0.0, 0.0, 0.0), (0.0, 0.0, -0.8))
    image = board_image(SMALL, CAMERA, away)
    assert (image == image[0, 0]).all() and detect_board(image, SMALL) is None


def test_another_board_is_not_taken_for_this_one():
    other = replace(SMALL, dictionary="DICT_6X6_250")
    assert detect_board(board_image(SMALL, CAMERA, held((0, 0, 0), (0, 0, 0.8))), other) is None


def test_part_of_a_board_gives_the_corners_that_are_seen():
    image = board_image(SMALL, CAMERA, held((0.0, 0.0, 0.0), (0.55, 0.0, 0.7)))
    found = detect_board(image, SMALL)
    assert 6 <= len(found.ids) < 12
    assert (found.ids % 4 != 3).all()  # the last column is outside


def test_grey_images_are_the_same():
    image = board_image(SMALL, CAMERA, held((0.2, 0.1, 0.0), (0.0, 0.0, 0.8)))
    np.testing.assert_allclose(detect_board(image[..., 0].copy(), SMALL).pixels, detect_board(image, SMALL).pixels)


def test_noise_needs_a_generator():
    with pytest.raises(InputError, match="generator for noise"):
        board_image(SMALL, CAMERA, np.eye(4), noise=1.0)


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"columns": 2}, "at least 3 x 3"),
        ({"marker": 0.2}, "smaller markers"),
        ({"dictionary": "DICT_9X9"}, "dictionary"),
        ({"dictionary": "Board"}, "dictionary"),
        ({"columns": 12, "rows": 10}, "at least 60 markers in DICT_4X4_50, got 50"),
    ],
)
def test_bad_boards_are_refused(changes, message):
    with pytest.raises(InputError, match=message):
        replace(SMALL, **changes)


def test_bad_images_are_refused():
    with pytest.raises(InputError, match="uint8, got float64"):
        detect_board(np.zeros((9, 9)), SMALL)
    with pytest.raises(ShapeError, match=r"got \(9, 9, 4\)"):
        detect_board(np.zeros((9, 9, 4), np.uint8), SMALL)


def test_bad_corners_are_refused():
    with pytest.raises(ShapeError, match="pixels"):
        BoardCorners(np.arange(3), np.zeros((2, 2)))
    with pytest.raises(InputError, match="each corner once"):
        BoardCorners(np.array([1, 1]), np.zeros((2, 2)))
    with pytest.raises(InputError, match="finite"):
        BoardCorners(np.array([0, 1]), np.full((2, 2), np.nan))


@pytest.mark.slow
def test_three_cameras_are_found_from_their_images():
    rng = np.random.default_rng(2)
    poses, views = board_poses(30, rng), []
    for name, T_world_camera in CAMERAS.items():
        for index, pose in enumerate(poses):
            corners = detect_board(board_image(BOARD, COLOR, inverse(T_world_camera) @ pose, 2.0, rng), BOARD)
            if corners is not None:
                views.append(BoardView(name, index, corners))
    covariance = np.diag([np.radians(0.3) ** 2] * 3 + [0.002**2] * 3)
    told = disturbed(poses, rng)
    # the lens as one estimates it: off by some tenths of a pixel
    estimated = replace(COLOR, fx=1061.1, fy=1059.0, cx=956.7, cy=518.8, distortion=(0.0535, -0.0675, 0.0, 0.0, 0.0))
    near = LensStd(focal=0.5, centre=0.5, distortion=(0.0005, 0.0005, 0.0, 0.0, 0.0))
    exact, uncertain, of_sheet = (
        workspace_error([one.T_world_camera for one in found.values()], list(CAMERAS.values()), WORKSPACE)
        for found in (
            calibrate(views, BOARD, dict.fromkeys(CAMERAS, estimated), poses, pixel_std=0.03, lens_std=near),
            calibrate(views, BOARD, dict.fromkeys(CAMERAS, estimated), told, covariance, 0.03, lens_std=near),
            calibrate(views, BOARD, sheet(rng), told, covariance, 0.03, lens_std=LensStd()),
        )
    )
    assert exact.millimetres < 1.0 and exact.degrees < 0.02
    assert uncertain.millimetres < 4.0 and uncertain.degrees < 0.1
    assert of_sheet.millimetres < 4.0 and of_sheet.degrees < 0.1


def sheet(generator):
    """Lenses as a data sheet gives them."""
    return {name: LensStd().drawn(COLOR, generator) for name in CAMERAS}

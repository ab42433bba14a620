from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from eaip_prob.data.frames import Intrinsics, inverse
from eaip_prob.errors import InputError
from eaip_prob.perception import BoardCorners, BoardView, CharucoBoard
from eaip_prob.simulation import Kinect, KinectModel, looking_at
from eaip_prob.tasks.kinects.board_session import BoardSession, board_session, held_boards
from eaip_prob.tasks.kinects.calibrating import calibrated, disturbed_poses
from eaip_prob.tasks.kinects.calibration_pictures import draw_calibration

COLOR = Intrinsics(1920, 1080, 1060.7, 1058.6, 956.4, 519.0, (0.054, -0.068, 0.0, 0.0, 0.0))
BOARD = CharucoBoard()
MIDDLE = np.array([0.95, 0.0, 0.0])
POINTS = MIDDLE + np.stack(np.meshgrid(*[[-0.4, 0.0, 0.4]] * 3), -1).reshape(-1, 3)


def units(color=COLOR):
    model = KinectModel(color, color, (-0.0519, -0.0005, 0.0001), (0.0, 1.0, 0.0))
    places = {"left": (0.55, 1.75, 1.15), "right": (0.55, -1.75, 1.15)}
    return [Kinect(name, model, looking_at(place, MIDDLE)) for name, place in places.items()]


def drawn_session(cameras, num_boards, seed=3):
    """As of `board_session`, with corners where the lens puts them instead of images."""
    rng = np.random.default_rng(seed)
    poses, views = held_boards(cameras, num_boards, BOARD, rng), []
    for index, pose in enumerate(poses):
        for camera in cameras:
            T = inverse(camera.color_view.T_world_camera) @ pose
            pixels = COLOR.project(BOARD.corners @ T[:3, :3].T + T[:3, 3])
            if T[:3, 2] @ T[:3, 3] > 0.55 * np.linalg.norm(T[:3, 3]) and ((pixels > 5) & (pixels < (1915, 1075))).all():
                noise = rng.normal(0.0, 0.03, pixels.shape)
                views.append(BoardView(camera.name, index, BoardCorners(np.arange(len(pixels)), pixels + noise)))
    return BoardSession(cameras, BOARD, poses, views, np.full((1080, 1920, 3), 90, np.uint8), seed)


def test_boards_are_within_reach_and_turned_towards_a_camera():
    cameras = units()
    poses = held_boards(cameras, 40, BOARD, np.random.default_rng(1))
    for index, pose in enumerate(poses):
        centre = pose[:3, :3] @ np.array([*BOARD.size, 0.0]) / 2.0 + pose[:3, 3]
        shoulder = np.array([0.064, np.copysign(0.259, centre[1]), 0.130])
        assert np.linalg.norm(centre - shoulder) <= 1.0
        view = centre - cameras[index % 2].color_view.T_world_camera[:3, 3]
        assert pose[:3, 2] @ view > 0.5 * np.linalg.norm(view)  # print towards the viewer: z away
    with pytest.raises(InputError, match="one camera and one board, got 0 and 3"):
        held_boards([], 3, BOARD, np.random.default_rng(1))


@pytest.mark.parametrize("uncertain", [False, True])
def test_a_calibration_is_compared_with_the_colour_cameras(uncertain):
    session = drawn_session(units(), 16)
    result = calibrated(session, POINTS, uncertain)
    metrics = result.metrics()
    assert 0.05 < metrics["mm"] < 6.0 and metrics["deg"] < 0.25
    assert metrics["mm"] < 4.0 * metrics["predicted_mm"]
    assert metrics["mm"] == pytest.approx(max(one.millimetres for one in result.errors.values()))
    assert metrics["position_mm"] < 4.0 * metrics["predicted_position_mm"]
    assert metrics["residual_px"] == pytest.approx(0.03 * np.sqrt(2.0), rel=0.2)
    again = calibrated(session, POINTS, uncertain).metrics()
    assert again == metrics


def test_a_lens_that_is_believed_costs_centimetres():
    session = drawn_session(units(), 12)
    assert calibrated(session, POINTS, False, refine=False).worst.millimetres > 5.0


def test_poses_are_wrong_by_what_is_said():
    poses = held_boards(units(), 300, BOARD, np.random.default_rng(1))
    told = disturbed_poses(poses, np.random.default_rng(2))
    turns = told[:, :3, :3] @ np.swapaxes(poses[:, :3, :3], 1, 2)
    angle = np.degrees(np.arccos(np.clip((np.trace(turns, axis1=1, axis2=2) - 1.0) / 2.0, -1.0, 1.0)))
    assert np.sqrt(np.mean(angle**2) / 3.0) == pytest.approx(0.3, rel=0.1)
    assert (told - poses)[:, :3, 3].std() == pytest.approx(0.002, rel=0.1)


@pytest.mark.slow
def test_boards_are_rendered_found_and_drawn(tmp_path):
    told = []

    def progress(numbers):
        for number in numbers:
            told.append(number)
            yield number

    cameras = units()[:1]
    session = board_session(cameras, 4, seed=1, progress=progress)
    assert told == [0, 1, 2, 3] and session.num_boards == 4
    shorter = board_session(cameras, 1, seed=1)
    np.testing.assert_array_equal(shorter.image, session.image)
    assert session.image.shape == (1080, 1920, 3)
    for view in session.views:
        T = inverse(cameras[0].color_view.T_world_camera) @ session.T_world_board[view.board]
        expected = COLOR.project(BOARD.corners[view.corners.ids] @ T[:3, :3].T + T[:3, 3])
        assert np.sqrt(np.mean((view.corners.pixels - expected) ** 2)) < 0.15
    results = {name: calibrated(session, POINTS, uncertain=name == "uncertain") for name in ("exact", "uncertain")}
    path = draw_calibration(tmp_path, session, results)
    assert path.is_file() and path.parent.parent == tmp_path


def test_cameras_that_see_no_board_are_refused():
    away = replace(units()[0], T_world_camera=looking_at((0.5, 1.7, 1.0), (0.5, 4.0, 1.0)))
    with pytest.raises(InputError, match="got none of 1 found"):
        board_session([away], 1, seed=1)

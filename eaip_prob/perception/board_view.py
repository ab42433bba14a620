"""Views of a calibration board: which of them are good enough, and what one alone says about its camera."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from eaip_prob.data.frames import Intrinsics, inverse
from eaip_prob.errors import InputError
from eaip_prob.perception.board import BoardCorners, CharucoBoard, board_pose

# On rendered boards of 0.07 m squares at 2 m, corners are off by 0.04 px (root mean square) up to 40 degrees, 0.1 px at
# 50 to 60, 0.2 to 0.7 px from 66 on.
_LEAST_COSINE = np.cos(np.radians(60.0))


@dataclass(frozen=True, eq=False)
class BoardView:
    """Corners of the board in one image.

    Args:
        camera: its name.
        board: which pose of the board was seen, from 0.
        corners: what `detect_board` found.

    Example:
        >>> corners = BoardCorners(np.array([0, 1]), np.array([[5.0, 6.0], [7.0, 6.0]]))
        >>> BoardView("left", 0, corners).camera
        'left'
    """

    camera: str
    board: int
    corners: BoardCorners


@dataclass(frozen=True, eq=False)
class PosedView:
    """A view with the pose of the board that it alone gives.

    Args:
        view: corners in one image.
        T_camera_board: (4, 4), maps board coordinates into those of the camera.

    Example:
        >>> corners = BoardCorners(np.array([0, 1]), np.array([[5.0, 6.0], [7.0, 6.0]]))
        >>> PosedView(BoardView("left", 0, corners), np.eye(4)).view.board
        0
    """

    view: BoardView
    T_camera_board: Float[np.ndarray, "4 4"]


def posed_views(
    views: Sequence[BoardView],
    board: CharucoBoard,
    intrinsics: Mapping[str, Intrinsics],
    num_boards: int,
    min_boards: int,
) -> dict[str, list[PosedView]]:
    """Usable views by camera: those that give a pose, seen at most 60 degrees from the board's normal.

    Args:
        views: of all cameras.
        board: what was seen.
        intrinsics: of each camera, by its name.
        num_boards: how many poses of the board there are.
        min_boards: fewest that each camera must have seen.

    Raises:
        InputError: a view of an unknown camera, board or corner, or a camera with too few usable views.
    """
    result: dict[str, list[PosedView]] = {name: [] for name in intrinsics}
    if not result:
        raise InputError("Expected the intrinsics of at least one camera, got none.")
    for view in views:
        _check_view(view, board, result, num_boards)
        pose = board_pose(view.corners, board, intrinsics[view.camera])
        if pose is not None and _cosine(pose, board) >= _LEAST_COSINE:
            result[view.camera].append(PosedView(view, pose))
    for name, some in result.items():
        given = sum(view.camera == name for view in views)
        _check_count(name, len({one.view.board for one in some}), given, min_boards)
    return result


def first_guess(
    posed: Sequence[PosedView], board: CharucoBoard, camera: Intrinsics, board_poses: Float[np.ndarray, "boards 4 4"]
) -> Float[np.ndarray, "4 4"]:
    """T_world_camera from the one view that explains the others best, so that one wrong pose does not matter.

    Args:
        posed: views of one camera.
        board: what was seen.
        camera: its intrinsics.
        board_poses: (B, 4, 4), T_world_board.
    """

    def misfit(guess: np.ndarray) -> float:
        gaps = []
        for view in (one.view for one in posed):
            pose = inverse(guess) @ board_poses[view.board]
            pixels = camera.project(board.corners[view.corners.ids] @ pose[:3, :3].T + pose[:3, 3])
            gaps.append(np.nan_to_num(np.linalg.norm(pixels - view.corners.pixels, axis=1), nan=1e4).mean())
        return float(np.median(gaps))

    return min((board_poses[one.view.board] @ inverse(one.T_camera_board) for one in posed), key=misfit)


def _check_view(view: BoardView, board: CharucoBoard, cameras: Mapping[str, object], num_boards: int) -> None:
    if view.camera not in cameras or not 0 <= view.board < num_boards:
        raise InputError(
            f"Expected views of the cameras {sorted(cameras)} and of boards 0 to {num_boards - 1}, got board "
            f"{view.board} in {view.camera!r}. Give its intrinsics and the pose of this board."
        )
    if len(view.corners.ids) and not 0 <= view.corners.ids.min() <= view.corners.ids.max() < len(board.corners):
        raise InputError(f"Expected corners 0 to {len(board.corners) - 1}, got others. Is it this board?")


def _check_count(name: str, count: int, given: int, min_boards: int) -> None:
    if count >= max(min_boards, 1):
        return
    seen = f"it gave a pose at {count}, of {given} views" if given else "the board was never seen"
    raise InputError(
        f"Expected the board at {min_boards} or more poses in camera {name!r}, but {seen}. Show it from the front (at "
        "most 60 degrees aside), well lit, and near enough for its markers to be read."
    )


def _cosine(pose: np.ndarray, board: CharucoBoard) -> float:
    """Of the angle between the board's normal and the ray to its middle."""
    middle = pose[:3, :3] @ np.array([*board.size, 0.0]) / 2.0 + pose[:3, 3]
    return float(pose[:3, 2] @ middle / np.linalg.norm(middle))

"""Where cameras stand in the robot's frame, from images of a board that the robot (or a person) held at known poses.

A pose of the board is known from the robot's joints, exactly or with a covariance. Each image alone gives the camera's
pose; all images of all cameras together are then refined by bundle adjustment, in which uncertain poses of the boards
are unknowns too: a board that several cameras saw ties them together, and the errors of many boards average out.

The camera is the one that took the images. Of a Kinect's colour camera: T_world_depth = T_world_camera @ T_color_depth.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
import torch
from jaxtyping import Float
from scipy.optimize import least_squares
from scipy.spatial.transform import Rotation

from eaip_prob.data.frames import Intrinsics, check_transform, inverse
from eaip_prob.errors import InputError, ShapeError
from eaip_prob.linalg import psd_solve, safe_cholesky, triangular_solve
from eaip_prob.perception._bundle import Bundle, cross_matrix, left_jacobian
from eaip_prob.perception.board import CharucoBoard
from eaip_prob.perception.board_view import BoardView, first_guess, posed_views
from eaip_prob.perception.extrinsics import Extrinsics, check_covariance

_PIXEL_STD = 0.1  # px; corners of rendered boards scatter by 0.05 px, which leaves as much for the lens
_OUTLIER = 5.0  # standard deviations, beyond which a residual pulls no harder


def calibrate(
    views: Sequence[BoardView],
    board: CharucoBoard,
    intrinsics: Mapping[str, Intrinsics],
    board_poses: Float[np.ndarray, "boards 4 4"],
    pose_covariance: Float[np.ndarray, "6 6"] | None = None,
    pixel_std: float = _PIXEL_STD,
    min_boards: int = 3,
) -> dict[str, Extrinsics]:
    """Poses of all cameras, jointly refined; corners that fit badly are kept from pulling hard.

    The covariance is that of corners with `pixel_std` and of the boards' poses, scaled up where residuals are larger
    than that. It holds no error of the intrinsics.

    Args:
        views: of all cameras. Boards seen at more than 60 degrees from their normal are not used: their corners, which
            scatter by 0.03 to 0.1 px otherwise, are off by up to 1.5 px there.
        board: what was seen.
        intrinsics: of each camera, by its name.
        board_poses: (B, 4, 4), T_world_board as the robot says.
        pose_covariance: (6, 6), of each pose's error: rotation vector (rad) and position (m) along the world's axes;
            None where poses are exact.
        pixel_std: standard deviation of a corner's coordinate, px.
        min_boards: fewest boards a camera must have seen.

    Raises:
        InputError: a camera that saw no or too few boards, a view of an unknown camera, board or corner.
        ShapeError: poses of another shape.

    Example:
        >>> from eaip_prob.perception.board import BoardCorners
        >>> board, camera = CharucoBoard(), Intrinsics(1920, 1080, 1060.0, 1060.0, 960.0, 540.0)
        >>> turns = Rotation.from_rotvec([[0.3, 0, 0], [0, 0.3, 0], [-0.2, 0.2, 0]]).as_matrix()
        >>> poses = np.tile(np.eye(4), (3, 1, 1))
        >>> poses[:, :3, :3], poses[:, 2, 3] = turns, 2.0
        >>> seen = [camera.project(board.corners @ pose[:3, :3].T + pose[:3, 3]) for pose in poses]
        >>> views = [BoardView("left", i, BoardCorners(np.arange(40), pixels)) for i, pixels in enumerate(seen)]
        >>> found = calibrate(views, board, {"left": camera}, poses)["left"]
        >>> bool(np.abs(found.T_world_camera - np.eye(4)).max() < 1e-6)
        True
    """
    _check_poses(board_poses, pose_covariance, pixel_std)
    posed = posed_views(views, board, intrinsics, len(board_poses), min_boards)
    starts = {name: first_guess(some, board, intrinsics[name], board_poses) for name, some in posed.items()}
    by_camera = {name: [one.view for one in some] for name, some in posed.items()}
    bundle = _bundle(by_camera, board, intrinsics, board_poses, pose_covariance, pixel_std)
    start = bundle.start(np.array([_vector(inverse(pose)) for pose in starts.values()]))
    solution = least_squares(
        bundle.residuals,
        start,
        bundle.jacobian,  # pyright: ignore[reportArgumentType]  # a callable is allowed
        loss="huber",
        f_scale=_OUTLIER,
        x_scale="jac",
        xtol=1e-12,
        ftol=1e-12,
        max_nfev=200,
        tr_options={"atol": 1e-12, "btol": 1e-12},
    )
    return _extrinsics(bundle, solution.x, by_camera)


def _check_poses(board_poses: np.ndarray, covariance: np.ndarray | None, pixel_std: float) -> None:
    if np.ndim(board_poses) != 3:
        raise ShapeError(f"Expected board_poses with shape (B, 4, 4), got {np.shape(board_poses)}.")
    for index, pose in enumerate(board_poses):
        check_transform(f"board_poses[{index}]", pose)
    if covariance is not None:
        check_covariance("pose_covariance", covariance)
        if not (np.diag(covariance) > 0).all():
            raise InputError(
                "Expected pose_covariance above zero for all axes, got zero. Give None if poses are exact."
            )
    if not 0.0 < pixel_std < np.inf:
        raise InputError(f"Expected pixel_std above zero, got {pixel_std} px.")


def _bundle(
    by_camera: Mapping[str, Sequence[BoardView]],
    board: CharucoBoard,
    intrinsics: Mapping[str, Intrinsics],
    board_poses: np.ndarray,
    covariance: np.ndarray | None,
    pixel_std: float,
) -> Bundle:
    views = [(index, view) for index, some in enumerate(by_camera.values()) for view in some]
    counts = [len(view.corners.ids) for _, view in views]
    whitening = None
    if covariance is not None:
        factor = safe_cholesky(torch.as_tensor(covariance, dtype=torch.float64), "pose_covariance")
        whitening = triangular_solve(factor, torch.eye(6, dtype=torch.float64)).numpy()
    return Bundle(
        cameras=[intrinsics[name] for name in by_camera],
        camera=np.repeat([index for index, _ in views], counts),
        board=np.repeat([view.board for _, view in views], counts),
        places=np.concatenate([board.corners[view.corners.ids] for _, view in views]),
        pixels=np.concatenate([view.corners.pixels for _, view in views]),
        board_poses=np.array([_vector(pose) for pose in board_poses]),
        whitening=whitening,
        pixel_std=pixel_std,
    )


def _extrinsics(
    bundle: Bundle, parameters: np.ndarray, by_camera: Mapping[str, Sequence[BoardView]]
) -> dict[str, Extrinsics]:
    gaps = bundle.pixel_residuals(parameters)
    jacobian = bundle.jacobian(parameters)
    information = torch.as_tensor((jacobian.T @ jacobian).toarray())
    size = 6 * len(by_camera)
    covariance = psd_solve(information, torch.eye(len(information), dtype=torch.float64)[:, :size])[:size].numpy()
    residuals = bundle.residuals(parameters)
    covariance = covariance * max(1.0, float(residuals @ residuals) / max(len(residuals) - len(parameters), 1))
    result = {}
    for index, (name, views) in enumerate(by_camera.items()):
        six = slice(6 * index, 6 * index + 6)
        pose, turned = _of_world(parameters[six], covariance[six, six])
        distances = np.sum(gaps[bundle.camera == index] ** 2, axis=1)
        result[name] = Extrinsics(pose, turned, float(np.sqrt(distances.mean())), len({view.board for view in views}))
    return result


def _of_world(vector: np.ndarray, covariance: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """T_world_camera and the covariance of its rotation and position, from those of T_camera_world's parameters."""
    turn = Rotation.from_rotvec(vector[:3]).as_matrix()
    # R' = exp([e]x) R with e = J dw; R'^T = exp(-[R^T e]x) R^T; position p = -R^T t, dp = -R^T (dt + [t]x e)
    by_turn, shift = left_jacobian(vector[:3]), vector[3:]
    change = np.zeros((6, 6))
    change[:3, :3] = -turn.T @ by_turn
    change[3:, :3] = -turn.T @ cross_matrix(shift) @ by_turn
    change[3:, 3:] = -turn.T
    pose = np.eye(4)
    pose[:3, :3], pose[:3, 3] = turn.T, -turn.T @ shift
    moved = change @ covariance @ change.T
    return pose, 0.5 * (moved + moved.T)


def _vector(pose: np.ndarray) -> np.ndarray:
    return np.concatenate([Rotation.from_matrix(pose[:3, :3]).as_rotvec(), pose[:3, 3]])

"""Where cameras stand in the robot's frame, from images of a board that the robot (or a person) held at known poses.

A pose of the board is known from the robot's joints, exactly or with a covariance. Each image alone gives the camera's
pose; all images of all cameras together are then refined by bundle adjustment, in which uncertain poses of the boards
are unknowns too: a board that several cameras saw ties them together, and the errors of many boards average out.
So are lenses that are known roughly, each with a prior around its given intrinsics.

The camera is the one that took the images. Of a Kinect's colour camera: T_world_depth = T_world_camera @ T_color_depth.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np
import torch
from jaxtyping import Float
from scipy.spatial.transform import Rotation

from eaip_prob.data.frames import Intrinsics, check_transform, inverse
from eaip_prob.errors import InputError, ShapeError
from eaip_prob.linalg import psd_solve, safe_cholesky, triangular_solve
from eaip_prob.perception._bundle import Bundle, cross_matrix, left_jacobian
from eaip_prob.perception.board import CharucoBoard
from eaip_prob.perception.board_view import BoardView, first_guess, posed_views
from eaip_prob.perception.extrinsics import Extrinsics, check_covariance
from eaip_prob.perception.lens_std import LensStd, with_lens

_PIXEL_STD = 0.1  # px; corners of most rendered boards scatter by 0.02 to 0.05 px, which leaves as much for the lens
_OUTLIER = 5.0  # standard deviations, beyond which a residual pulls no harder
_MOST_STEPS = 200
_SMALL_STEP = 1e-6  # standard deviations of what is looked for
_REWEIGHTINGS = 2  # times that views are weighted by how their corners scatter


def calibrate(
    views: Sequence[BoardView],
    board: CharucoBoard,
    intrinsics: Mapping[str, Intrinsics],
    board_poses: Float[np.ndarray, "boards 4 4"],
    pose_covariance: Float[np.ndarray, "6 6"] | None = None,
    pixel_std: float = _PIXEL_STD,
    min_boards: int = 3,
    lens_std: LensStd | None = None,
) -> dict[str, Extrinsics]:
    """Poses of all cameras, and their lenses, jointly refined; what fits badly is kept from pulling hard.

    Views whose corners scatter by more than `pixel_std` count less, as views of far and oblique boards do; single
    corners that fit badly pull no harder than at five standard deviations.

    The covariance is that of corners with `pixel_std`, of the boards' poses and of the lenses, scaled up where
    residuals are larger than that. With `lens_std=None` it holds no error of the intrinsics.

    Args:
        views: of all cameras. Boards seen at more than 60 degrees from their normal are not used: their corners, which
            scatter by 0.03 to 0.1 px otherwise, are off by up to 1.5 px there.
        board: what was seen.
        intrinsics: of each camera, by its name.
        board_poses: (B, 4, 4), T_world_board as the robot says.
        pose_covariance: (6, 6), of each pose's error: rotation vector (rad) and position (m) along the world's axes;
            None where poses are exact.
        pixel_std: standard deviation of a corner's coordinate in a good view, px.
        min_boards: fewest boards a camera must have seen.
        lens_std: how far each camera's given intrinsics may be from its true ones; they are then refined. None where
            they are exact.

    Raises:
        InputError: a camera that saw no or too few boards, a view of an unknown camera, board or corner, or views that
            lead to a lens that no camera has.
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
    bundle = _bundle(by_camera, board, intrinsics, board_poses, pose_covariance, pixel_std, lens_std)
    found = _solved(bundle, bundle.start(np.array([_vector(inverse(pose)) for pose in starts.values()])))
    for _ in range(_REWEIGHTINGS):
        bundle = _reweighted(bundle, found, pixel_std)
        found = _solved(bundle, found)
    return _extrinsics(bundle, found, by_camera)


def _solved(bundle: Bundle, start: np.ndarray) -> np.ndarray:
    """Least squares with Huber's loss by Levenberg and Marquardt, until a step is small against what is uncertain."""
    found, cost, damping = start, _cost(bundle.residuals(start)), 1e-6
    normal, slope = _normal_equations(bundle, found)
    for _ in range(_MOST_STEPS):
        scale = np.sqrt(np.diag(normal))
        damped = torch.as_tensor(normal / np.outer(scale, scale) + damping * np.eye(len(scale)))
        step = -psd_solve(damped, torch.as_tensor(slope / scale)[:, None])[:, 0].numpy() / scale
        after = _cost(bundle.residuals(found + step))
        small = float(step @ normal @ step) < _SMALL_STEP**2
        if after <= cost:
            found, cost, damping = found + step, after, max(0.1 * damping, 1e-12)
            normal, slope = _normal_equations(bundle, found)
        else:
            damping *= 10.0
        if small:
            break
    return found


def _cost(residuals: np.ndarray) -> float:
    size = np.abs(residuals)
    return float(np.where(size > _OUTLIER, 2.0 * _OUTLIER * size - _OUTLIER**2, size**2).sum())


def _normal_equations(bundle: Bundle, parameters: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    residuals, jacobian = bundle.residuals(parameters), bundle.jacobian(parameters)
    weights = np.minimum(1.0, _OUTLIER / np.maximum(np.abs(residuals), _OUTLIER))
    weighted = jacobian.multiply(weights[:, None]).tocsr()
    return (weighted.T @ jacobian).toarray(), weighted.T @ residuals


def _reweighted(bundle: Bundle, parameters: np.ndarray, pixel_std: float) -> Bundle:
    """With the standard deviation of each view's corners as they scatter, where that is more than `pixel_std`."""
    view = bundle.camera * (bundle.board.max() + 1) + bundle.board
    squares = np.bincount(view, np.mean(bundle.pixel_residuals(parameters) ** 2, axis=1))
    scatter = np.sqrt(squares / np.maximum(np.bincount(view), 1))
    return replace(bundle, pixel_std=np.maximum(scatter, pixel_std)[view])


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
    lens_std: LensStd | None,
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
        pixel_std=np.full(sum(counts), pixel_std),
        lens_std=None if lens_std is None else lens_std.vector,
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
    lenses = bundle.lenses(parameters)
    result = {}
    for index, (name, views) in enumerate(by_camera.items()):
        six = slice(6 * index, 6 * index + 6)
        pose, turned = _of_world(parameters[six], covariance[six, six])
        residual = float(np.sqrt(np.mean(np.sum(gaps[bundle.camera == index] ** 2, axis=1))))
        lens = with_lens(bundle.cameras[index], lenses[index])
        result[name] = Extrinsics(pose, turned, residual, len({view.board for view in views}), lens)
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

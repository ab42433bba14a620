"""A board in a robot's hand before cameras: poses within its reach, rendered images, and the corners found in them."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, UInt8
from scipy.spatial.transform import Rotation

from eaip_prob.data.frames import inverse
from eaip_prob.errors import InputError
from eaip_prob.perception.board import CharucoBoard, detect_board
from eaip_prob.perception.board_view import BoardView
from eaip_prob.simulation.board_image import board_image
from eaip_prob.simulation.kinect import Kinect

# Baxter's shoulders, as data/baxter.urdf places them (frames s0 of its arms), m
_SHOULDERS = np.array([[0.064, 0.259, 0.130], [0.064, -0.259, 0.130]])
_REACH = 1.0  # metres from a shoulder to the board's middle; the arm is 1.2 m long, and holds the board's edge
_LOWEST, _HIGHEST = np.array([0.45, -0.8, -0.4]), np.array([1.05, 0.8, 0.7])  # of the board's middle, m
_AIM_STD = 0.35  # metres, by which a board is aimed beside a camera
_LEAST_COSINE = 0.5  # `calibrate` uses no board seen at more than 60 degrees
_FIRST_BOARD = 10  # numbers of the generators: corners of board i are drawn by (seed, 10 + i)


@dataclass(frozen=True, eq=False)
class BoardSession:
    """What the cameras saw of a board that was held at many poses; rendered once, calibrated often.

    Args:
        cameras: the units, with their true lenses and places.
        board: that was shown.
        T_world_board: (B, 4, 4), its true poses.
        views: corners found in the images.
        image: one of the images, RGB, of the first of `views`.
        seed: of all that was drawn.

    Example:
        >>> image = np.zeros((1, 1, 3), np.uint8)
        >>> BoardSession((), CharucoBoard(), np.tile(np.eye(4), (2, 1, 1)), (), image, seed=0).num_boards
        2
    """

    cameras: Sequence[Kinect]
    board: CharucoBoard
    T_world_board: Float[np.ndarray, "boards 4 4"]
    views: Sequence[BoardView]
    image: UInt8[np.ndarray, "height width 3"]
    seed: int

    @property
    def num_boards(self) -> int:
        """How many poses of the board there are."""
        return len(self.T_world_board)


def held_boards(
    cameras: Sequence[Kinect], count: int, board: CharucoBoard, generator: np.random.Generator
) -> Float[np.ndarray, "boards 4 4"]:
    """T_world_board of boards within a robot's reach, each held roughly towards one camera and turned about its normal.

    Args:
        cameras: at which boards are shown in turn.
        count: B, of boards.
        board: what is held, by its middle.
        generator: of the draw.

    Raises:
        InputError: no cameras or no boards.

    Example:
        >>> from eaip_prob.data.frames import Intrinsics
        >>> from eaip_prob.simulation import KinectModel, looking_at
        >>> lens = Intrinsics(1920, 1080, 1060.0, 1060.0, 960.0, 540.0)
        >>> unit = Kinect("left", KinectModel(lens, lens, (-0.05, 0, 0)), looking_at((0.5, 1.7, 1.1), (1.0, 0.0, 0.0)))
        >>> poses = held_boards([unit], 4, CharucoBoard(), np.random.default_rng(1))
        >>> poses.shape, bool((poses[:, :3, 2] @ unit.T_world_camera[:3, 2] > 0.5).all())
        ((4, 4, 4), True)
    """
    if not cameras or count < 1:
        raise InputError(f"Expected at least one camera and one board, got {len(cameras)} and {count}.")
    poses = np.tile(np.eye(4), (count, 1, 1))
    for index, pose in enumerate(poses):
        centre = _within_reach(generator)
        eye = cameras[index % len(cameras)].color_view.T_world_camera[:3, 3] + generator.normal(0.0, _AIM_STD, 3)
        turn = Rotation.from_rotvec([0.0, 0.0, generator.uniform(-np.pi, np.pi)])
        pose[:3, :3] = _facing(centre, eye) @ turn.as_matrix()
        pose[:3, 3] = centre - pose[:3, :3] @ np.array([*board.size, 0.0]) / 2.0
    return poses


def board_session(
    cameras: Sequence[Kinect],
    num_boards: int,
    seed: int,
    board: CharucoBoard | None = None,
    noise: float = 2.0,
    progress: Callable[[Iterable[int]], Iterable[int]] = iter,
) -> BoardSession:
    """Shows a board to simulated cameras: draws poses, renders images and finds corners.

    Args:
        cameras: the units; boards that none of them faces, or that lie outside its image, give no view.
        num_boards: how many poses of the board are drawn.
        seed: of poses and noise; a longer session begins with the images of a shorter one.
        board: what is held; `CharucoBoard()` if None.
        noise: standard deviation of each pixel's brightness, of 255.
        progress: wraps the numbers of the boards, as `tqdm` does.

    Raises:
        InputError: no cameras or boards, or no board was found in any image.
    """
    board = CharucoBoard() if board is None else board
    poses = held_boards(cameras, num_boards, board, np.random.default_rng([seed, 0]))
    views, first = [], None
    for index in progress(range(num_boards)):
        generator = np.random.default_rng([seed, _FIRST_BOARD + index])
        for camera in cameras:
            T_camera_board = inverse(camera.color_view.T_world_camera) @ poses[index]
            if not _faces(T_camera_board, board):
                continue
            image = board_image(board, camera.model.color_camera, T_camera_board, noise, generator)
            corners = detect_board(image, board)
            if corners is not None:
                first = image if first is None else first
                views.append(BoardView(camera.name, index, corners))
    if first is None:
        raise InputError(f"Expected the board in some image, got none of {num_boards} found. Aim cameras at the robot.")
    return BoardSession(cameras, board, poses, views, first, seed)


def _within_reach(generator: np.random.Generator) -> np.ndarray:
    while True:
        centre = generator.uniform(_LOWEST, _HIGHEST)
        if np.linalg.norm(_SHOULDERS - centre, axis=1).min() <= _REACH:
            return centre


def _facing(centre: np.ndarray, eye: np.ndarray) -> np.ndarray:
    """Axes of a board whose print is seen from `eye`: its z points away."""
    z = (centre - eye) / np.linalg.norm(centre - eye)
    x = np.cross(z, [1.0, 0.0, 0.0] if abs(z[2]) > 0.9 else [0.0, 0.0, 1.0])
    x /= np.linalg.norm(x)
    return np.column_stack([x, np.cross(z, x), z])


def _faces(T_camera_board: np.ndarray, board: CharucoBoard) -> bool:
    middle = T_camera_board[:3, :3] @ np.array([*board.size, 0.0]) / 2.0 + T_camera_board[:3, 3]
    return middle[2] > 0.0 and float(T_camera_board[:3, 2] @ middle) > _LEAST_COSINE * float(np.linalg.norm(middle))

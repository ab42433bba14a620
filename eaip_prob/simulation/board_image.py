"""Images of a calibration board in front of a camera with a real lens."""

from __future__ import annotations

import cv2
import numpy as np
from jaxtyping import Float, UInt8

from eaip_prob.data.frames import Intrinsics, check_transform
from eaip_prob.errors import InputError
from eaip_prob.perception.board import CharucoBoard

_PER_SQUARE = 112  # px; a whole number for each bit of a marker of 5 x 5 in a border, at 3/4 of a square
_SAMPLES = 3  # along each side of a pixel
_PAPER = 0.5  # width of the white margin, squares
_BACKGROUND = 90


def board_image(
    board: CharucoBoard,
    intrinsics: Intrinsics,
    T_camera_board: Float[np.ndarray, "4 4"],
    noise: float = 0.0,
    generator: np.random.Generator | None = None,
) -> UInt8[np.ndarray, "height width 3"]:
    """What a camera sees of the board alone, RGB: every pixel is the mean of nine samples of its area.

    Args:
        board: what is seen; grey from behind.
        intrinsics: of the camera, with its distortion.
        T_camera_board: (4, 4), maps board coordinates into those of the camera.
        noise: standard deviation of each pixel's brightness, of 255.
        generator: needed where there is noise.

    Raises:
        InputError: T_camera_board is no rigid motion, or noise without a generator.

    Example:
        >>> camera, pose = Intrinsics(160, 120, 150.0, 150.0, 80.0, 60.0), np.eye(4)
        >>> pose[:3, 3] = (-0.3, -0.2, 0.8)
        >>> image = board_image(CharucoBoard(), camera, pose)
        >>> image.shape, int(image.max())
        ((120, 160, 3), 255)
    """
    check_transform("T_camera_board", T_camera_board)
    image = np.full((intrinsics.height, intrinsics.width), float(_BACKGROUND))
    places = _places(intrinsics, T_camera_board)
    margin = _PAPER * board.square
    upper = np.array(board.size) + margin
    with np.errstate(invalid="ignore"):
        near = ((places > -2 * margin) & (places < upper + margin)).all(-1)
    if near.any():
        rows, columns = np.nonzero(near)
        window = np.s_[rows.min() : rows.max() + 1, columns.min() : columns.max() + 1]
        image[window] = _sampled(board, np.nan_to_num(places[window], nan=-1e3), T_camera_board)
    if noise > 0.0:
        if generator is None:
            raise InputError(
                f"Expected a generator for noise of {noise}, got none. Give numpy.random.default_rng(seed)."
            )
        image += generator.normal(0.0, noise, image.shape)
    return np.repeat(np.clip(np.rint(image), 0, 255).astype(np.uint8)[..., None], 3, -1)


def _places(intrinsics: Intrinsics, T_camera_board: np.ndarray) -> np.ndarray:
    """(H, W, 2): where each pixel's ray meets the board's plane, in board coordinates, m; NaN where it does not."""
    turn, shift = T_camera_board[:3, :3], T_camera_board[:3, 3]
    rays = np.concatenate([intrinsics.rays, np.ones((intrinsics.height, intrinsics.width, 1))], -1)
    with np.errstate(divide="ignore", invalid="ignore"):
        distance = (turn[:, 2] @ shift) / (rays @ turn[:, 2])
        distance = np.where(distance > 0, distance, np.nan)
        return (rays * distance[..., None] - shift) @ turn[:, :2]


def _sampled(board: CharucoBoard, places: np.ndarray, T_camera_board: np.ndarray) -> np.ndarray:
    margin = round(_PAPER * _PER_SQUARE)
    texture = board.drawn(_PER_SQUARE, margin)
    if T_camera_board[:3, 2] @ T_camera_board[:3, 3] < 0:  # z points at the viewer, who is behind
        texture = np.full_like(texture, 160)
    pixels = places / board.square * _PER_SQUARE + margin - 0.5  # squares begin at the edge of a pixel
    down, along = np.gradient(pixels, axis=(0, 1)) if min(pixels.shape[:2]) > 1 else (0.0, 0.0)
    total = np.zeros(pixels.shape[:2])
    steps = (np.arange(_SAMPLES) + 0.5) / _SAMPLES - 0.5
    for dv in steps:
        for du in steps:
            columns, rows = np.moveaxis((pixels + du * along + dv * down).astype(np.float32), -1, 0)
            total += cv2.remap(
                texture, columns, rows, cv2.INTER_LINEAR, borderMode=cv2.BORDER_CONSTANT, borderValue=[_BACKGROUND]
            )
    return total / _SAMPLES**2

"""A ChArUco board, a chessboard with a marker in each white square, and its corners in an image.

Any part of the board that is seen gives corners with known places on it. Board coordinates are OpenCV's: the origin at
the upper left corner of the printed squares, x to the right, y down, z away from the viewer (metres). From behind, the
board is mirrored and nothing is found.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import cv2
import numpy as np
from jaxtyping import Float, Int, UInt8

from eaip_prob.data.frames import Intrinsics
from eaip_prob.errors import InputError, ShapeError

LEAST_CORNERS = 6  # of a detection: a pose from four is ambiguous where they are seen from afar


@dataclass(frozen=True)
class CharucoBoard:
    """What is printed on the board.

    Args:
        columns: number of squares along x.
        rows: number of squares along y.
        square: length of their sides, m.
        marker: length of the sides of the markers inside, m.
        dictionary: OpenCV's name of the markers.

    Raises:
        InputError: no such dictionary, too few squares or markers, or markers that do not fit in squares.

    Example:
        >>> board = CharucoBoard(columns=5, rows=4, square=0.1, marker=0.07)
        >>> board.corners.shape, board.corners[0].tolist(), board.size
        ((12, 3), [0.1, 0.1, 0.0], (0.5, 0.4))
    """

    columns: int = 9
    rows: int = 6
    square: float = 0.07
    marker: float = 0.0525
    dictionary: str = "DICT_5X5_100"

    def __post_init__(self) -> None:
        if self.columns < 3 or self.rows < 3 or not 0 < self.marker < self.square:
            raise InputError(
                f"Expected at least 3 x 3 squares with smaller markers, got {self.columns} x {self.rows} squares of "
                f"{self.square} m with markers of {self.marker} m."
            )
        if not self.dictionary.startswith("DICT_") or not hasattr(cv2.aruco, self.dictionary):
            raise InputError(f"Expected OpenCV's name of a dictionary, as DICT_5X5_100, got {self.dictionary!r}.")
        needed, known = self.columns * self.rows // 2, len(self._markers.bytesList)
        if needed > known:
            raise InputError(f"Expected at least {needed} markers in {self.dictionary}, got {known}. Use a larger one.")

    @property
    def size(self) -> tuple[float, float]:
        """Length along x and y, m."""
        return self.columns * self.square, self.rows * self.square

    @cached_property
    def corners(self) -> Float[np.ndarray, "corners 3"]:
        """Places of the inner corners on the board by their number, m: along x first."""
        rows, columns = np.divmod(np.arange((self.columns - 1) * (self.rows - 1)), self.columns - 1)
        return np.column_stack([(columns + 1) * self.square, (rows + 1) * self.square, np.zeros(len(rows))])

    @cached_property
    def _markers(self) -> cv2.aruco.Dictionary:
        return cv2.aruco.getPredefinedDictionary(getattr(cv2.aruco, self.dictionary))

    @cached_property
    def _board(self) -> cv2.aruco.CharucoBoard:
        return cv2.aruco.CharucoBoard((self.columns, self.rows), self.square, self.marker, self._markers)

    @cached_property
    def detector(self) -> cv2.aruco.CharucoDetector:
        """OpenCV's detector of this board."""
        return cv2.aruco.CharucoDetector(self._board)

    def drawn(self, pixels_per_square: int, margin: int = 0) -> UInt8[np.ndarray, "height width"]:
        """The board as a grey image for printing; its squares begin after `margin` white pixels.

        Args:
            pixels_per_square: px.
            margin: white border, px.
        """
        size = (self.columns * pixels_per_square + 2 * margin, self.rows * pixels_per_square + 2 * margin)
        return self._board.generateImage(size, marginSize=margin, borderBits=1)


@dataclass(frozen=True, eq=False)
class BoardCorners:
    """Corners of a board that were found in an image.

    Args:
        ids: (n,), numbers of the corners, rows of `CharucoBoard.corners`.
        pixels: (n, 2), column and row, px.

    Raises:
        ShapeError: not one pixel for each number.
        InputError: pixels that are not finite, or a number twice.

    Example:
        >>> len(BoardCorners(np.array([0, 3]), np.array([[10.0, 20.0], [30.0, 20.0]])).ids)
        2
    """

    ids: Int[np.ndarray, "corners"]
    pixels: Float[np.ndarray, "corners 2"]

    def __post_init__(self) -> None:
        if np.ndim(self.ids) != 1 or np.shape(self.pixels) != (len(self.ids), 2):
            raise ShapeError(f"Expected ids (n,) and pixels (n, 2), got {np.shape(self.ids)}, {np.shape(self.pixels)}.")
        if not np.isfinite(self.pixels).all() or len(np.unique(self.ids)) != len(self.ids):
            raise InputError("Expected finite pixels and each corner once, got others. Leave out what was not found.")


def detect_board(image: np.ndarray, board: CharucoBoard) -> BoardCorners | None:
    """The corners of the board in an image, to some hundredths of a pixel; None where the board is not seen.

    Args:
        image: (H, W, 3) RGB or (H, W), uint8.
        board: what is looked for; from behind it is not found.

    Raises:
        InputError: no uint8.
        ShapeError: neither a colour nor a grey image.

    Example:
        >>> board = CharucoBoard(columns=5, rows=4)
        >>> len(detect_board(board.drawn(60, margin=30), board).ids)
        12
        >>> detect_board(np.zeros((90, 90), np.uint8), board) is None
        True
    """
    if not isinstance(image, np.ndarray) or image.dtype != np.uint8:
        raise InputError(f"Expected an image of uint8, got {getattr(image, 'dtype', type(image).__name__)}.")
    if image.ndim not in (2, 3) or (image.ndim == 3 and image.shape[2] != 3):
        raise ShapeError(f"Expected an image with shape (H, W, 3) or (H, W), got {image.shape}.")
    grey = image if image.ndim == 2 else cv2.cvtColor(image, cv2.COLOR_RGB2GRAY)
    corners, ids, _, _ = board.detector.detectBoard(grey)
    if ids is None or len(ids) < LEAST_CORNERS:
        return None
    return BoardCorners(ids.ravel().astype(int), corners.reshape(-1, 2).astype(float))


def board_pose(corners: BoardCorners, board: CharucoBoard, camera: Intrinsics) -> Float[np.ndarray, "4 4"] | None:
    """T_camera_board from one image, by SQPnP and Levenberg-Marquardt; None where the corners give no pose.

    Args:
        corners: found in the image.
        board: what they belong to.
        camera: that took the image.
    """
    places, lens = board.corners[corners.ids], np.array(camera.distortion)
    pixels = np.ascontiguousarray(corners.pixels, dtype=float)  # OpenCV refuses slices
    if len(places) < LEAST_CORNERS or np.linalg.matrix_rank(places - places.mean(0), tol=0.5 * board.square) < 2:
        return None  # too few, or on one line
    found, turn, shift = cv2.solvePnP(places, pixels, camera.matrix, lens, flags=cv2.SOLVEPNP_SQPNP)
    if not found:
        return None
    turn, shift = cv2.solvePnPRefineLM(places, pixels, camera.matrix, lens, turn, shift)
    pose = np.eye(4)
    pose[:3, :3], pose[:3, 3] = cv2.Rodrigues(turn)[0], shift.ravel()
    return pose

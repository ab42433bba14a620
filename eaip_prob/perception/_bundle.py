"""Joint refinement of cameras and boards: residuals of all corners and of the boards' known poses, with derivatives.

Parameters are rows of six, a rotation vector (rad) and a translation (m): first T_camera_world of each camera, then, if
they are uncertain, T_world_board of each board. A corner X on a board lies at P = R_c (R_b X + t_b) + t_c; a small
change d of a rotation vector w turns R by exp([J(w) d]x) from the left, J being the left Jacobian of SO(3).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.sparse import csr_matrix, vstack
from scipy.spatial.transform import Rotation

from eaip_prob.data.frames import Intrinsics
from eaip_prob.data.lens import distortion_jacobian


@dataclass(frozen=True, eq=False)
class Bundle:
    """Everything that was measured, corner by corner.

    Args:
        cameras: intrinsics of each camera.
        camera: (n,), which one saw the corner.
        board: (n,), on which board it is.
        places: (n, 3), where on the board, m.
        pixels: (n, 2), where in the image, px.
        board_poses: (B, 6), rotation vectors and positions in the world as they are known.
        whitening: (6, 6), makes their errors standard normal; None where the poses are exact.
        pixel_std: standard deviation of a pixel coordinate, px.
    """

    cameras: Sequence[Intrinsics]
    camera: np.ndarray
    board: np.ndarray
    places: np.ndarray
    pixels: np.ndarray
    board_poses: np.ndarray
    whitening: np.ndarray | None
    pixel_std: float

    def start(self, camera_poses: np.ndarray) -> np.ndarray:
        """Parameters at poses (C, 6) of the cameras and the known ones of the boards."""
        return np.concatenate([camera_poses.ravel(), [] if self.whitening is None else self.board_poses.ravel()])

    def pixel_residuals(self, parameters: np.ndarray) -> np.ndarray:
        """(n, 2): projected less seen, px."""
        _, _, seen = self._points(parameters)
        result = np.empty_like(self.pixels)
        for index, camera in enumerate(self.cameras):
            rows = self.camera == index
            result[rows] = camera.project(seen[rows]) - self.pixels[rows]
        # a step that takes a corner behind its camera must look bad, not undefined
        return np.where(np.isfinite(result), result, 1e4)

    def residuals(self, parameters: np.ndarray) -> np.ndarray:
        """Standard normal at the truth: corners first, then the boards' poses."""
        corners = (self.pixel_residuals(parameters) / self.pixel_std).ravel()
        if self.whitening is None:
            return corners
        poses = self._poses(parameters)[1]
        gaps = np.column_stack([self._turned(poses).as_rotvec(), poses[:, 3:] - self.board_poses[:, 3:]])
        return np.concatenate([corners, (gaps @ self.whitening.T).ravel()])

    def jacobian(self, parameters: np.ndarray) -> csr_matrix:
        """Derivatives of `residuals`: each corner depends on one camera and one board."""
        by_camera, by_board = self._derivatives(parameters)
        blocks, columns = [by_camera], [6 * self.camera]
        if self.whitening is not None:
            blocks, columns = [by_camera, by_board], [6 * self.camera, 6 * (len(self.cameras) + self.board)]
        values = np.concatenate(blocks, -1).reshape(2 * len(self.pixels), -1)
        at = np.concatenate([first[:, None] + np.arange(6) for first in columns], -1)
        rows = _sparse_rows(values, np.repeat(at, 2, axis=0), len(parameters))
        if self.whitening is None:
            return rows
        first = 6 * (len(self.cameras) + np.arange(len(self.board_poses)))
        at = np.repeat(first[:, None] + np.arange(6), 6, axis=0)
        prior = _sparse_rows(self._prior_derivatives(parameters).reshape(-1, 6), at, len(parameters))
        return csr_matrix(vstack([rows, prior]))

    def _poses(self, parameters: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        split = 6 * len(self.cameras)
        boards = self.board_poses if self.whitening is None else parameters[split:].reshape(-1, 6)
        return parameters[:split].reshape(-1, 6), boards

    def _points(self, parameters: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """(n, 3) each: R_b X, R_c (R_b X + t_b), and P."""
        cameras, boards = self._poses(parameters)
        turned = Rotation.from_rotvec(boards[self.board, :3]).apply(self.places)
        local = Rotation.from_rotvec(cameras[self.camera, :3]).apply(turned + boards[self.board, 3:])
        return turned, local, local + cameras[self.camera, 3:]

    def _derivatives(self, parameters: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """(n, 2, 6) each: of the corners' residuals by their camera's and their board's parameters."""
        cameras, boards = self._poses(parameters)
        turned, local, seen = self._points(parameters)
        by_point = np.empty((len(seen), 2, 3))
        for index, camera in enumerate(self.cameras):
            rows = self.camera == index
            by_point[rows] = _projection_jacobian(seen[rows], camera) / self.pixel_std
        turns = Rotation.from_rotvec(cameras[:, :3]).as_matrix()[self.camera]
        by_turn = -cross_matrix(local) @ left_jacobian(cameras[:, :3])[self.camera]
        by_board_turn = -turns @ cross_matrix(turned) @ left_jacobian(boards[:, :3])[self.board]
        by_camera = np.concatenate([by_point @ by_turn, by_point], -1)
        return by_camera, np.concatenate([by_point @ by_board_turn, by_point @ turns], -1)

    def _turned(self, poses: np.ndarray) -> Rotation:
        return Rotation.from_rotvec(poses[:, :3]) * Rotation.from_rotvec(-self.board_poses[:, :3])

    def _prior_derivatives(self, parameters: np.ndarray) -> np.ndarray:
        """(B, 6, 6); the inverse of J at the gaps by its series, which are small against 1 rad."""
        poses = self._poses(parameters)[1]
        gap = cross_matrix(self._turned(poses).as_rotvec())
        blocks = np.zeros((len(poses), 6, 6))
        blocks[:, :3, :3] = (np.eye(3) - gap / 2.0 + gap @ gap / 12.0) @ left_jacobian(poses[:, :3])
        blocks[:, 3:, 3:] = np.eye(3)
        return np.asarray(self.whitening) @ blocks


def cross_matrix(vectors: np.ndarray) -> np.ndarray:
    """Matrices (*batch, 3, 3) that take the cross product of vectors (*batch, 3) with what they multiply."""
    x, y, z = np.moveaxis(vectors, -1, 0)
    zero = np.zeros_like(x)
    return np.stack([zero, -z, y, z, zero, -x, -y, x, zero], -1).reshape(*x.shape, 3, 3)


def left_jacobian(rotation_vectors: np.ndarray) -> np.ndarray:
    """(*batch, 3, 3): J = I + (1 - cos a) / a^2 [w]x + (a - sin a) / a^3 [w]x^2 with a = |w|."""
    angle = np.linalg.norm(rotation_vectors, axis=-1)[..., None, None]
    safe = np.maximum(angle, 1e-4)
    one = np.where(angle > 1e-4, (1.0 - np.cos(safe)) / safe**2, 0.5)
    two = np.where(angle > 1e-4, (safe - np.sin(safe)) / safe**3, 1.0 / 6.0)
    cross = cross_matrix(rotation_vectors)
    return np.eye(3) + one * cross + two * cross @ cross


def _projection_jacobian(points: np.ndarray, camera: Intrinsics) -> np.ndarray:
    """(n, 2, 3): of the pixel by the point in camera coordinates, px / m."""
    x, y, z = points[:, 0] / points[:, 2], points[:, 1] / points[:, 2], points[:, 2]
    j_xx, j_xy, j_yy = distortion_jacobian(x, y, camera.distortion)
    bent = np.stack([camera.fx * j_xx, camera.fx * j_xy, camera.fy * j_xy, camera.fy * j_yy], -1).reshape(-1, 2, 2)
    zero, one = np.zeros_like(x), np.ones_like(x)
    pinhole = np.stack([one, zero, -x, zero, one, -y], -1).reshape(-1, 2, 3) / z[:, None, None]
    return bent @ pinhole


def _sparse_rows(values: np.ndarray, columns: np.ndarray, num_columns: int) -> csr_matrix:
    starts = np.arange(len(values) + 1) * values.shape[1]
    return csr_matrix((values.ravel(), columns.ravel(), starts), shape=(len(values), num_columns))

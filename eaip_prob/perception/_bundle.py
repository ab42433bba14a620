"""Joint refinement of cameras and boards: residuals of all corners and of the boards' known poses, with derivatives.

Parameters are rows of six, a rotation vector (rad) and a translation (m): first T_camera_world of each camera, then, if
they are uncertain, T_world_board of each board. A corner X on a board lies at P = R_c (R_b X + t_b) + t_c; a small
change d of a rotation vector w turns R by exp([J(w) d]x) from the left, J being the left Jacobian of SO(3).
If lenses are uncertain, rows of nine follow, one for each camera: the change of its lens over its standard deviation,
so that pixels and coefficients have one scale, and one that is exact (zero standard deviation) stays as it is.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.sparse import csr_matrix, vstack
from scipy.spatial.transform import Rotation

from eaip_prob.data.frames import Intrinsics
from eaip_prob.perception._projection import by_lens, by_point, projected
from eaip_prob.perception.lens_std import NUM_LENS, lens_vector


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
        pixel_std: (n,), standard deviation of each corner's coordinates, px.
        lens_std: (9,), standard deviations of each camera's lens; None where the lenses are exact.
    """

    cameras: Sequence[Intrinsics]
    camera: np.ndarray
    board: np.ndarray
    places: np.ndarray
    pixels: np.ndarray
    board_poses: np.ndarray
    whitening: np.ndarray | None
    pixel_std: np.ndarray
    lens_std: np.ndarray | None = None

    def start(self, camera_poses: np.ndarray) -> np.ndarray:
        """Parameters at poses (C, 6) of the cameras, the known ones of the boards and the given lenses."""
        boards = [] if self.whitening is None else self.board_poses.ravel()
        lenses = [] if self.lens_std is None else np.zeros(NUM_LENS * len(self.cameras))
        return np.concatenate([camera_poses.ravel(), boards, lenses])

    def lenses(self, parameters: np.ndarray) -> np.ndarray:
        """(C, 9): each camera's lens."""
        given = np.array([lens_vector(camera) for camera in self.cameras])
        if self.lens_std is None:
            return given
        return given + self.lens_std * parameters[self._first_lens :].reshape(-1, NUM_LENS)

    def pixel_residuals(self, parameters: np.ndarray) -> np.ndarray:
        """(n, 2): projected less seen, px."""
        _, _, seen = self._points(parameters)
        result = np.empty_like(self.pixels)
        for index, lens in enumerate(self.lenses(parameters)):
            rows = self.camera == index
            result[rows] = projected(seen[rows], lens) - self.pixels[rows]
        # a step that takes a corner behind its camera must look bad, not undefined
        return np.where(np.isfinite(result), result, 1e4)

    def residuals(self, parameters: np.ndarray) -> np.ndarray:
        """Standard normal at the truth: corners first, then the boards' poses, then the lenses."""
        parts = [(self.pixel_residuals(parameters) / self.pixel_std[:, None]).ravel()]
        if self.whitening is not None:
            poses = self._poses(parameters)[1]
            gaps = np.column_stack([self._turned(poses).as_rotvec(), poses[:, 3:] - self.board_poses[:, 3:]])
            parts.append((gaps @ self.whitening.T).ravel())
        if self.lens_std is not None:
            parts.append(parameters[self._first_lens :])
        return np.concatenate(parts)

    def jacobian(self, parameters: np.ndarray) -> csr_matrix:
        """Derivatives of `residuals`: each corner depends on one camera, its lens and one board."""
        by_camera, by_board, by_change = self._derivatives(parameters)
        blocks, firsts = [by_camera], [6 * self.camera]
        if self.whitening is not None:
            blocks, firsts = [*blocks, by_board], [*firsts, 6 * (len(self.cameras) + self.board)]
        if self.lens_std is not None:
            blocks, firsts = [*blocks, by_change], [*firsts, self._first_lens + NUM_LENS * self.camera]
        values = np.concatenate(blocks, -1).reshape(2 * len(self.pixels), -1)
        at = [first[:, None] + np.arange(block.shape[-1]) for first, block in zip(firsts, blocks, strict=True)]
        corners = _sparse_rows(values, np.repeat(np.concatenate(at, -1), 2, axis=0), len(parameters))
        return csr_matrix(vstack([corners, *self._prior_rows(parameters)]))

    @property
    def _first_lens(self) -> int:
        return 6 * (len(self.cameras) + (0 if self.whitening is None else len(self.board_poses)))

    def _prior_rows(self, parameters: np.ndarray) -> list[csr_matrix]:
        rows = []
        if self.whitening is not None:
            first = 6 * (len(self.cameras) + np.arange(len(self.board_poses)))
            at = np.repeat(first[:, None] + np.arange(6), 6, axis=0)
            rows.append(_sparse_rows(self._prior_derivatives(parameters).reshape(-1, 6), at, len(parameters)))
        if self.lens_std is not None:
            at = np.arange(self._first_lens, len(parameters))[:, None]
            rows.append(_sparse_rows(np.ones((len(at), 1)), at, len(parameters)))
        return rows

    def _poses(self, parameters: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        split = 6 * len(self.cameras)
        boards = self.board_poses if self.whitening is None else parameters[split : self._first_lens].reshape(-1, 6)
        return parameters[:split].reshape(-1, 6), boards

    def _points(self, parameters: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """(n, 3) each: R_b X, R_c (R_b X + t_b), and P."""
        cameras, boards = self._poses(parameters)
        turned = Rotation.from_rotvec(boards[self.board, :3]).apply(self.places)
        local = Rotation.from_rotvec(cameras[self.camera, :3]).apply(turned + boards[self.board, 3:])
        return turned, local, local + cameras[self.camera, 3:]

    def _derivatives(self, parameters: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """(n, 2, 6), (n, 2, 6) and (n, 2, 9): of the corners' residuals by their camera, their board and their lens."""
        cameras, boards = self._poses(parameters)
        turned, local, seen = self._points(parameters)
        point, change = np.empty((len(seen), 2, 3)), np.zeros((len(seen), 2, NUM_LENS))
        for index, lens in enumerate(self.lenses(parameters)):
            rows = self.camera == index
            point[rows] = by_point(seen[rows], lens) / self.pixel_std[rows, None, None]
            if self.lens_std is not None:
                change[rows] = by_lens(seen[rows], lens) * self.lens_std / self.pixel_std[rows, None, None]
        turns = Rotation.from_rotvec(cameras[:, :3]).as_matrix()[self.camera]
        by_turn = -cross_matrix(local) @ left_jacobian(cameras[:, :3])[self.camera]
        by_board_turn = -turns @ cross_matrix(turned) @ left_jacobian(boards[:, :3])[self.board]
        by_camera = np.concatenate([point @ by_turn, point], -1)
        return by_camera, np.concatenate([point @ by_board_turn, point @ turns], -1), change

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


def _sparse_rows(values: np.ndarray, columns: np.ndarray, num_columns: int) -> csr_matrix:
    starts = np.arange(len(values) + 1) * values.shape[1]
    return csr_matrix((values.ravel(), columns.ravel(), starts), shape=(len(values), num_columns))

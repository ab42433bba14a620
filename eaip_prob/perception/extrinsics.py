"""Where a camera stands, how sure that is, and how far it is from the truth."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float
from scipy.spatial.transform import Rotation

from eaip_prob.data.frames import Intrinsics, check_transform, inverse
from eaip_prob.errors import InputError, ShapeError
from eaip_prob.perception._bundle import cross_matrix


@dataclass(frozen=True, eq=False)
class Extrinsics:
    """Where a camera stands, and the lens with which that holds: another one makes another pose of the same images.

    Args:
        T_world_camera: (4, 4), maps coordinates of the camera into the world.
        covariance: (6, 6), of a rotation vector (rad) and the position (m) of the camera, both along the world's axes.
        residual: root mean square distance between corners seen and expected, px.
        num_boards: of how many poses of the board.
        intrinsics: of the camera, refined if they were uncertain.

    Raises:
        ShapeError: matrices of other shapes.
        InputError: no rigid motion, a covariance that is none, a negative residual or count.

    Example:
        >>> camera = Intrinsics(1920, 1080, 1060.0, 1060.0, 960.0, 540.0)
        >>> left = Extrinsics(np.eye(4), np.eye(6) * 1e-6, residual=0.1, num_boards=8, intrinsics=camera)
        >>> round(left.position_std, 4)
        0.0017
    """

    T_world_camera: Float[np.ndarray, "4 4"]
    covariance: Float[np.ndarray, "6 6"]
    residual: float
    num_boards: int
    intrinsics: Intrinsics

    def __post_init__(self) -> None:
        check_transform("T_world_camera", self.T_world_camera)
        check_covariance("covariance", self.covariance)
        if not 0.0 <= self.residual < np.inf or self.num_boards < 1:
            raise InputError(f"Expected a residual and boards, got {self.residual} px of {self.num_boards} boards.")

    @property
    def position_std(self) -> float:
        """Standard deviation of the distance to the true position, m."""
        return float(np.sqrt(np.trace(self.covariance[3:, 3:])))

    def workspace_std(self, points: Float[np.ndarray, "points 3"]) -> float:
        """Standard deviation of how far the camera misplaces points: what `workspace_error` is expected to be, m.

        Args:
            points: (P, 3), of the workspace, in the world, m.

        Raises:
            ShapeError: no points.
        """
        _check_points(points)
        # a point p moves by e x (p - c) + dc, with e the rotation's error and c the camera's position
        moves = np.zeros((len(points), 3, 6))
        moves[:, :, :3] = -cross_matrix(points - self.T_world_camera[:3, 3])
        moves[:, :, 3:] = np.eye(3)
        return float(np.sqrt(np.einsum("pij,jk,pik->", moves, self.covariance, moves) / len(points)))


@dataclass(frozen=True)
class PoseError:
    """How far poses are from others.

    Args:
        position: m.
        rotation: rad.

    Example:
        >>> error = PoseError(position=0.002, rotation=0.01)
        >>> error.millimetres, round(error.degrees, 3)
        (2.0, 0.573)
    """

    position: float
    rotation: float

    @property
    def millimetres(self) -> float:
        """The position's error for people to read."""
        return 1e3 * self.position

    @property
    def degrees(self) -> float:
        """The rotation's error for people to read."""
        return float(np.degrees(self.rotation))


def workspace_error(
    estimated: Sequence[Float[np.ndarray, "4 4"]],
    true: Sequence[Float[np.ndarray, "4 4"]],
    points: Float[np.ndarray, "points 3"],
) -> PoseError:
    """Of the worst camera: how far it misplaces points of the workspace (root mean square), and its largest rotation.

    An error of rotation and one of position that cancel at the workspace do no harm there; this measures what is left.

    Args:
        estimated: (4, 4) for each camera, T_world_camera.
        true: the same cameras' true ones, in the same order.
        points: (P, 3), of the workspace, in the world, m.

    Raises:
        ShapeError: no points, or another number of true poses.

    Example:
        >>> moved = np.eye(4)
        >>> moved[0, 3] = 0.003
        >>> workspace_error([moved], [np.eye(4)], np.zeros((1, 3))).millimetres
        3.0
    """
    if len(estimated) != len(true) or not len(estimated):
        raise ShapeError(f"Expected as many true poses as estimated, got {len(true)} and {len(estimated)}.")
    _check_points(points)
    position = rotation = 0.0
    for ours, theirs in zip(estimated, true, strict=True):
        check_transform("estimated", ours)
        check_transform("true", theirs)
        change = ours @ inverse(theirs)
        gaps = points @ change[:3, :3].T + change[:3, 3] - points
        position = max(position, float(np.sqrt(np.mean(np.sum(gaps**2, axis=1)))))
        rotation = max(rotation, float(Rotation.from_matrix(change[:3, :3]).magnitude()))
    return PoseError(position, rotation)


def _check_points(points: np.ndarray) -> None:
    if np.ndim(points) != 2 or np.shape(points)[1] != 3 or not len(points):
        raise ShapeError(f"Expected points of the workspace with shape (P, 3), got {np.shape(points)}.")


def check_covariance(name: str, covariance: Float[np.ndarray, "6 6"]) -> None:
    """Refuses what is no covariance of a pose.

    Args:
        name: of the argument, for the message.
        covariance: (6, 6).

    Raises:
        ShapeError: another shape.
        InputError: not finite, not symmetric, or with a negative variance in some direction.
    """
    if np.shape(covariance) != (6, 6):
        raise ShapeError(f"Expected {name} with shape (6, 6), got {np.shape(covariance)}: rotation, then position.")
    scale = np.sqrt(np.abs(np.diag(covariance))) + 1e-300
    scaled = covariance / scale / scale[:, None]
    if not np.isfinite(scaled).all() or np.abs(scaled - scaled.T).max() > 1e-6:
        raise InputError(f"Expected {name} finite and symmetric, got another matrix. Check its source.")
    if np.linalg.eigvalsh(scaled).min() < -1e-6:
        raise InputError(f"Expected {name} positive semi-definite, got a negative variance. Check its source.")

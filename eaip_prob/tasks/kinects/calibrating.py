"""How well cameras are calibrated with a board in the robot's hand: images, corners, poses and lenses, from a seed.

Boards are rendered by each unit's true lens, found in noisy images, and calibrated with a lens that is wrong as one of
a data sheet is. What `calibrate` says of a Kinect is the pose of its *colour* camera, T_world_camera of `color_view`.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float
from scipy.spatial.transform import Rotation

from eaip_prob.perception.calibration import calibrate
from eaip_prob.perception.extrinsics import Extrinsics, PoseError, workspace_error
from eaip_prob.perception.lens_std import LensStd
from eaip_prob.tasks.kinects.board_session import BoardSession

_PIXEL_STD = 0.03  # px; what corners of most rendered boards scatter by
POSE_STD = (np.radians(0.3), 0.002)  # of an uncertain board along each axis: rad, m


@dataclass(frozen=True, eq=False)
class CalibrationResult:
    """What a calibration found, and how far it was from the truth.

    Args:
        found: by camera.
        errors: by camera, over the workspace.
        predicted: standard deviation of the workspace's error as the covariance says, by camera, m.
        position_errors: distance of each camera to its true position, m; `Extrinsics.position_std` predicts it.

    Example:
        >>> from eaip_prob.data.frames import Intrinsics
        >>> lens = Intrinsics(1920, 1080, 1060.0, 1060.0, 960.0, 540.0)
        >>> found = {"left": Extrinsics(np.eye(4), 1e-6 * np.eye(6), 0.1, 9, lens)}
        >>> errors = {"left": PoseError(0.001, 0.0)}
        >>> CalibrationResult(found, errors, {"left": 0.002}, {"left": 0.001}).worst.millimetres
        1.0
    """

    found: Mapping[str, Extrinsics]
    errors: Mapping[str, PoseError]
    predicted: Mapping[str, float]
    position_errors: Mapping[str, float]

    @property
    def worst(self) -> PoseError:
        """The largest error of position and of rotation of any camera."""
        return PoseError(
            max(error.position for error in self.errors.values()), max(error.rotation for error in self.errors.values())
        )

    def metrics(self) -> dict[str, float]:
        """Of the worst camera: errors, what was predicted of them, residual; and the fewest boards of a camera."""
        return {
            "mm": self.worst.millimetres,
            "deg": self.worst.degrees,
            "predicted_mm": 1e3 * max(self.predicted.values()),
            "position_mm": 1e3 * max(self.position_errors.values()),
            "predicted_position_mm": 1e3 * max(one.position_std for one in self.found.values()),
            "residual_px": max(one.residual for one in self.found.values()),
            "boards": float(min(one.num_boards for one in self.found.values())),
        }


def calibrated(
    session: BoardSession,
    points: Float[np.ndarray, "points 3"],
    uncertain: bool,
    lens_std: LensStd | None = None,
    refine: bool = True,
) -> CalibrationResult:
    """Calibrates with lenses as a data sheet gives them, and compares with the truth.

    Args:
        session: what the cameras saw.
        points: (P, 3), of the workspace, in the world, m.
        uncertain: whether the robot's poses of the boards are wrong by `POSE_STD` along each axis, or exact.
        lens_std: of the errors of the given lenses, drawn for each unit; `LensStd()` if None.
        refine: whether lenses are refined, or taken as exact.

    Raises:
        InputError: a camera that saw too few boards.
    """
    lens_std = LensStd() if lens_std is None else lens_std
    lens_generator, pose_generator = (np.random.default_rng([session.seed, number]) for number in (1, 2))
    lenses = {one.name: lens_std.drawn(one.model.color_camera, lens_generator) for one in session.cameras}
    poses = disturbed_poses(session.T_world_board, pose_generator) if uncertain else session.T_world_board
    rotation, position = POSE_STD
    covariance = np.diag([rotation**2] * 3 + [position**2] * 3) if uncertain else None
    found = calibrate(
        session.views,
        session.board,
        lenses,
        poses,
        covariance,
        pixel_std=_PIXEL_STD,
        lens_std=lens_std if refine else None,
    )
    return _compared(found, {one.name: one.color_view.T_world_camera for one in session.cameras}, points)


def disturbed_poses(
    poses: Float[np.ndarray, "boards 4 4"], generator: np.random.Generator
) -> Float[np.ndarray, "boards 4 4"]:
    """Poses with errors of `POSE_STD` along each axis of the world: rotation about the frame's origin, and position.

    Args:
        poses: (B, 4, 4), true ones.
        generator: of the errors.

    Example:
        >>> told = disturbed_poses(np.tile(np.eye(4), (500, 1, 1)), np.random.default_rng(1))
        >>> round(float(told[:, :3, 3].std()), 4)
        0.002
    """
    rotation, position = POSE_STD
    result = poses.copy()
    turns = Rotation.from_rotvec(generator.normal(0.0, rotation, (len(poses), 3)))
    result[:, :3, :3] = turns.as_matrix() @ poses[:, :3, :3]
    result[:, :3, 3] += generator.normal(0.0, position, (len(poses), 3))
    return result


def _compared(found: Mapping[str, Extrinsics], true: Mapping[str, np.ndarray], points: np.ndarray) -> CalibrationResult:
    gaps = {name: one.T_world_camera[:3, 3] - true[name][:3, 3] for name, one in found.items()}
    return CalibrationResult(
        found=found,
        errors={name: workspace_error([one.T_world_camera], [true[name]], points) for name, one in found.items()},
        predicted={name: one.workspace_std(points) for name, one in found.items()},
        position_errors={name: float(np.linalg.norm(gap)) for name, gap in gaps.items()},
    )

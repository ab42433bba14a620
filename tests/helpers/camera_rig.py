"""Three cameras around a table, boards between them, and the corners that the cameras would see."""

from __future__ import annotations

import numpy as np
from scipy.spatial.transform import Rotation

from eaip_prob.data.frames import Intrinsics, inverse
from eaip_prob.perception.board import BoardCorners, CharucoBoard
from eaip_prob.perception.board_view import BoardView

COLOR = Intrinsics(1920, 1080, 1060.7, 1058.6, 956.4, 519.0, (0.054, -0.068, 0.0, 0.0, 0.0))
BOARD = CharucoBoard()
MIDDLE = np.array([0.9, 0.0, 0.2])
ROTATION_STD, POSITION_STD = np.radians(0.3), 0.002


def looking(eye, at):
    """T_world_camera of a camera that looks from one point at another, upright."""
    z = np.subtract(at, eye) / np.linalg.norm(np.subtract(at, eye))
    x = np.cross(z, [0.0, 0.0, 1.0])
    x /= np.linalg.norm(x)
    pose = np.eye(4)
    pose[:3] = np.column_stack([x, np.cross(z, x), z, eye])
    return pose


CAMERAS = {
    "left": looking((1.2, 1.7, 0.8), MIDDLE),
    "overhead": looking((1.3, 0.05, 2.1), MIDDLE),
    "right": looking((1.2, -1.7, 0.8), MIDDLE),
}
WORKSPACE = MIDDLE + np.stack(np.meshgrid(*[np.linspace(-0.4, 0.4, 4)] * 3), -1).reshape(-1, 3)


def board_poses(count, generator):
    """(count, 4, 4) T_world_board: within 0.4 m of the middle, each held towards one camera or between two."""
    result = []
    for index in range(count):
        eye = list(CAMERAS.values())[index % 3][:3, 3] + generator.normal(0.0, 0.4, 3)
        centre = MIDDLE + generator.uniform([-0.35, -0.4, -0.3], [0.35, 0.4, 0.3])
        pose = looking(eye, centre)
        pose[:3, :3] = pose[:3, :3] @ Rotation.from_rotvec([0.0, 0.0, generator.uniform(-1.0, 1.0)]).as_matrix()
        pose[:3, 3] = centre - pose[:3, :3] @ np.array([*BOARD.size, 0.0]) / 2.0
        result.append(pose)
    return np.array(result)


def disturbed(poses, generator):
    """The poses with errors of 0.3 degrees and 2 mm along each axis of the world."""
    result = poses.copy()
    turns = Rotation.from_rotvec(generator.normal(0.0, ROTATION_STD, (len(poses), 3))).as_matrix()
    result[:, :3, :3] = turns @ poses[:, :3, :3]
    result[:, :3, 3] += generator.normal(0.0, POSITION_STD, (len(poses), 3))
    return result


def seen_corners(poses, generator, pixel_std=0.05):
    """A view for every camera and board that faces it, with noise on the corners."""
    views = []
    for name, T_world_camera in CAMERAS.items():
        for index, pose in enumerate(poses):
            T_camera_board = inverse(T_world_camera) @ pose
            pixels = COLOR.project(BOARD.corners @ T_camera_board[:3, :3].T + T_camera_board[:3, 3])
            inside = ((pixels > 5.0) & (pixels < (1915.0, 1075.0))).all(1)
            facing = T_camera_board[:3, 2] @ T_camera_board[:3, 3] > 0.55 * np.linalg.norm(T_camera_board[:3, 3])
            if facing and inside.sum() >= 8:
                noise = generator.normal(0.0, pixel_std, (int(inside.sum()), 2))
                views.append(BoardView(name, index, BoardCorners(np.nonzero(inside)[0], pixels[inside] + noise)))
    return views

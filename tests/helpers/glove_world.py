"""Green spheres before a wall, seen by depth cameras with a colour camera beside each: exact but for the noise."""

from __future__ import annotations

from collections.abc import Sequence
from functools import lru_cache

import numpy as np

from eaip_prob.data.frames import Intrinsics, RGBDFrame

GREEN, GREY = np.array([40, 180, 70]), np.array([120, 115, 110])
KINECT = Intrinsics(512, 424, 365.456, 365.456, 254.878, 205.395, (0.0905, -0.2683, 0.0, 0.0, 0.0951))
COLOR = Intrinsics(1920, 1080, 1060.7, 1058.6, 956.4, 519.0, (0.054, -0.068, 0.0, 0.0, 0.0)).scaled(480, 270)


def looking(eye: Sequence[float], target: Sequence[float]) -> np.ndarray:
    """T_world_camera of a camera that looks at a target, upright."""
    forward = np.subtract(target, eye) / np.linalg.norm(np.subtract(target, eye))
    right = np.cross(forward, (0.0, 0.0, 1.0) if abs(forward[2]) < 0.95 else (1.0, 0.0, 0.0))
    right /= np.linalg.norm(right)
    pose = np.eye(4)
    pose[:3] = np.column_stack([right, np.cross(forward, right), forward, eye])
    return pose


T_COLOR_DEPTH = np.eye(4)
T_COLOR_DEPTH[:3, 3] = (-0.0519, -0.0005, 0.0001)
TARGET = (0.9, 0.0, 0.1)
CAMERAS = {
    "left": looking((0.1, 1.4, 1.3), TARGET),
    "overhead": looking((0.0, 0.0, 1.9), TARGET),
    "right": looking((0.1, -1.4, 1.3), TARGET),
}


@lru_cache(maxsize=8)
def directions(camera: Intrinsics) -> np.ndarray:
    return np.concatenate([camera.rays, np.ones((camera.height, camera.width, 1))], -1)


def cast(camera: Intrinsics, pose: np.ndarray, spheres: Sequence[tuple], floor: float = -0.93) -> tuple:
    """(depth along z, colour) of spheres (centre, radius, colour) over the floor and before a wall at x = 2.5."""
    rays = directions(camera) @ pose[:3, :3].T
    with np.errstate(divide="ignore"):
        to_floor, to_wall = (floor - pose[2, 3]) / rays[..., 2], (2.5 - pose[0, 3]) / rays[..., 0]
    depth = np.minimum(np.where(to_floor > 0, to_floor, np.inf), np.where(to_wall > 0, to_wall, np.inf))
    color = np.broadcast_to(GREY, (*depth.shape, 3)).copy()
    square = (rays**2).sum(-1)
    for center, radius, paint in spheres:
        towards = np.asarray(center) - pose[:3, 3]
        middle = rays @ towards
        root = middle**2 - square * (towards @ towards - radius**2)
        hit = (middle - np.sqrt(np.maximum(root, 0.0))) / square
        front = (root > 0) & (hit > 0) & (hit < depth)
        depth = np.where(front, hit, depth)
        color[front] = paint
    return depth, color.astype(np.uint8)


def frame(
    name: str,
    spheres: Sequence[tuple],
    time: float,
    generator: np.random.Generator | None = None,
    sigma: float = 0.0015,
    scale: float = 1.0,
) -> RGBDFrame:
    """One camera's frame at a time; no noise without a generator; both images at `scale` of their size."""
    depth_camera = KINECT if scale == 1.0 else KINECT.scaled(int(512 * scale), int(424 * scale))
    color_camera = COLOR if scale == 1.0 else COLOR.scaled(int(480 * scale), int(270 * scale))
    pose = CAMERAS[name]
    depth, _ = cast(depth_camera, pose, spheres)
    _, color = cast(color_camera, pose @ np.linalg.inv(T_COLOR_DEPTH), spheres)
    valid = (depth > 0.5) & (depth < 4.5)
    if generator is not None:
        depth = depth + sigma * generator.standard_normal(depth.shape)
    depth = np.where(valid, depth, 0.0).astype(np.float32)
    return RGBDFrame(color, depth, valid, depth_camera, pose, time, color_camera, T_COLOR_DEPTH, name)


def gloves(left: Sequence[float], right: Sequence[float], radius: float = 0.05, more: Sequence[tuple] = ()) -> list:
    """Two green spheres, the person's left hand first, and whatever else."""
    return [(left, radius, GREEN), (right, radius, GREEN), *more]

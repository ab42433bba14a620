"""What cameras saw, in rerun's components.

Under the entity of a camera stand two pinhole cameras, each with its place in the world and its image below it:
`depth_camera` with `depth`, which the viewer projects back into space, and `color_camera` with `color`.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from functools import lru_cache
from typing import Any

import cv2
import numpy as np
import rerun as rr
from jaxtyping import Float, Float32, UInt8
from scipy.spatial.transform import Rotation

from eaip_prob.data.frames import Intrinsics, RGBDFrame, inverse
from eaip_prob.recording.sensor_records import Cloud, Ellipsoids, Markers

DEPTH_CAMERA, DEPTH_IMAGE = "depth_camera", "depth_camera/depth"
COLOR_CAMERA, COLOR_IMAGE = "color_camera", "color_camera/color"

_PER_METER = 1000.0
_JPEG_QUALITY = 85
_DEPTH_RANGE = (0.5, 4.5)  # m; what a Kinect v2 is made for
_IMAGE_DISTANCE = 0.25  # m; where the viewer draws a camera's image before it


def camera_places(frame: RGBDFrame) -> dict[str, tuple[Float[np.ndarray, "4 4"], Intrinsics]]:
    """(pose in the world, lens) of the depth and the colour camera; one pose where colour is registered to depth."""
    depth = frame.T_world_camera, frame.intrinsics
    if frame.color_intrinsics is None or frame.T_color_depth is None:
        return {DEPTH_CAMERA: depth, COLOR_CAMERA: (frame.T_world_camera, squared(frame.intrinsics))}
    color = frame.T_world_camera @ inverse(frame.T_color_depth), squared(frame.color_intrinsics)
    return {DEPTH_CAMERA: depth, COLOR_CAMERA: color}


def squared(camera: Intrinsics) -> Intrinsics:
    """The lens of a straightened colour image: without distortion, and with one focal length for both directions.

    The viewer (rerun 0.41) shows nothing that is drawn in two dimensions over a camera with two focal lengths.
    """
    return replace(camera, fy=camera.fx, distortion=(0.0, 0.0, 0.0, 0.0, 0.0))


def pinhole_columns(pose: Float[np.ndarray, "4 4"], camera: Intrinsics) -> list[Any]:
    """Where a camera stands, and its lens without distortion."""
    turn = Rotation.from_matrix(pose[:3, :3]).as_quat(canonical=True)
    return [
        *rr.Transform3D.columns(translation=[pose[:3, 3]], quaternion=[rr.Quaternion(xyzw=turn)]),
        *rr.Pinhole.columns(
            image_from_camera=[camera.matrix],
            resolution=[[camera.width, camera.height]],
            image_plane_distance=[_IMAGE_DISTANCE],
        ),
    ]


def image_columns(frame: RGBDFrame) -> Mapping[str, Any]:
    """Both images, straightened and compressed, by their entity below the camera's."""
    millimetres = np.where(frame.valid, np.rint(_PER_METER * frame.depth), 0.0).astype(np.uint16)
    depth = straightened(millimetres, frame.intrinsics, cv2.INTER_NEAREST)
    lens = frame.color_intrinsics or frame.intrinsics
    color = straightened(frame.color, lens, cv2.INTER_LINEAR, squared(lens))
    jpeg = cv2.imencode(".jpg", cv2.cvtColor(color, cv2.COLOR_RGB2BGR), [cv2.IMWRITE_JPEG_QUALITY, _JPEG_QUALITY])[1]
    return {
        DEPTH_IMAGE: rr.EncodedDepthImage.columns(
            blob=[cv2.imencode(".png", depth)[1].tobytes()],
            media_type=["image/png"],
            meter=[_PER_METER],
            depth_range=[[_PER_METER * end for end in _DEPTH_RANGE]],
        ),
        COLOR_IMAGE: rr.EncodedImage.columns(blob=[jpeg.tobytes()], media_type=[rr.MediaType("image/jpeg")]),
    }


def straightened(
    image: np.ndarray, camera: Intrinsics, interpolation: int, straight: Intrinsics | None = None
) -> np.ndarray:
    """The image that a camera without distortion would take; 0 where nothing was seen.

    Args:
        image: (H, W) or (H, W, 3), of this camera.
        camera: how it was taken.
        interpolation: one of OpenCV's; nearest for depth, which must not be averaged across edges.
        straight: the camera without distortion; None for one with the same focal lengths and principal point.
    """
    straight = straight or replace(camera, distortion=(0.0,) * 5)
    if straight == replace(camera, distortion=straight.distortion) and not any(camera.distortion):
        return image
    return cv2.remap(image, *_sources(camera, straight), interpolation, borderMode=cv2.BORDER_CONSTANT, borderValue=0)


@lru_cache(maxsize=16)
def _sources(
    camera: Intrinsics, straight: Intrinsics
) -> tuple[Float32[np.ndarray, "height width"], Float32[np.ndarray, "height width"]]:
    """Column and row in the image taken, for every pixel of the straight one."""
    column, row = np.meshgrid(np.arange(0.0, camera.width), np.arange(0.0, camera.height))
    x, y = (column - straight.cx) / straight.fx, (row - straight.cy) / straight.fy
    source = np.nan_to_num(camera.project(np.stack([x, y, np.ones_like(x)], -1)), nan=-10.0).astype(
        np.float32
    )  # NaN: no ray of the lens, as outside
    return np.ascontiguousarray(source[..., 0]), np.ascontiguousarray(source[..., 1])


def cloud_columns(record: Cloud) -> list[Any]:
    """Points with packed colours."""
    points = rr.Points3D.columns(positions=record.points.astype(np.float32), colors=packed(record.colors))
    count = len(record.points)
    return [*points.partition([count]), *rr.Points3D.columns(radii=[record.radius])]


def packed(colors: UInt8[np.ndarray, "points 3"]) -> np.ndarray:
    """(N,), each colour as one uint32 (red, green, blue, 255), which rerun takes without a loop over points."""
    return (colors.astype(np.uint32) << np.array([24, 16, 8], np.uint32)).sum(-1, dtype=np.uint32) | np.uint32(255)


def marker_columns(record: Markers) -> list[Any]:
    """Points as large on the screen at any distance: negative radii."""
    count = len(record.positions)
    columns = [*rr.Points3D.columns(positions=record.positions).partition([count])]
    columns += rr.Points3D.columns(colors=[record.color], radii=[-record.radius])
    if record.labels:
        columns += rr.Points3D.columns(labels=record.labels).partition([count])
    return columns


def ellipsoid_columns(record: Ellipsoids) -> list[Any]:
    """Ellipsoids as nets of lines, through which what lies inside is seen."""
    count = len(record.centers)
    turns = [rr.Quaternion(xyzw=turn) for turn in Rotation.from_matrix(record.rotations).as_quat(canonical=True)]
    shape = rr.Ellipsoids3D.columns(half_sizes=record.half_sizes, centers=record.centers, quaternions=turns)
    columns = [*shape.partition([count])]
    columns += rr.Ellipsoids3D.columns(colors=[record.color], fill_mode=[rr.components.FillMode.DenseWireframe])
    if record.labels:
        columns += rr.Ellipsoids3D.columns(labels=record.labels).partition([count])
    return columns

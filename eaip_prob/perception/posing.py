"""Frames with their cameras where a calibration found them, instead of where they were thought to be."""

from __future__ import annotations

from dataclasses import replace

from eaip_prob.data.frames import RGBDFrame
from eaip_prob.errors import InputError
from eaip_prob.perception.extrinsics import Extrinsics


def posed(frame: RGBDFrame, found: Extrinsics) -> RGBDFrame:
    """The frame with its colour camera, and with it the depth camera, where a calibration found it.

    `calibrate` finds the camera that took the images of the board, which is the colour camera. The depth camera follows
    by T_world_depth = T_world_color @ T_color_depth, and the refined lens replaces that of the colour camera.

    Args:
        frame: with a colour camera of its own, at any resolution of the one that was calibrated.
        found: what `calibrate` says of the colour camera.

    Raises:
        InputError: a frame whose colour is registered to depth already.

    Example:
        >>> import numpy as np
        >>> from eaip_prob.data import Intrinsics
        >>> camera, beside = Intrinsics(4, 3, 4.0, 4.0, 1.5, 1.0), np.eye(4)
        >>> beside[0, 3] = -0.05
        >>> depth = np.ones((3, 4), dtype=np.float32)
        >>> color = np.zeros((3, 4, 3), dtype=np.uint8)
        >>> frame = RGBDFrame(color, depth, depth > 0, camera, np.eye(4), 0.0, camera, beside)
        >>> found = Extrinsics(np.eye(4), np.eye(6), residual=0.1, num_boards=9, intrinsics=camera)
        >>> posed(frame, found).T_world_camera[:3, 3].tolist()
        [-0.05, 0.0, 0.0]
    """
    if frame.color_intrinsics is None or frame.T_color_depth is None:
        raise InputError(
            f"Expected a frame of {frame.name!r} with color_intrinsics and T_color_depth, got one whose colour is "
            "registered to depth. Give the colour image as the camera took it."
        )
    height, width = frame.color.shape[:2]
    return replace(
        frame,
        T_world_camera=found.T_world_camera @ frame.T_color_depth,
        color_intrinsics=found.intrinsics.scaled(width, height),
    )

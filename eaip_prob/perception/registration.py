"""The colour of depth pixels: the colour camera looks from a few centimetres beside, and does not see all of them.

Every depth pixel's point is projected into the colour image. Where another point, nearer to the colour camera, falls on
the same place, the farther one is hidden, and its pixel gets no colour rather than that of what hides it.

How much nearer: with a baseline b between the cameras and a focal length f (px), two surfaces at depth z part by one
depth pixel when their depths differ by z^2 / (b f). Less cannot hide a pixel, so this is the tolerance of the test.
Importing this module imports numba; kernels compile at their first call and are cached on disk.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from jaxtyping import Bool, Int, UInt8

from eaip_prob.data.frames import Intrinsics, RGBDFrame
from eaip_prob.errors import InputError, ShapeError
from eaip_prob.perception._registering import project_window, take_colors

_LEAST_STEP = 0.01  # metres; several standard deviations of a Kinect's depth noise


def registered(frame: RGBDFrame) -> RGBDFrame:
    """The frame with a colour for every depth pixel: black where the colour camera does not see its point.

    Args:
        frame: of one camera; returned as it is if its colour is registered already.

    Example:
        >>> camera = Intrinsics(4, 3, 4.0, 4.0, 1.5, 1.0)
        >>> color = np.full((3, 4, 3), 90, dtype=np.uint8)
        >>> depth, beside = np.ones((3, 4), dtype=np.float32), np.eye(4)
        >>> beside[0, 3] = -0.25  # one pixel at 1 m
        >>> frame = RGBDFrame(color, depth, depth > 0, camera, np.eye(4), 0.0, camera, beside)
        >>> registered(frame).color[0, :, 0].tolist()
        [0, 90, 90, 90]
    """
    if frame.color_intrinsics is None:
        return frame
    color, _ = depth_colors(frame)
    return replace(frame, color=color, color_intrinsics=None, T_color_depth=None)


def depth_colors(frame: RGBDFrame) -> tuple[UInt8[np.ndarray, "height width 3"], Bool[np.ndarray, "height width"]]:
    """(colour of every depth pixel, whether the colour camera sees its point); black where it does not.

    Args:
        frame: of one camera. Where its colour is registered already, black counts as not seen.

    Example:
        >>> camera = Intrinsics(4, 3, 4.0, 4.0, 1.5, 1.0)
        >>> depth = np.ones((3, 4), dtype=np.float32)
        >>> frame = RGBDFrame(np.full((3, 4, 3), 9, np.uint8), depth, depth > 0, camera, np.eye(4), 0.0)
        >>> depth_colors(frame)[1].all().item()
        True
    """
    height, width = frame.depth.shape
    color, seen = colors_of(frame, np.arange(height * width))
    return color.reshape(height, width, 3), seen.reshape(height, width)


def color_at(
    frame: RGBDFrame, pixels: Int[np.ndarray, "pixels 2"]
) -> tuple[UInt8[np.ndarray, "pixels 3"], Bool[np.ndarray, "pixels"]]:
    """(colours, whether seen) of some depth pixels, as `depth_colors` gives them, at the cost of their surroundings.

    Args:
        frame: of one camera.
        pixels: (P, 2), column and row in the depth image, integers.

    Raises:
        ShapeError: no rows of two.
        InputError: no integers, or pixels outside the depth image.

    Example:
        >>> camera = Intrinsics(4, 3, 4.0, 4.0, 1.5, 1.0)
        >>> depth = np.ones((3, 4), dtype=np.float32)
        >>> frame = RGBDFrame(np.full((3, 4, 3), 9, np.uint8), depth, depth > 0, camera, np.eye(4), 0.0)
        >>> color_at(frame, np.array([[3, 2]]))[0].tolist()
        [[9, 9, 9]]
    """
    pixels = _checked(pixels, frame.intrinsics)
    if not len(pixels):
        return np.zeros((0, 3), np.uint8), np.zeros(0, bool)
    flat = pixels[:, 1] * frame.intrinsics.width + pixels[:, 0]
    return colors_of(frame, flat, _surroundings(frame, pixels))


def colors_of(
    frame: RGBDFrame, places: Int[np.ndarray, "pixels"], window: tuple[int, int, int, int] | None = None
) -> tuple[UInt8[np.ndarray, "pixels 3"], Bool[np.ndarray, "pixels"]]:
    """`color_at` of pixels that are known to be in the image, for callers that make them themselves.

    Args:
        frame: of one camera.
        places: (P,), int64, row times width plus column of each depth pixel.
        window: first and one past the last row and column of the pixels that may hide one of these; default all.

    Example:
        >>> camera = Intrinsics(4, 3, 4.0, 4.0, 1.5, 1.0)
        >>> depth = np.ones((3, 4), dtype=np.float32)
        >>> frame = RGBDFrame(np.full((3, 4, 3), 9, np.uint8), depth, depth > 0, camera, np.eye(4), 0.0)
        >>> colors_of(frame, np.array([11]))[0].tolist()
        [[9, 9, 9]]
    """
    camera, colors, seen = frame.color_intrinsics, np.zeros((len(places), 3), np.uint8), np.zeros(len(places), bool)
    if camera is None or frame.T_color_depth is None:
        colors = frame.color.reshape(-1, 3)[places]
        return colors, np.any(colors, axis=-1, keepdims=True)[:, 0]
    cell = max(1, round(camera.fx / frame.intrinsics.fx))  # as far apart as neighbouring depth pixels
    nearest = np.full((-(-camera.height // cell), -(-camera.width // cell)), np.inf, np.float32)
    height, width = frame.depth.shape
    area = (0, height, 0, width) if window is None else window
    seen_at = np.empty((*frame.depth.shape, 3))
    lens = np.array([camera.fx, camera.fy, camera.cx, camera.cy, *camera.distortion, camera.max_radius])
    motion = np.ascontiguousarray(frame.T_color_depth[:3], dtype=float)
    depth, valid = np.ascontiguousarray(frame.depth), np.ascontiguousarray(frame.valid)
    project_window(depth, valid, frame.intrinsics.rays, motion, lens, area, seen_at, nearest, cell)
    baseline = float(np.linalg.norm(motion[:, 3]))
    slack = np.inf if baseline == 0.0 else 1.0 / (baseline * frame.intrinsics.fx)
    color = np.ascontiguousarray(frame.color)
    take_colors(places, seen_at, nearest, cell, color, slack, _LEAST_STEP, colors, seen)
    return colors, seen


def _surroundings(frame: RGBDFrame, pixels: np.ndarray) -> tuple[int, int, int, int]:
    """Rows and columns of all depth pixels that may hide one of these: as far as the nearest point can shift."""
    height, width = frame.depth.shape
    reach = max(height, width)
    if frame.T_color_depth is not None and frame.valid.any():
        least = float(frame.depth.min(where=frame.valid, initial=np.inf))
        # twice, for what a slanted view and the distortion add
        shift = 2.0 * frame.intrinsics.fx * float(np.linalg.norm(frame.T_color_depth[:3, 3])) / least
        reach = min(reach, int(shift) + 4)
    (left, top), (right, bottom) = pixels.min(0) - reach, pixels.max(0) + reach + 1
    return max(int(top), 0), min(int(bottom), height), max(int(left), 0), min(int(right), width)


def _checked(pixels: np.ndarray, camera: Intrinsics) -> np.ndarray:
    if np.ndim(pixels) != 2 or np.shape(pixels)[1] != 2:
        raise ShapeError(f"Expected pixels with shape (P, 2), got {np.shape(pixels)}. Give (column, row) of each.")
    if not np.issubdtype(pixels.dtype, np.integer):
        raise InputError(f"Expected pixels as integers, got {pixels.dtype}. Round them first.")
    if ((pixels < 0) | (pixels >= (camera.width, camera.height))).any():
        raise InputError(
            f"Expected pixels (column, row) inside {camera.width} x {camera.height} px, got columns "
            f"{pixels[:, 0].min()} to {pixels[:, 0].max()} and rows {pixels[:, 1].min()} to {pixels[:, 1].max()}."
        )
    return np.ascontiguousarray(pixels, dtype=np.int64)

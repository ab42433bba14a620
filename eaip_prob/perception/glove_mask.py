"""Which depth pixels show a glove: colour first, so that few pixels become points.

The colour camera stands beside the depth camera and sees a little less, or a little more, of what is behind a glove.
A depth pixel belongs to a glove when its point falls on the mask in the colour image *and* no nearer point falls
there: the colour of a glove is not painted onto the background behind its edge.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np
from jaxtyping import Bool, Float, Int, UInt8

from eaip_prob.data.frames import RGBDFrame, pixel_rays
from eaip_prob.errors import InputError
from eaip_prob.perception.glove_offset import depth_sigma

MASK_WIDTH = 480  # px; a wider colour image is read at every second, third, ... pixel
_NEAR, _FAR = 0.5, 4.5  # metres; range of a Kinect v2
_MARGIN = 2  # px around what the box of a mask covers in the depth image
_BEHIND = 0.03  # metres; a point this much behind another one in its colour pixel was not seen there


@dataclass(frozen=True)
class GloveColor:
    """The green of the gloves, in OpenCV's units: hue 0 to 179, saturation and value 0 to 255.

    Args:
        hue: lowest and highest.
        saturation: above this.
        value: above this.

    Raises:
        InputError: a hue that is no range within 0 to 179.

    Example:
        >>> glove_mask(np.full((9, 9, 3), (30, 180, 60), dtype=np.uint8), GloveColor()).sum()
        np.int64(49)
    """

    hue: tuple[int, int] = (45, 80)
    saturation: int = 110
    value: int = 30

    def __post_init__(self) -> None:
        if len(self.hue) != 2 or not 0 <= self.hue[0] <= self.hue[1] <= 179:
            raise InputError(f"Expected hue as (lowest, highest) within 0 to 179, got {self.hue}.")


@dataclass(frozen=True, eq=False)
class GlovePoints:
    """Points on gloves, of any number of cameras.

    Args:
        points: (N, 3), in the world, m.
        views: (N, 3), unit vectors from the camera to the points, in the world.
        sigma: (N,), standard deviation of the depth, m.
        camera: (N,), index of the frame.
        area: (N,), what a pixel covers at its distance, m^2.

    Example:
        >>> none = GlovePoints.joined([])
        >>> none.points.shape
        (0, 3)
    """

    points: Float[np.ndarray, "points 3"]
    views: Float[np.ndarray, "points 3"]
    sigma: Float[np.ndarray, "points"]
    camera: Int[np.ndarray, "points"]
    area: Float[np.ndarray, "points"]

    def select(self, index: np.ndarray) -> GlovePoints:
        """Some of the points.

        Args:
            index: places, or a mask (N,).
        """
        return GlovePoints(
            self.points[index], self.views[index], self.sigma[index], self.camera[index], self.area[index]
        )

    @classmethod
    def joined(cls, parts: Sequence[GlovePoints]) -> GlovePoints:
        """The points of several cameras, numbered in their order.

        Args:
            parts: of one camera each.
        """
        sizes = [len(part.points) for part in parts]
        empty = np.zeros((0, 3))
        return cls(
            np.concatenate([empty, *(part.points for part in parts)]),
            np.concatenate([empty, *(part.views for part in parts)]),
            np.concatenate([empty[:, 0], *(part.sigma for part in parts)]),
            np.repeat(np.arange(len(parts)), sizes),
            np.concatenate([empty[:, 0], *(part.area for part in parts)]),
        )


def glove_mask(color: UInt8[np.ndarray, "height width 3"], window: GloveColor) -> Bool[np.ndarray, "height width"]:
    """Where an image has the colour of a glove, less a rim of one pixel.

    Args:
        color: (H, W, 3), RGB.
        window: the colour.

    Example:
        >>> glove_mask(np.zeros((4, 4, 3), dtype=np.uint8), GloveColor()).any()
        np.False_
    """
    hsv = cv2.cvtColor(color, cv2.COLOR_RGB2HSV)
    low = (window.hue[0], window.saturation + 1, window.value + 1)
    mask = cv2.inRange(hsv, low, (window.hue[1], 255, 255))
    return cv2.erode(mask, np.ones((3, 3), np.uint8), borderType=cv2.BORDER_CONSTANT, borderValue=(0.0,)) > 0


def glove_points(frame: RGBDFrame, window: GloveColor | None = None, largest: float = 0.3) -> GlovePoints:
    """Points of one camera that have the colour of a glove.

    Args:
        frame: with its colour registered to the depth image or not.
        window: the colour of the gloves; default green.
        largest: m; what is wider or higher than this at 0.5 m from the camera is no glove.

    Example:
        >>> from eaip_prob.data import Intrinsics
        >>> camera = Intrinsics(9, 9, 9.0, 9.0, 4.0, 4.0)
        >>> green = np.full((9, 9, 3), (30, 180, 60), dtype=np.uint8)
        >>> depth = np.full((9, 9), 2.0, dtype=np.float32)
        >>> frame = RGBDFrame(green, depth, depth > 0, camera, T_world_camera=np.eye(4), time=0.0)
        >>> glove_points(frame).points.shape
        (49, 3)
    """
    stride = max(1, frame.color.shape[1] // MASK_WIDTH)
    mask = glove_mask(np.ascontiguousarray(frame.color[::stride, ::stride]), window or GloveColor())
    camera = frame.color_intrinsics or frame.intrinsics
    boxes = _boxes(mask, largest / _NEAR * camera.fx / stride)
    if frame.color_intrinsics is None or frame.T_color_depth is None:
        rows, columns = np.nonzero(mask & frame.valid) if stride == 1 else _registered(frame, mask, stride)
        return _points(frame, rows, columns)
    found = [_in_box(frame, mask, box, stride) for box in boxes]
    if not found:
        return GlovePoints.joined([])
    places = np.unique(np.concatenate(found))
    return _points(frame, *np.divmod(places, frame.intrinsics.width))


def _registered(frame: RGBDFrame, mask: np.ndarray, stride: int) -> tuple[np.ndarray, np.ndarray]:
    whole = np.repeat(np.repeat(mask, stride, 0), stride, 1)[: frame.intrinsics.height, : frame.intrinsics.width]
    rows, columns = np.nonzero(whole & frame.valid)
    return rows, columns


def _boxes(mask: np.ndarray, largest: float) -> list[np.ndarray]:
    if not mask.any():
        return []
    count, _, stats, _ = cv2.connectedComponentsWithStats(mask.view(np.uint8), connectivity=8)
    return [stats[i, :4] for i in range(1, count) if stats[i, 2:4].max() <= largest]


def _in_box(frame: RGBDFrame, mask: np.ndarray, box: np.ndarray, stride: int) -> np.ndarray:
    """Flat places in the depth image that show what the mask has in a box."""
    assert frame.color_intrinsics is not None and frame.T_color_depth is not None
    rows, columns = _depth_window(frame, box, stride)
    depth, valid = frame.depth[rows, columns], frame.valid[rows, columns]
    if not valid.any():
        return np.zeros(0, dtype=int)
    z = depth[valid].astype(float)
    local = np.column_stack([frame.intrinsics.rays[rows, columns][valid] * z[:, None], z])
    seen = local @ frame.T_color_depth[:3, :3].T + frame.T_color_depth[:3, 3]
    pixel = frame.color_intrinsics.project(seen) / stride - (box[:2] - 1.0)
    near = np.all((pixel > -0.5) & (pixel < box[2:] + 1.5), axis=1)
    inside = np.pad(mask, 1)[box[1] : box[1] + box[3] + 2, box[0] : box[0] + box[2] + 2]
    shown = _shown(np.rint(pixel[near]).astype(int), seen[near, 2].astype(np.float32), inside)
    at_row, at_column = np.nonzero(valid)
    return (at_row[near][shown] + rows.start) * frame.intrinsics.width + at_column[near][shown] + columns.start


def _shown(pixel: np.ndarray, distance: np.ndarray, inside: np.ndarray) -> np.ndarray:
    """Points that fall inside, and lie behind no other one in or beside their colour pixel."""
    column, row = pixel.T
    nearest = np.full(inside.shape, np.inf, dtype=np.float32)
    np.minimum.at(nearest, (row, column), distance)
    nearest = cv2.erode(nearest, np.ones((3, 3), np.uint8))
    return inside[row, column] & (distance <= nearest[row, column] + _BEHIND)


def _depth_window(frame: RGBDFrame, box: np.ndarray, stride: int) -> tuple[slice, slice]:
    """Rows and columns of the depth image that may show a box of the mask, whatever its distance."""
    assert frame.color_intrinsics is not None and frame.T_color_depth is not None
    left, top, width, height = box
    corners = pixel_rays(frame.color_intrinsics, stride)[[top, top, top + height - 1, top + height - 1]][
        [0, 1, 2, 3], [left, left + width - 1, left, left + width - 1]
    ]
    corners = np.column_stack([corners, np.ones(4)])
    seen = np.concatenate([corners * _NEAR, corners * _FAR])
    turn, shift = frame.T_color_depth[:3, :3], frame.T_color_depth[:3, 3]
    pixels = frame.intrinsics.project((seen - shift) @ turn)
    low, high = np.floor(pixels.min(0)) - _MARGIN, np.ceil(pixels.max(0)) + _MARGIN + 1
    size = (frame.intrinsics.width, frame.intrinsics.height)
    (first, over), (last, under) = np.clip(low, 0, size).astype(int), np.clip(high, 0, size).astype(int)
    return slice(over, under), slice(first, last)


def _points(frame: RGBDFrame, rows: np.ndarray, columns: np.ndarray) -> GlovePoints:
    z = frame.depth[rows, columns].astype(float)
    rays = np.column_stack([frame.intrinsics.rays[rows, columns], np.ones(len(z))])
    turn = frame.T_world_camera[:3, :3]
    views = rays @ turn.T
    points = views * z[:, None] + frame.T_world_camera[:3, 3]
    views /= np.sqrt(np.einsum("ij,ij->i", rays, rays))[:, None]
    area = z * z / (frame.intrinsics.fx * frame.intrinsics.fy)
    return GlovePoints(points, views, depth_sigma(z), np.zeros(len(z), dtype=int), area)

"""Images of a depth camera with a colour camera beside it, and the pinhole model that both follow.

Camera coordinates are x to the right, y down, z forward (metres). Pixel (0, 0) is the centre of the upper left pixel.
Letters: H, W rows and columns of an image.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property, lru_cache
from typing import Self

import numpy as np
from jaxtyping import Bool, Float, Float32, UInt8

from eaip_prob.data.lens import distorted, fold_radius, undistorted
from eaip_prob.errors import InputError, ShapeError, UnitsError

MAX_DEPTH = 20.0  # metres; no depth camera of this kind sees farther, and millimetres always exceed it


@dataclass(frozen=True)
class Intrinsics:
    """A pinhole camera with radial and tangential distortion (Brown; OpenCV's order and sign of coefficients).

    Args:
        width: W, columns.
        height: H, rows.
        fx: focal length along rows, px.
        fy: focal length along columns, px.
        cx: column of the principal point, px.
        cy: row of the principal point, px.
        distortion: (k1, k2, p1, p2, k3), without unit.

    Raises:
        InputError: sizes or focal lengths not above zero, a principal point outside the image, or other coefficients.

    Example:
        >>> camera = Intrinsics(512, 424, 365.456, 365.456, 254.878, 205.395, (0.0905, -0.2683, 0.0, 0.0, 0.0951))
        >>> pixel = camera.project(np.array([0.2, -0.1, 1.5]))
        >>> camera.unproject(pixel, np.array(1.5)).round(9).tolist()
        [0.2, -0.1, 1.5]
    """

    width: int
    height: int
    fx: float
    fy: float
    cx: float
    cy: float
    distortion: tuple[float, float, float, float, float] = (0.0, 0.0, 0.0, 0.0, 0.0)

    def __post_init__(self) -> None:
        whole = isinstance(self.width, int | np.integer) and isinstance(self.height, int | np.integer)
        if not (whole and self.width >= 1 and self.height >= 1 and 0 < self.fx < np.inf and 0 < self.fy < np.inf):
            raise InputError(
                f"Expected an image of whole pixels and focal lengths above zero, got {self.width} x {self.height} px "
                f"with fx {self.fx}, fy {self.fy}."
            )
        if not (0 <= self.cx <= self.width and 0 <= self.cy <= self.height):
            raise InputError(
                f"Expected the principal point inside {self.width} x {self.height} px, got ({self.cx}, {self.cy}). "
                "Give the intrinsics of images of this size, or use scaled(width, height)."
            )
        object.__setattr__(self, "distortion", tuple(float(value) for value in self.distortion))
        if len(self.distortion) != 5 or not np.isfinite(self.distortion).all():
            raise InputError(f"Expected the distortion as (k1, k2, p1, p2, k3), got {self.distortion}.")

    @property
    def matrix(self) -> Float[np.ndarray, "3 3"]:
        """Camera matrix, px."""
        return np.array([[self.fx, 0.0, self.cx], [0.0, self.fy, self.cy], [0.0, 0.0, 1.0]])

    def scaled(self, width: int, height: int) -> Self:
        """The same camera read out at another resolution; pixel centres keep their place."""
        along, down = width / self.width, height / self.height
        cx, cy = (self.cx + 0.5) * along - 0.5, (self.cy + 0.5) * down - 0.5
        return replace(self, width=width, height=height, fx=self.fx * along, fy=self.fy * down, cx=cx, cy=cy)

    def project(self, points: Float[np.ndarray, "*batch 3"]) -> Float[np.ndarray, "*batch 2"]:
        """Pixels (column, row) of points in camera coordinates, m; also beyond the image's edges.

        NaN behind the camera, and so far from its axis that the distortion would fold the point back into the image.
        """
        depth = np.where(points[..., 2] > 0, points[..., 2], np.nan)
        x, y = points[..., 0] / depth, points[..., 1] / depth
        unseen = np.hypot(x, y) > self.max_radius
        x, y = distorted(np.where(unseen, np.nan, x), y, self.distortion)
        return np.stack([self.fx * x + self.cx, self.fy * y + self.cy], -1)

    def unproject(
        self, pixels: Float[np.ndarray, "*batch 2"], depth: Float[np.ndarray, "*batch"]
    ) -> Float[np.ndarray, "*batch 3"]:
        """Points in camera coordinates, m, of pixels (column, row) with a depth along z, m; NaN where no ray ends."""
        x = (pixels[..., 0] - self.cx) / self.fx
        y = (pixels[..., 1] - self.cy) / self.fy
        x, y = undistorted(x, y, self.distortion)
        return np.stack([x * depth, y * depth, np.broadcast_to(depth, x.shape)], -1)

    @cached_property
    def max_radius(self) -> float:
        """Largest distance from the axis, hypot(x, y) / z, that the lens images; infinite for most."""
        return fold_radius(self.distortion)

    @property
    def rays(self) -> Float[np.ndarray, "height width 2"]:
        """(x / z, y / z) seen by every pixel, without unit, read-only; NaN where the distortion has no inverse."""
        return pixel_rays(self)


@lru_cache(maxsize=16)
def pixel_rays(camera: Intrinsics, stride: int = 1) -> Float[np.ndarray, "height width 2"]:
    """`Intrinsics.rays` of every `stride`-th row and column.

    Kept by value, not by object: a driver may make its intrinsics anew for every frame.

    Args:
        camera: whose pixels.
        stride: px.

    Example:
        >>> pixel_rays(Intrinsics(4, 3, 4.0, 4.0, 1.5, 1.0), stride=2)[0].tolist()
        [[-0.375, -0.25], [0.125, -0.25]]
    """
    grid = np.meshgrid(np.arange(0.0, camera.width, stride), np.arange(0.0, camera.height, stride))
    pixels = np.stack(grid, -1)
    rays = np.ascontiguousarray(camera.unproject(pixels, np.ones(pixels.shape[:2]))[..., :2])
    rays.setflags(write=False)
    return rays


@dataclass(frozen=True, eq=False)
class RGBDFrame:
    """What one camera saw at one time: a depth image, and the image of the colour camera beside it.

    Args:
        color: (H_c, W_c, 3), RGB.
        depth: (H, W), distance along z, m; anything where `valid` is False.
        valid: (H, W), where depth was measured.
        intrinsics: of the depth camera.
        color_intrinsics: of the colour camera; None where `color` is registered to the depth image, pixel by pixel.
        T_color_depth: (4, 4), maps coordinates of the depth camera into those of the colour camera.
        T_world_camera: (4, 4), maps coordinates of the depth camera into the world.
        time: s.
        name: of the camera.

    Raises:
        ShapeError: images of other shapes than the intrinsics say.
        InputError: other types, depth that is not finite where valid, a transform that is no rigid motion.
        UnitsError: depth beyond 20 m, as in millimetres.

    Example:
        >>> camera = Intrinsics(4, 3, 4.0, 4.0, 1.5, 1.0)
        >>> depth = np.full((3, 4), 2.0, dtype=np.float32)
        >>> color = np.zeros((3, 4, 3), dtype=np.uint8)
        >>> frame = RGBDFrame(color, depth, depth > 0, camera, T_world_camera=np.eye(4), time=0.1)
        >>> frame.points().shape
        (12, 3)
    """

    color: UInt8[np.ndarray, "color_height color_width 3"]
    depth: Float32[np.ndarray, "height width"]
    valid: Bool[np.ndarray, "height width"]
    intrinsics: Intrinsics
    T_world_camera: Float[np.ndarray, "4 4"]
    time: float
    color_intrinsics: Intrinsics | None = None
    T_color_depth: Float[np.ndarray, "4 4"] | None = None
    name: str = "camera"

    def __post_init__(self) -> None:
        _check_image("depth", self.depth, (self.intrinsics.height, self.intrinsics.width), np.float32)
        _check_image("valid", self.valid, self.depth.shape, np.bool_)
        camera = self.color_intrinsics or self.intrinsics
        _check_image("color", self.color, (camera.height, camera.width, 3), np.uint8)
        if (self.color_intrinsics is None) != (self.T_color_depth is None):
            raise InputError(
                "Expected color_intrinsics and T_color_depth together, or neither for colour that is registered to the "
                "depth image, got one of them."
            )
        check_transform("T_world_camera", self.T_world_camera)
        if self.T_color_depth is not None:
            check_transform("T_color_depth", self.T_color_depth)
        _check_depth(self.depth[self.valid])
        if np.isfinite(self.intrinsics.max_radius) and np.isnan(self.intrinsics.rays[..., 0][self.valid]).any():
            raise InputError(
                "Expected a distortion with an inverse at every valid pixel, got one that folds back inside the image. "
                "Calibrate it again, or mark these pixels (rays are NaN) valid=False."
            )

    def points(self) -> Float[np.ndarray, "points 3"]:
        """Valid pixels as points in world coordinates, m, row by row."""
        depth = self.depth[self.valid].astype(float)
        local = np.column_stack([self.intrinsics.rays[self.valid] * depth[:, None], depth])
        return local @ self.T_world_camera[:3, :3].T + self.T_world_camera[:3, 3]


def inverse(transform: Float[np.ndarray, "4 4"]) -> Float[np.ndarray, "4 4"]:
    """The inverse of a rigid motion.

    Args:
        transform: (4, 4), homogeneous.

    Example:
        >>> moved = np.eye(4)
        >>> moved[0, 3] = 0.5
        >>> inverse(moved)[0].tolist()
        [1.0, 0.0, 0.0, -0.5]
    """
    result = np.eye(4)
    result[:3, :3], result[:3, 3] = transform[:3, :3].T, -transform[:3, :3].T @ transform[:3, 3] + 0.0
    return result


def check_transform(name: str, transform: Float[np.ndarray, "4 4"]) -> None:
    """Refuses what is no rotation and translation, to 1e-6.

    Args:
        name: of the argument, for the message.
        transform: (4, 4), homogeneous.

    Raises:
        ShapeError: another shape.
        InputError: not finite, scaled, mirrored, or another last row.
    """
    if np.shape(transform) != (4, 4):
        raise ShapeError(f"Expected {name} with shape (4, 4), got {np.shape(transform)}. Give a homogeneous matrix.")
    rotation = transform[:3, :3]
    if not np.isfinite(transform).all() or not np.allclose(transform[3], (0.0, 0.0, 0.0, 1.0), atol=1e-9):
        raise InputError(f"Expected {name} finite with the last row (0, 0, 0, 1), got {transform[3].tolist()}.")
    if np.abs(rotation @ rotation.T - np.eye(3)).max() > 1e-6 or np.cross(*rotation[:2]) @ rotation[2] < 0:
        raise InputError(
            f"Expected a rotation in {name}, got a matrix that scales, shears or mirrors. Use a right-handed frame."
        )


def _check_image(name: str, image: np.ndarray, shape: tuple[int, ...], dtype: type) -> None:
    if not isinstance(image, np.ndarray) or image.dtype != dtype:
        came = image.dtype if isinstance(image, np.ndarray) else type(image).__name__
        raise InputError(f"Expected {name} as an array of {np.dtype(dtype)}, got {came}. Convert it where it is read.")
    if image.shape != shape:
        raise ShapeError(
            f"Expected {name} with shape {shape}, got {image.shape}. Give the intrinsics of images of this size."
        )


def _check_depth(depth: np.ndarray) -> None:
    if depth.size and not (np.isfinite(depth).all() and (depth > 0).all()):
        raise InputError("Expected depth finite and above zero where valid. Mark other pixels valid=False.")
    if depth.size and depth.max() > MAX_DEPTH:
        raise UnitsError(
            f"Expected depth in metres, at most {MAX_DEPTH:g}, got {depth.max():g}: millimetres? Divide by 1000, or "
            "mark what is too far valid=False."
        )

"""Images as the input of an exported network, which every family of networks wants a little differently."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Float32, UInt8

from eaip_prob.errors import InputError

WHOLE = (0.0, 0.0, 1.0, 1.0)
_FITS, _ORDERS = ("corner", "center", "stretch"), ("rgb", "bgr")


@dataclass(frozen=True)
class NetworkInput:
    """How an image becomes the input of a network.

    Args:
        size: (width, height), px.
        fit: `corner` or `center` keep its proportions and fill what is left, to the right and below, or on both sides;
            `stretch` fills the input.
        fill: grey of what is left, 0 to 255.
        order: of the channels, `rgb` or `bgr`.
        scale: factor on the numbers 0 to 255.
        region: (left, top, right, bottom) of the part of the image that is shown to the network, shares of its sides:
            what a camera that stands still shows of the workspace.

    Raises:
        InputError: another fit or order, or a size or region without an area.

    Example:
        >>> image = np.full((2, 4, 3), (255, 0, 0), np.uint8)
        >>> values, factor, offset = NetworkInput((8, 8), scale=1.0).prepared(image)
        >>> values[0, :, 0, 0].tolist(), values[0, :, 4, 0].tolist(), factor.tolist(), offset.tolist()
        ([255.0, 0.0, 0.0], [114.0, 114.0, 114.0], [2.0, 2.0], [0.0, 0.0])
    """

    size: Sequence[int]
    fit: str = "corner"
    fill: int = 114
    order: str = "rgb"
    scale: float = 1.0 / 255.0
    region: Sequence[float] = WHOLE

    def __post_init__(self) -> None:
        if self.fit not in _FITS or self.order not in _ORDERS:
            raise InputError(f"Expected fit of {_FITS} and order of {_ORDERS}, got {self.fit!r} and {self.order!r}.")
        if len(self.size) != 2 or min(self.size) < 1:
            raise InputError(f"Expected size as (width, height) of at least 1 px, got {self.size}.")

        check_region(self.region)

    def prepared(
        self, image: UInt8[np.ndarray, "height width 3"]
    ) -> tuple[Float32[np.ndarray, "1 3 rows columns"], Float[np.ndarray, "2"], Float[np.ndarray, "2"]]:
        """(input, factor, offset): a place counted from the image's edges is at factor x place + offset in the input.

        Args:
            image: RGB.
        """
        filled, factor, offset = self.filled(image)
        values = np.ascontiguousarray(filled.transpose(2, 0, 1)[None], np.float32) * np.float32(self.scale)
        return values, factor, offset

    def filled(
        self, image: UInt8[np.ndarray, "height width 3"]
    ) -> tuple[UInt8[np.ndarray, "rows columns 3"], Float[np.ndarray, "2"], Float[np.ndarray, "2"]]:
        """As `prepared`, but the input as an image of bytes, channels last.

        Args:
            image: RGB.
        """
        import cv2

        corner, image = part_of(image, self.region)
        whole, full = np.array([image.shape[1], image.shape[0]]), np.asarray(self.size)
        factor = full / whole if self.fit == "stretch" else np.full(2, (full / whole).min())
        inner, have = np.maximum(np.rint(whole * factor).astype(int), 1), whole
        method = cv2.INTER_AREA if factor.max() < 1.0 else cv2.INTER_LINEAR
        while (have >= 2 * inner).all() and not (have % 2).any():  # halves are exact, and several times as fast
            have = have // 2
            image = cv2.resize(image, have.tolist(), interpolation=cv2.INTER_AREA)
        left, top = (full - inner) // 2 if self.fit == "center" else (0, 0)
        filled = np.full((full[1], full[0], 3), self.fill, np.uint8)
        filled[top : top + inner[1], left : left + inner[0]] = cv2.resize(image, inner.tolist(), interpolation=method)
        factor = inner / whole
        ordered = filled[..., ::-1] if self.order == "bgr" else filled
        return ordered, factor, np.array([left, top], float) - factor * corner


def part_of(image: UInt8[np.ndarray, "height width 3"], region: Sequence[float]) -> tuple[np.ndarray, np.ndarray]:
    """(column and row of the upper left pixel, pixels) of a part of an image.

    Args:
        image: of any kind, rows and columns first.
        region: (left, top, right, bottom), shares of the image's sides.

    Example:
        >>> corner, part = part_of(np.zeros((20, 40, 3), np.uint8), (0.25, 0.0, 1.0, 0.5))
        >>> corner.tolist(), part.shape
        ([10, 0], (10, 30, 3))
    """
    height, width = image.shape[:2]
    left, top, right, bottom = np.rint(np.asarray(region) * [width, height, width, height]).astype(int)
    return np.array([left, top]), image[top:bottom, left:right]


def in_image(
    box: Float[np.ndarray, "boxes 4"],
    factor: Float[np.ndarray, "2"],
    offset: Float[np.ndarray, "2"],
    image_size: tuple[int, int],
    least: float = 1.0,
) -> Float[np.ndarray, "boxes 4"]:
    """Boxes of a network's input in the image, cut off at its edges.

    Args:
        box: (N, 4), centre column, centre row, width and height in the input, counted from the edge of its first pixel.
        factor: from `NetworkInput.prepared`.
        offset: from `NetworkInput.prepared`.
        image_size: (width, height), px.
        least: sides that are left of a box beyond the image, px.

    Example:
        >>> in_image(np.array([[5.0, 10.0, 2.0, 4.0]]), np.full(2, 0.5), np.zeros(2), (100, 50)).tolist()
        [[9.5, 19.5, 4.0, 8.0]]
    """
    limit = np.asarray(image_size, float)
    low = np.clip((box[:, :2] - box[:, 2:] / 2.0 - offset) / factor, 0.0, limit - least)
    high = np.clip((box[:, :2] + box[:, 2:] / 2.0 - offset) / factor, low + least, limit)
    # The middle of the first pixel is 0: half a pixel from the edge.
    return np.concatenate([(low + high) / 2.0 - 0.5, high - low], -1)


def check_region(region: Sequence[float]) -> None:
    """Refuses what is no part of an image.

    Args:
        region: (left, top, right, bottom), shares of the image's sides.

    Raises:
        InputError: another number of shares, or a part without an area or beyond the image.

    Example:
        >>> check_region((0.0, 0.2, 1.0, 0.9))
    """
    if len(region) != 4 or not (0.0 <= region[0] < region[2] <= 1.0 and 0.0 <= region[1] < region[3] <= 1.0):
        raise InputError(
            f"Expected region as (left, top, right, bottom), shares of the image from 0 to 1, got {tuple(region)}."
        )

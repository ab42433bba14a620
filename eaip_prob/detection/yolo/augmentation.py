"""Changes of labelled images while a detector trains, so that shape is learnt and neither colour nor place.

Cuts of other sizes and proportions, mirror images, other colours of the object and of the room apart from each other,
light, blur, noise, and things before the object.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Bool, Float, Float32, UInt8

GREY = 114  # of what lies beyond an image
_LEAST_INSIDE = 0.7  # of a box, after a cut
_TRIES = 10


@dataclass(frozen=True)
class Augmentation:
    """How much images are changed.

    Args:
        zoom: largest factor, and one over the smallest, by which the object grows.
        stretch: the same of width against height.
        recolor: probability that the object, and independently the room, takes other colours.
        cover: probability that something hides a part of the object.
        paste: largest number of objects from other images that are pasted in.
        blur: probability.
        noise: largest standard deviation of the noise, of 255.

    Example:
        >>> image, box = np.full((54, 96, 3), 90, np.uint8), np.array([40.0, 30.0, 20.0, 20.0])
        >>> visible, generator = np.zeros((54, 96), bool), np.random.default_rng(0)
        >>> changed, where = Augmentation().apply(image, box, visible, (48, 32), 0.5, generator)
        >>> changed.shape, changed.dtype.name, bool((where[2:] > 4.0).all())
        ((32, 48, 3), 'uint8', True)
    """

    zoom: float = 1.25
    stretch: float = 1.2
    recolor: float = 0.4
    cover: float = 0.2
    paste: int = 3
    blur: float = 0.2
    noise: float = 6.0

    def calmer(self) -> Augmentation:
        """Half as often recoloured and covered, and one pasted object at most: nearer to what will be seen."""
        return replace(self, recolor=self.recolor / 2, cover=self.cover / 2, paste=min(self.paste, 1))

    def apply(
        self,
        image: UInt8[np.ndarray, "height width 3"],
        box: Float[np.ndarray, "4"],
        visible: Bool[np.ndarray, "height width"],
        size: tuple[int, int],
        scale: float,
        generator: np.random.Generator,
    ) -> tuple[UInt8[np.ndarray, "rows columns 3"], Float[np.ndarray, "4"]]:
        """A changed image of the given size, and the box in it, counted from the edge of the first pixel.

        Args:
            image: RGB.
            box: (4,), centre column, centre row, width and height in the image, px.
            visible: pixels that show the object.
            size: (width, height) of the result, px.
            scale: px of the result in one of the image, before the object grows or shrinks.
            generator: of all changes.
        """
        changed, where = self.reframed(image, box, visible, size, scale, generator)
        return self.lit(changed, generator), where

    def reframed(
        self,
        image: UInt8[np.ndarray, "height width 3"],
        box: Float[np.ndarray, "4"],
        visible: Bool[np.ndarray, "height width"],
        size: tuple[int, int],
        scale: float,
        generator: np.random.Generator,
    ) -> tuple[UInt8[np.ndarray, "rows columns 3"], Float[np.ndarray, "4"]]:
        """As `apply`, but in the same light and without blur and noise.

        Args:
            image: as of `apply`.
            box: as of `apply`.
            visible: as of `apply`.
            size: as of `apply`.
            scale: as of `apply`.
            generator: as of `apply`.
        """
        import cv2

        left, top, wide, high, where = self._cut(image.shape, box, size, scale, generator)
        part = _padded(image, left, top, wide, high)
        mask = _padded(visible.astype(np.uint8), left, top, wide, high)
        part = cv2.resize(part, size, interpolation=cv2.INTER_AREA if wide > size[0] else cv2.INTER_LINEAR)
        mask = cv2.resize(mask, size, interpolation=cv2.INTER_LINEAR).astype(np.float32)[..., None]
        if generator.random() < 0.5:
            part, mask = part[:, ::-1], mask[:, ::-1]
            where = where * [-1.0, 1.0, 1.0, 1.0] + [size[0], 0.0, 0.0, 0.0]
        result = part.astype(np.float32) / 255.0
        if generator.random() < self.recolor:
            result = mask * recolored(result, generator) + (1.0 - mask) * result
        if generator.random() < self.recolor:
            result = (1.0 - mask) * recolored(result, generator) + mask * result
        if generator.random() < self.cover:
            result = _covered(result, where, generator)
        return (255.0 * result.clip(0.0, 1.0)).astype(np.uint8), where

    def _cut(
        self,
        shape: tuple[int, ...],
        box: np.ndarray,
        size: tuple[int, int],
        scale: float,
        generator: np.random.Generator,
    ) -> tuple[int, int, int, int, Float[np.ndarray, "4"]]:
        """(left, top, width, height) of a cut that holds the box, or most of it, and the box in the result."""
        low, high = box[:2] + 0.5 - box[2:] / 2, box[:2] + 0.5 + box[2:] / 2
        full, image = np.asarray(size, float), np.array([shape[1], shape[0]], float)
        for attempt in range(_TRIES):
            zoom, stretch = (top ** generator.uniform(-1.0, 1.0) for top in (self.zoom, self.stretch))
            factor = scale * zoom * np.sqrt([stretch, 1.0 / stretch])
            if attempt == _TRIES - 1:
                factor = np.full(2, min(scale, *(full / (high - low))))
            extent = np.rint(full / factor)
            room = np.stack([np.minimum(image - extent, 0.0), np.maximum(image - extent, 0.0)])
            around = np.stack([high - extent, low])  # where the whole box is inside
            around = np.stack([around.min(0), around.max(0)]).clip(*room)
            corner = np.floor(generator.uniform(around[0], around[1] + 1e-9))
            inside = ((np.stack([low, high]) - corner) * full / extent).clip(0.0, full)
            share = (inside[1] - inside[0]).prod() / ((high - low) * full / extent).prod()
            if share >= _LEAST_INSIDE:
                break
        left, top, wide, tall = (int(number) for number in (*corner, *extent))
        return left, top, wide, tall, np.concatenate([inside.mean(0), inside[1] - inside[0]])

    def lit(
        self, image: UInt8[np.ndarray, "rows columns 3"], generator: np.random.Generator
    ) -> UInt8[np.ndarray, "rows columns 3"]:
        """The image in other light, perhaps blurred, and with noise.

        Args:
            image: RGB.
            generator: of all that.
        """
        import cv2

        # One table for each channel: light of some colour, a shift, and a curve.
        gain = generator.uniform(0.7, 1.5) * generator.uniform(0.9, 1.1, 3)
        light = np.clip(np.linspace(0.0, 1.0, 256)[:, None] * gain + generator.uniform(-0.08, 0.08), 0.0, 1.0)
        table = (255.0 * light ** generator.uniform(0.75, 1.33)).astype(np.uint8)[None]
        result = cv2.LUT(np.ascontiguousarray(image), table)
        if generator.random() < self.blur:
            result = cv2.GaussianBlur(result, (0, 0), generator.uniform(0.4, 1.2))
        scale = np.float32(generator.uniform(0.0, self.noise))
        result = result + scale * generator.standard_normal(result.shape, np.float32)
        return result.clip(0.0, 255.0).astype(np.uint8)


def _padded(image: np.ndarray, left: int, top: int, wide: int, high: int) -> np.ndarray:
    """A cut that may reach beyond the image; there it is grey, or 0 in a mask."""
    shape = (high, wide, *image.shape[2:])
    result = np.full(shape, GREY if image.ndim == 3 else 0, np.uint8)
    x, y = max(left, 0), max(top, 0)
    part = image[y : top + high, x : left + wide]
    result[y - top : y - top + part.shape[0], x - left : x - left + part.shape[1]] = part
    return result


def recolored(
    image: Float32[np.ndarray, "rows columns 3"], generator: np.random.Generator
) -> Float32[np.ndarray, "rows columns 3"]:
    """Another mixture of the channels: any hue and any saturation, and at times the negative.

    Args:
        image: RGB from 0 to 1; the result may be brighter.
        generator: of the mixture.

    Example:
        >>> recolored(np.zeros((2, 2, 3), np.float32), np.random.default_rng(0)).shape
        (2, 2, 3)
    """
    mixture = generator.dirichlet([0.5, 0.5, 0.5], size=3).astype(np.float32)
    if generator.random() < 0.3:
        mixture = np.tile(mixture[:1], (3, 1))  # grey
    result = image @ mixture.T
    if generator.random() < 0.15:
        result = 1.0 - result
    return result * generator.uniform(0.7, 1.4, 3).astype(np.float32)


def _covered(image: np.ndarray, box: np.ndarray, generator: np.random.Generator) -> np.ndarray:
    """Up to three patches of one colour or of noise over the edges of the box, each of at most 16 % of its area."""
    import cv2

    result = np.ascontiguousarray(image)
    for _ in range(int(generator.integers(1, 4))):
        centre = box[:2] + (generator.random(2) - 0.5) * box[2:]
        size = box[2:] * generator.uniform(0.1, 0.4, 2)
        corners = centre + generator.uniform(-0.5, 0.5, (4, 2)) * size
        hull = cv2.convexHull(corners.astype(np.float32)).round().astype(np.int32)
        cv2.fillConvexPoly(result, hull, generator.random(3).tolist(), cv2.LINE_AA)
    return result

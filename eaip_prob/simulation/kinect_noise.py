"""What a Kinect v2 makes of a scene: the errors of time-of-flight depth and of a colour sensor.

Axial noise, lateral noise and the loss at grazing angles follow Fankhauser et al., "Kinect v2 for mobile robot
navigation: evaluation and modeling" (ICAR 2015); with z the depth in m and theta the angle of incidence, in mm,

    sigma_z = 1.5 - 0.5 z + 0.3 z^2 + 0.1 z^1.5 theta^2 / (pi/2 - theta)^2.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields, replace

import numpy as np
from jaxtyping import Float32, UInt8

from eaip_prob.data.frames import RGBDFrame
from eaip_prob.errors import InputError, ShapeError
from eaip_prob.simulation.render import Labels

_WINDOW = np.ones((3, 3), np.uint8)


@dataclass(frozen=True)
class KinectNoise:
    """Noise of one unit, drawn anew for each frame.

    Args:
        axial: multiple of sigma_z; 0 for none.
        lateral: standard deviation across the ray, m (Fankhauser et al.: 0.0016); it shows at edges in depth.
        edge: step in depth between neighbouring pixels that counts as an edge, m.
        flying: share of pixels at an edge that read a depth between both sides.
        step: depth is rounded to multiples of it, m.
        near: smallest depth measured, m.
        far: largest depth measured, m.
        grazing: angle of incidence beyond which nothing is measured, rad (Fankhauser et al.: 85 degrees).
        offset: constant error of depth, m; differs from unit to unit.
        color: standard deviation of colour, in steps of 1/255.

    Raises:
        InputError: a negative argument (the offset may be), a share above one, or a range that is empty.

    Example:
        >>> KinectNoise().sigma(np.float32(2.0), np.float32(0.0)).round(6)
        np.float32(0.0017)
    """

    axial: float = 1.0
    lateral: float = 0.0016
    edge: float = 0.05
    flying: float = 0.3
    step: float = 0.001
    near: float = 0.5
    far: float = 4.5
    grazing: float = 1.4835298641951802
    offset: float = 0.0
    color: float = 2.0

    def __post_init__(self) -> None:
        negative = [field.name for field in fields(self) if field.name != "offset" and getattr(self, field.name) < 0]
        if negative or self.flying > 1.0 or not self.near < self.far or self.step == 0.0:
            raise InputError(
                f"Expected arguments of at least zero, a step above zero, flying up to 1 and near < far, got {self}."
            )

    def sigma(self, depth: Float32[np.ndarray, "*batch"], incidence: Float32[np.ndarray, "*batch"]) -> np.ndarray:
        """Standard deviation of depth, m.

        Args:
            depth: m.
            incidence: angle between ray and normal, below pi/2, rad.
        """
        ratio = incidence / (np.float32(np.pi / 2) - incidence)
        tilt = np.float32(0.1) * depth * np.sqrt(depth) * ratio * ratio
        return np.float32(1e-3) * (np.float32(1.5) + depth * (np.float32(0.3) * depth - np.float32(0.5)) + tilt)

    def apply(self, frame: RGBDFrame, labels: Labels, generator: np.random.Generator) -> RGBDFrame:
        """The frame that the unit would deliver.

        Args:
            frame: without noise.
            labels: of its depth image.
            generator: of this camera.

        Raises:
            ShapeError: labels of another image.
        """
        if labels.depth.shape != frame.depth.shape:
            raise ShapeError(
                f"Expected labels of the depth image {frame.depth.shape}, got {labels.depth.shape}. Use those that "
                "came with the frame."
            )
        depth, valid = self._depth(frame, labels, generator)
        return replace(frame, depth=depth, valid=valid, color=self._colored(frame.color, generator))

    def _depth(self, frame: RGBDFrame, labels: Labels, generator: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
        import cv2

        # Beyond its range the camera sees what is beyond it, so that edges against nothing are edges too.
        true = np.minimum(labels.depth, np.float32(2.0 * self.far))
        low, high = cv2.erode(true, _WINDOW), cv2.dilate(true, _WINDOW)
        at_edge = np.maximum(high - true, true - low) > self.edge
        depth = self._mixed(true, low, high, np.flatnonzero(at_edge), generator)
        near_edge = np.flatnonzero(cv2.dilate(at_edge.view(np.uint8), np.ones((5, 5), np.uint8)))
        valid, incidence = labels.hit & (labels.incidence <= self.grazing), labels.incidence.copy()
        if self.lateral:
            source = self._neighbours(true, near_edge, (frame.intrinsics.fx, frame.intrinsics.fy), generator)
            for image in (depth, valid, incidence):
                image.ravel()[near_edge] = image.ravel()[source]
        if self.axial:
            np.minimum(incidence, np.float32(self.grazing), out=incidence)
            noise = generator.standard_normal(depth.shape, np.float32)
            depth += np.float32(self.axial) * self.sigma(depth, incidence) * noise
        depth = np.rint((depth + np.float32(self.offset)) / np.float32(self.step)) * np.float32(self.step)
        valid &= (depth >= self.near) & (depth <= self.far)
        depth[~valid] = 0.0
        return depth, valid

    def _neighbours(
        self, depth: np.ndarray, places: np.ndarray, focal: tuple[float, float], generator: np.random.Generator
    ) -> np.ndarray:
        """Which pixel a pixel near an edge reads: its own, or one beside it when the lateral error reaches that far."""
        rows, columns = depth.shape
        scale = np.float32(self.lateral) / np.maximum(depth.ravel()[places], np.float32(0.1))
        shift = np.rint(
            generator.standard_normal((2, places.size), np.float32) * scale * np.array([focal], np.float32).T
        )
        row, column = np.divmod(places, columns)
        row = (row + shift[1].astype(np.int64)).clip(0, rows - 1)
        return row * columns + (column + shift[0].astype(np.int64)).clip(0, columns - 1)

    def _mixed(
        self, depth: np.ndarray, low: np.ndarray, high: np.ndarray, edges: np.ndarray, generator: np.random.Generator
    ) -> np.ndarray:
        """A copy with flying pixels: light from both sides of an edge in one pixel."""
        mixed = depth.copy()
        edges = edges[generator.random(edges.size, np.float32) < self.flying]
        near, far = low.ravel()[edges], high.ravel()[edges]
        mixed.ravel()[edges] = near + generator.random(edges.size, np.float32) * (far - near)
        return mixed

    def _colored(self, color: UInt8[np.ndarray, "height width 3"], generator: np.random.Generator) -> np.ndarray:
        if not self.color:
            return color
        noisy = generator.standard_normal(color.shape, np.float32)
        noisy *= np.float32(self.color)
        noisy += color
        noisy += np.float32(0.5)
        np.clip(noisy, 0.0, 255.0, out=noisy)
        return noisy.astype(np.uint8)


def camera_generators(seed: int | Sequence[int], names: Sequence[str]) -> dict[str, np.random.Generator]:
    """A generator for each camera; independent of each other, and of which other cameras there are after it.

    Args:
        seed: of all; several numbers where one seed has several parts.
        names: of the cameras.

    Example:
        >>> sorted(camera_generators(3, ["left", "right"]))
        ['left', 'right']
    """
    children = np.random.SeedSequence(seed).spawn(len(names))
    return {name: np.random.default_rng(child) for name, child in zip(names, children, strict=True)}

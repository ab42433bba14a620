"""How well a lens is known before a calibration: its intrinsics as nine numbers, and their standard deviations."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float

from eaip_prob.data.frames import Intrinsics
from eaip_prob.data.lens import Distortion
from eaip_prob.errors import InputError

NUM_LENS = 9  # fx, fy, cx, cy, k1, k2, p1, p2, k3


@dataclass(frozen=True)
class LensStd:
    """Standard deviations of the errors of given intrinsics, independent of each other; zero for what is exact.

    The defaults are assumed: another unit than the one whose figures are given, and an ordinary lens. Tangential
    coefficients and k3 are nearly undetermined by boards in a workspace, and stay near the given ones.

    Args:
        focal: of fx and of fy, px.
        centre: of cx and of cy, px.
        distortion: of (k1, k2, p1, p2, k3), without unit.

    Raises:
        InputError: a negative or infinite one, or another number of coefficients.

    Example:
        >>> LensStd(focal=2.0, distortion=(0.0, 0.0, 0.0, 0.0, 0.0)).vector.tolist()
        [2.0, 2.0, 5.0, 5.0, 0.0, 0.0, 0.0, 0.0, 0.0]
    """

    focal: float = 5.0
    centre: float = 5.0
    distortion: Distortion = (0.01, 0.02, 0.0005, 0.0005, 0.01)

    def __post_init__(self) -> None:
        object.__setattr__(self, "distortion", tuple(float(value) for value in self.distortion))
        if len(self.distortion) != 5 or not ((self.vector >= 0.0) & (self.vector < np.inf)).all():
            raise InputError(
                "Expected standard deviations not below zero for focal, centre and (k1, k2, p1, p2, k3), got "
                f"{self.focal} px, {self.centre} px and {self.distortion}. Give zero for what is exact."
            )

    @property
    def vector(self) -> Float[np.ndarray, "lens"]:
        """(9,): fx, fy, cx, cy (px), k1, k2, p1, p2, k3."""
        return np.array([self.focal, self.focal, self.centre, self.centre, *self.distortion])

    def drawn(self, camera: Intrinsics, generator: np.random.Generator) -> Intrinsics:
        """The intrinsics of a camera, wrong by a draw of these errors.

        Args:
            camera: the true ones.
            generator: of the draw.
        """
        return with_lens(camera, lens_vector(camera) + self.vector * generator.normal(size=NUM_LENS))


def lens_vector(camera: Intrinsics) -> Float[np.ndarray, "lens"]:
    """(9,): fx, fy, cx, cy (px), k1, k2, p1, p2, k3 of a camera.

    Args:
        camera: its intrinsics.

    Example:
        >>> lens_vector(Intrinsics(640, 480, 500.0, 501.0, 320.0, 240.0))[:4].tolist()
        [500.0, 501.0, 320.0, 240.0]
    """
    return np.array([camera.fx, camera.fy, camera.cx, camera.cy, *camera.distortion])


def with_lens(camera: Intrinsics, lens: Float[np.ndarray, "lens"]) -> Intrinsics:
    """Intrinsics for images of the same size with another lens.

    Args:
        camera: whose size it is.
        lens: (9,), as of `lens_vector`.

    Raises:
        InputError: no lens of a camera.

    Example:
        >>> camera = Intrinsics(640, 480, 500.0, 501.0, 320.0, 240.0)
        >>> with_lens(camera, lens_vector(camera)) == camera
        True
    """
    fx, fy, cx, cy, k1, k2, p1, p2, k3 = (float(value) for value in lens)
    return replace(camera, fx=fx, fy=fy, cx=cx, cy=cy, distortion=(k1, k2, p1, p2, k3))

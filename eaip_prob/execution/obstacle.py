"""What the lip of the bag must clear: an upright box on the floor whose place and size are known up to a Gaussian.

The lip is a line along x at the gripper's height, so that it clears the box where the gripper does in the robot's Y-Z
plane (Fig. 14 of the paper). What stands on the floor is solid down to it: the rectangle there is open below.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from typing import Self

import numpy as np
import torch
from jaxtyping import Float

from eaip_prob.checks import as_float64, check_count, check_finite
from eaip_prob.detection.base import Detections
from eaip_prob.errors import InputError, ShapeError
from eaip_prob.linalg import psd_root

# (centre y, half of the length along y, top) of (x, y, z, length_x, length_y, length_z).
_SIDES = torch.tensor(
    [[0.0, 1.0, 0.0, 0.0, 0.0, 0.0], [0.0, 0.0, 0.0, 0.0, 0.5, 0.0], [0.0, 0.0, 1.0, 0.0, 0.0, 0.5]],
    dtype=torch.float64,
)


@dataclass(frozen=True, eq=False)
class Obstacle:
    """An upright box, as detectors place objects in the world.

    Args:
        place: (6,), centre x, y, z and edge lengths along them, m.
        covariance: (6, 6), of the place's errors, m^2; it may be singular.

    Raises:
        ShapeError: arrays of another shape.
        InputError: NaN, a length that is not above zero, or a covariance that is not symmetric.
        NotPositiveDefiniteError: a covariance with a negative eigenvalue.

    Example:
        >>> chair = Obstacle([0.95, 0.0, -0.48, 0.5, 0.4, 0.9], 1e-4 * np.eye(6))
        >>> chair.sides(2, torch.Generator().manual_seed(0)).shape
        (2, 3)
    """

    place: Float[np.ndarray, "6"]
    covariance: Float[np.ndarray, "6 6"]

    def __post_init__(self) -> None:
        for name, shape in (("place", (6,)), ("covariance", (6, 6))):
            values = as_float64(name, getattr(self, name))
            if values.shape != shape:
                raise ShapeError(f"Expected {name} with shape {shape}, got {tuple(values.shape)}.")
            check_finite(name, values, advice="Pass None where the object was not placed.")
            object.__setattr__(self, name, values.detach().numpy())
        if not (self.place[3:] > 0).all():
            raise InputError(f"Expected edge lengths above zero, in m, got {self.place[3:].tolist()}.")
        if not np.allclose(self.covariance, self.covariance.T, rtol=1e-9, atol=1e-12):
            raise InputError("Expected a symmetric covariance. Average it with its transpose.")
        _ = self._root

    @cached_property
    def _root(self) -> torch.Tensor:
        return _SIDES @ psd_root(torch.from_numpy(self.covariance))

    @classmethod
    def most_certain(cls, detections: Detections) -> Self | None:
        """The first detection that has a place; None where none has.

        Args:
            detections: the most certain first.

        Example:
            >>> Obstacle.most_certain(Detections.none((960, 540))) is None
            True
        """
        place, covariance = detections.place, detections.place_covariance
        if place is None or covariance is None:
            return None
        known = np.flatnonzero(np.isfinite(place).all(-1) & np.isfinite(covariance).all((-2, -1)))
        return cls(place[known[0]], covariance[known[0]]) if len(known) else None

    def unseen_for(self, seconds: float, speed: float = 0.002) -> Self:
        """The same box after a while in which it was not seen: the standard deviation of its centre grows with time.

        Args:
            seconds: since it was seen, at least 0.
            speed: by which somebody may have moved it meanwhile, m/s along each axis of the floor, at least 0. With the
                default a piece of furniture is 2 cm from where it was after 10 s under a bag.

        Raises:
            InputError: a negative time or speed.

        Example:
            >>> chair = Obstacle([0.95, 0.0, -0.48, 0.5, 0.4, 0.9], 1e-4 * np.eye(6))
            >>> np.sqrt(chair.unseen_for(10.0).covariance.diagonal()[:3]).round(4).tolist()
            [0.0224, 0.0224, 0.01]
        """
        if not (np.isfinite([seconds, speed]).all() and seconds >= 0 and speed >= 0):
            raise InputError(f"Expected seconds and speed of at least 0, got {seconds} and {speed}.")
        grown = (seconds * speed) ** 2 * np.diag([1.0, 1.0, 0.0, 0.0, 0.0, 0.0])
        return replace(self, covariance=self.covariance + grown)

    def sides(self, num: int, generator: torch.Generator) -> Float[np.ndarray, "num 3"]:
        """Draws of the rectangle in the Y-Z plane: centre y, half length along y and top z, m.

        Args:
            num: of draws.
            generator: source of randomness.
        """
        check_count("num", num)
        noise = torch.randn(num, self._root.shape[-1], generator=generator, dtype=torch.float64)
        return (_SIDES @ torch.from_numpy(self.place) + noise @ self._root.mT).numpy()


def clearance(
    points: Float[np.ndarray, "*batch times 2"], sides: Float[np.ndarray, "*batch 3"]
) -> Float[np.ndarray, "*batch times"]:
    """Signed distance of points from a rectangle that is open below, m; negative inside.

    Args:
        points: (*batch, T, 2), y and z, m.
        sides: (*batch, 3), centre y, half length along y (a negative one counts as 0) and top z, m.

    Example:
        >>> clearance(np.array([[0.0, 0.4], [0.5, 0.4], [0.1, -0.5]]), np.array([0.0, 0.2, 0.0])).tolist()
        [0.4, 0.5, -0.1]
    """
    middle, half, top = np.moveaxis(np.asarray(sides)[..., None, :], -1, 0)
    across = np.abs(points[..., 0] - middle) - np.maximum(half, 0.0)
    above = points[..., 1] - top
    outside = np.hypot(np.maximum(across, 0.0), np.maximum(above, 0.0))
    return outside + np.minimum(np.maximum(across, above), 0.0)

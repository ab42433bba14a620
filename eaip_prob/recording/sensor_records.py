"""What cameras saw and what was made of it, as values that a run logger stores: checked once here.

Letters: N points, ellipsoids or markers.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import numpy as np
from jaxtyping import Float64, UInt8
from scipy.stats import chi2

from eaip_prob.checks import check_positive
from eaip_prob.data.frames import RGBDFrame
from eaip_prob.errors import InputError, NotPositiveDefiniteError, ShapeError
from eaip_prob.recording.checks import Color, as_array, checked_color, checked_entity, shaped_array
from eaip_prob.recording.records import Moment


@dataclass(frozen=True, eq=False)
class CameraImages:
    """The depth and the colour image of one camera, with where it stands and its lenses.

    Args:
        frame: checked when it was made.
        at: since when the images hold; None for the whole recording.
    """

    entity: str
    frame: RGBDFrame
    at: Moment | None = None

    def __post_init__(self) -> None:
        _set(self, entity=checked_entity(self.entity))
        if not isinstance(self.frame, RGBDFrame):
            raise InputError(f"Expected an RGBDFrame at {self.entity!r}, got {type(self.frame).__name__}.")


@dataclass(frozen=True, eq=False)
class Cloud:
    """Points of surfaces, each with its colour.

    Args:
        points: (N, 3), m; N may be 0, where nothing is seen.
        colors: (N, 3), RGB.
        radius: of a point, m.
    """

    entity: str
    points: Float64[np.ndarray, "points 3"]
    colors: UInt8[np.ndarray, "points 3"]
    radius: float
    at: Moment | None = None

    def __post_init__(self) -> None:
        points, colors = as_array("points", self.points), np.array(self.colors)
        if points.ndim != 2 or points.shape[1] != 3:
            raise ShapeError(f"Expected points with shape (N, 3) at {self.entity!r}, got {points.shape}.")
        if colors.shape != points.shape:
            raise ShapeError(
                f"Expected colors with shape {points.shape} at {self.entity!r}, got {colors.shape}. Give one colour "
                "for every point."
            )
        if colors.dtype != np.uint8:
            raise InputError(f"Expected colors as uint8, 0..255, at {self.entity!r}, got {colors.dtype}.")
        check_positive("radius", self.radius)
        _set(self, entity=checked_entity(self.entity), points=points, colors=colors)


@dataclass(frozen=True, eq=False)
class Markers:
    """Points that are found at any zoom: their radius is one of the screen.

    Args:
        positions: (N, 3), m.
        radius: in points of the screen.
        labels: N texts, or none.
    """

    entity: str
    positions: Float64[np.ndarray, "markers 3"]
    radius: float
    color: Color
    at: Moment | None = None
    labels: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        positions = _points("positions", self.entity, self.positions)
        check_positive("radius", self.radius)
        _check_labels(self.entity, self.labels, len(positions))
        _set(self, entity=checked_entity(self.entity), positions=positions, color=checked_color(self.color))


@dataclass(frozen=True, eq=False)
class Ellipsoids:
    """Where Gaussian points lie with a given probability.

    Args:
        centers: (N, 3), means, m.
        covariance: (N, 3, 3), m^2.
        level: probability that a point is inside.
        labels: N texts, or none.
    """

    entity: str
    centers: Float64[np.ndarray, "ellipsoids 3"]
    covariance: Float64[np.ndarray, "ellipsoids 3 3"]
    level: float
    color: Color
    at: Moment | None = None
    labels: tuple[str, ...] = ()
    half_sizes: Float64[np.ndarray, "ellipsoids 3"] = field(init=False)
    rotations: Float64[np.ndarray, "ellipsoids 3 3"] = field(init=False)

    def __post_init__(self) -> None:
        centers = _points("centers", self.entity, self.centers)
        covariance = as_array("covariance", self.covariance)
        if covariance.shape != (len(centers), 3, 3):
            raise ShapeError(
                f"Expected covariance with shape {(len(centers), 3, 3)} at {self.entity!r}, got {covariance.shape}. "
                "Give one matrix for every centre."
            )
        if not 0.0 < self.level < 1.0:
            raise InputError(f"Expected level above 0 and below 1 at {self.entity!r}, got {self.level}.")
        _check_labels(self.entity, self.labels, len(centers))
        half_sizes, rotations = ellipsoid_axes(covariance, self.level)
        _set(self, entity=checked_entity(self.entity), centers=centers, covariance=covariance)
        _set(self, color=checked_color(self.color), half_sizes=half_sizes, rotations=rotations)


SensorRecord = CameraImages | Cloud | Markers | Ellipsoids


def ellipsoid_axes(
    covariance: Float64[np.ndarray, "ellipsoids 3 3"], level: float
) -> tuple[Float64[np.ndarray, "ellipsoids 3"], Float64[np.ndarray, "ellipsoids 3 3"]]:
    """(half sizes (N, 3), m; rotations (N, 3, 3) from the axes of each ellipsoid into the world), smallest first.

    A Gaussian point's squared Mahalanobis distance has a chi-squared distribution with 3 degrees of freedom.

    Args:
        covariance: (N, 3, 3), m^2.
        level: probability that a point is inside.

    Raises:
        InputError: a matrix that is not symmetric.
        NotPositiveDefiniteError: a variance that is not above zero along some axis.

    Example:
        >>> sizes, rotations = ellipsoid_axes(np.diag([4e-6, 1e-6, 9e-6])[None], level=0.95)
        >>> (1000.0 * sizes).round(2).tolist()
        [[2.8, 5.59, 8.39]]
    """
    scale = np.abs(covariance).max(axis=(-2, -1), keepdims=True)
    if (np.abs(covariance - covariance.swapaxes(-1, -2)) > 1e-9 * scale).any():
        raise InputError("Expected covariance as symmetric matrices, got one that is not. Average it with its mirror.")
    values, axes = np.linalg.eigh(covariance)
    if not (values > 0).all():
        raise NotPositiveDefiniteError(
            f"Expected variances above zero along every axis, got {values.min():.3g}. Add the noise that is left out."
        )
    # eigenvectors are known up to their sign; a mirrored set is no rotation
    left_handed = np.einsum("ni,ni->n", np.cross(axes[..., 0], axes[..., 1]), axes[..., 2]) < 0
    axes = axes * np.where(left_handed, -1.0, 1.0)[:, None, None]
    return np.sqrt(chi2.ppf(level, 3) * values), axes


def _points(name: str, entity: str, values: Any) -> np.ndarray:
    points = shaped_array(name, values, ("N", "3"))
    if points.shape[1] != 3:
        raise ShapeError(f"Expected {name} with shape (N, 3) at {entity!r}, got {points.shape}.")
    return points


def _check_labels(entity: str, labels: tuple[str, ...], count: int) -> None:
    if labels and len(labels) != count:
        raise ShapeError(f"Expected {count} labels at {entity!r}, or none, got {len(labels)}.")


def _set(record: Any, **fields: Any) -> None:
    for key, value in fields.items():
        object.__setattr__(record, key, value)

r"""The centre of a glove from the side of it that cameras see.

A glove is taken for a sphere of known radius. The points that a camera measures lie on the side towards it: weighted
by their pixels their mean is 2r/3 from the centre towards the camera, because the height of a half-sphere over its
disc, sqrt(r^2 - d^2), is 2r/3 on average. That holds where the whole disc is seen; without its rim, which a
mask loses, the mean comes out some millimetres off. The fit of a sphere holds also where a part is hidden: it gives the
centre, and the mean is where it starts.

Letters: r radius, d distance from the line of sight through the centre, c centre, p_i points, n_i direction from c to
p_i, v_i line of sight.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float, Int

from eaip_prob.errors import InputError, ShapeError

LATERAL_SIGMA = 1.6e-3  # metres, across the line of sight; Fankhauser et al., ICAR 2015, Sec. IV
_ROUNDS = 8
_HUBER = 2.0  # standard deviations from which a point counts less
_CLOSE = 1e-5  # metres; a step of the fit below this is the last


def depth_sigma(depth: Float[np.ndarray, "*batch"]) -> Float[np.ndarray, "*batch"]:
    """Standard deviation of a Kinect v2's depth on a surface that faces it, m.

    1.5 - 0.5 z + 0.3 z^2 mm, z in m: Fankhauser et al., "Kinect v2 for Mobile Robot Navigation", ICAR 2015.

    Args:
        depth: (*batch), m.

    Example:
        >>> depth_sigma(np.array([1.0, 2.0])).round(5).tolist()
        [0.0013, 0.0017]
    """
    return 1e-3 * (1.5 - 0.5 * depth + 0.3 * depth * depth)


@dataclass(frozen=True, eq=False)
class SphereFit:
    """A sphere of known radius laid on points.

    Args:
        center: (3,), m.
        covariance: (3, 3), of the centre, m^2.
        inlier: (N,), points that lie on the sphere.
        residual: root mean square distance of the inliers from the sphere, m.
    """

    center: Float[np.ndarray, "3"]
    covariance: Float[np.ndarray, "3 3"]
    inlier: Bool[np.ndarray, "points"]
    residual: float


def center_from_mean(
    points: Float[np.ndarray, "points 3"],
    views: Float[np.ndarray, "points 3"],
    camera: Int[np.ndarray, "points"],
    radius: float,
) -> Float[np.ndarray, "3"]:
    """Centre of a sphere of which each camera sees the whole near side, m: its mean moved 2r/3 along the view.

    Args:
        points: (N, 3), m.
        views: (N, 3), unit vectors from the camera to the points.
        camera: (N,), which camera measured the point; each camera counts by its number of points.
        radius: m.

    Example:
        >>> points = np.array([[0.0, 0.0, 1.9], [0.0, 0.0, 1.9]])
        >>> views = np.array([[0.0, 0.0, 1.0], [0.0, 0.0, 1.0]])
        >>> center_from_mean(points, views, np.zeros(2, dtype=int), radius=0.06).round(6).tolist()
        [0.0, 0.0, 1.94]
    """
    _check(points, views, radius, least=1)
    total = np.zeros(3)
    for index in np.unique(camera):
        here = camera == index
        view = views[here].mean(0)
        center = points[here].mean(0) + 2.0 / 3.0 * radius * view / np.linalg.norm(view)
        total += here.sum() * center
    return total / len(points)


def fit_sphere(
    points: Float[np.ndarray, "points 3"],
    views: Float[np.ndarray, "points 3"],
    sigma: Float[np.ndarray, "points"],
    radius: float,
    start: Float[np.ndarray, "3"],
    radius_sigma: float = 0.001,
) -> SphereFit:
    r"""Centre that lays a sphere on points, by weighted least squares with Huber's weights.

    Minimises::

        sum_i w_i (norm(p_i - c) - r)^2,    1 / w_i = (n_i . v_i)^2 sigma_i^2 + (1 - (n_i . v_i)^2) sigma_lateral^2

    with the sensor's variance along the line of sight and across it. The covariance is that of the estimate, larger by
    the spread that was found where that exceeds the sensor's, plus what an error of the radius does to the centre.

    Args:
        points: (N, 3), m; at least three.
        views: (N, 3), unit vectors from the camera to the points.
        sigma: (N,), standard deviation of the depth, m.
        radius: r, m.
        start: (3,), a centre to begin with, within a radius or so of the truth, m.
        radius_sigma: standard deviation of the radius, m.

    Raises:
        ShapeError: fewer than three points.
        InputError: a radius not above zero.

    Example:
        >>> way = np.linspace(0.0, 2.0 * np.pi, 20, endpoint=False)
        >>> side = np.column_stack([np.cos(way), np.sin(way), -np.ones(20)]) / np.sqrt(2.0)
        >>> views = np.tile([0.0, 0.0, 1.0], (20, 1))
        >>> at = np.array([0.1, 0.2, 2.0])
        >>> fit_sphere(at + 0.05 * side, views, np.full(20, 0.002), 0.05, start=at + 0.02).center.round(6).tolist()
        [0.1, 0.2, 2.0]
    """
    _check(points, views, radius, least=3)
    center = np.array(start, dtype=float)
    for _ in range(_ROUNDS):
        normal, error, weight = _linearised(points, views, sigma, radius, center)
        robust = weight * np.minimum(1.0, _HUBER / np.maximum(np.abs(error) * np.sqrt(weight), 1e-12))
        information = (normal * robust[:, None]).T @ normal + 1e-3 * robust.max() * np.eye(3)
        step = np.linalg.solve(information, normal.T @ (robust * error))
        length = float(np.linalg.norm(step))
        center += step * min(1.0, 0.5 * radius / max(length, 1e-12))
        if length < _CLOSE:
            break
    return _fit_at(center, points, views, sigma, radius, radius_sigma)


def _linearised(
    points: np.ndarray, views: np.ndarray, sigma: np.ndarray, radius: float, center: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    away = points - center
    distance = np.sqrt(np.einsum("ij,ij->i", away, away))
    normal = away / np.maximum(distance, 1e-9)[:, None]
    along = np.einsum("ij,ij->i", normal, views) ** 2
    variance = along * sigma**2 + (1.0 - np.minimum(along, 1.0)) * LATERAL_SIGMA**2
    return normal, distance - radius, 1.0 / variance


def _fit_at(
    center: np.ndarray,
    points: np.ndarray,
    views: np.ndarray,
    sigma: np.ndarray,
    radius: float,
    radius_sigma: float,
) -> SphereFit:
    normal, error, weight = _linearised(points, views, sigma, radius, center)
    inlier = np.abs(error) < 0.2 * radius
    kept, used = normal[inlier], weight[inlier]
    if len(used) < 3:
        return SphereFit(center, radius**2 * np.eye(3), inlier, float(np.sqrt(np.mean(error**2))))
    information = (kept * used[:, None]).T @ kept + np.eye(3) / (4.0 * radius**2)
    covariance = np.linalg.solve(information, np.eye(3))
    spread = float(np.mean(used * error[inlier] ** 2))
    lean = radius_sigma * covariance @ (kept.T @ used)
    covariance = max(1.0, spread) * covariance + np.outer(lean, lean)
    return SphereFit(center, 0.5 * (covariance + covariance.T), inlier, float(np.sqrt(np.mean(error[inlier] ** 2))))


def _check(points: np.ndarray, views: np.ndarray, radius: float, least: int) -> None:
    if len(points) < least or np.shape(points) != np.shape(views) or np.shape(points)[1:] != (3,):
        raise ShapeError(
            f"Expected points and views with shape (N, 3), N at least {least}, got {np.shape(points)} and "
            f"{np.shape(views)}. Leave out components of fewer points."
        )
    if not radius > 0:
        raise InputError(f"Expected the radius of the glove above zero, in metres, got {radius:g}.")

"""What may be a glove among points that have its colour: connected, of the right size, and round.

Components of a grid of 3 cm are laid out with one sphere each, or with two where one does not explain them (hands that
touch). What neither explains, or what is too small, is some other green thing.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components
from scipy.spatial import KDTree

from eaip_prob.perception.glove_mask import GlovePoints
from eaip_prob.perception.glove_offset import SphereFit, center_from_mean, fit_sphere

CELL = 0.03  # metres; points closer than one to two cells are connected
_EXPLAINED = 0.85  # share of a component's points that lie on its sphere or spheres
_SHOWN = 0.08  # least visible area of a glove, as a share of its disc
_APART = 1.2  # radii between the centres of two gloves: less is one glove cut in two
_MOST_POINTS = 400  # of a sphere's fit
_SPLIT_ROUNDS = 6


@dataclass(frozen=True, eq=False)
class GloveCandidate:
    """Something with the colour, the size and the shape of a glove.

    Args:
        center: (3,), in the world, m.
        covariance: (3, 3), m^2.
        share: how much of a glove's disc was seen, 1 by one camera that saw all of it.
    """

    center: Float[np.ndarray, "3"]
    covariance: Float[np.ndarray, "3 3"]
    share: float


def glove_candidates(
    seen: GlovePoints, radius: float, expected: Float[np.ndarray, "expected 3"], floor_sigma: float = 0.0015
) -> list[GloveCandidate]:
    """Candidates among the points of one moment, the best seen first.

    Args:
        seen: points of all cameras.
        radius: of a glove, m.
        expected: (E, 3), centres where gloves are expected, m; they say where to part gloves that touch.
        floor_sigma: standard deviation of what no fit can tell (calibration, shape), m.

    Example:
        >>> glove_candidates(GlovePoints.joined([]), 0.05, np.zeros((0, 3)))
        []
    """
    least = _SHOWN * np.pi * radius**2
    found: list[GloveCandidate] = []
    for component in components(seen):
        if _area(component) < least or not _small(component, radius):
            continue
        for part, fit in _spheres(component, radius, expected):
            area = _area(part)
            if area >= least:
                covariance = fit.covariance + floor_sigma**2 * np.eye(3)
                found.append(GloveCandidate(fit.center, covariance, area / (np.pi * radius**2)))
    return sorted(found, key=lambda candidate: -candidate.share)


def components(seen: GlovePoints, cell: float = CELL) -> list[GlovePoints]:
    """Groups of points whose cells of a grid touch, at a face, an edge or a corner.

    Args:
        seen: points.
        cell: edge of the grid, m.

    Example:
        >>> components(GlovePoints.joined([]))
        []
    """
    if not len(seen.points):
        return []
    cells, where = np.unique(np.floor(seen.points / cell).astype(np.int64), axis=0, return_inverse=True)
    pairs = KDTree(cells).query_pairs(1.8, output_type="ndarray")
    graph = coo_array((np.ones(len(pairs)), (pairs[:, 0], pairs[:, 1])), shape=(len(cells), len(cells)))
    count, label = connected_components(graph, directed=False)
    member = label[where.reshape(-1)]
    return [seen if count == 1 else seen.select(np.flatnonzero(member == i)) for i in range(count)]


def _area(seen: GlovePoints) -> float:
    """Area seen by the camera that saw most of it, m^2."""
    return float(np.bincount(seen.camera, seen.area).max()) if len(seen.points) else 0.0


def _small(component: GlovePoints, radius: float) -> bool:
    return float(np.ptp(component.points, axis=0).max()) < 5.0 * radius


def _spheres(component: GlovePoints, radius: float, expected: np.ndarray) -> list[tuple[GlovePoints, SphereFit]]:
    near = expected[_near(expected, component.points, radius)] if len(expected) else expected
    start = near[0] if len(near) == 1 else None
    one = _fit(component, radius, start)
    if one.inlier.mean() >= _EXPLAINED:
        return [(component, one)]
    seeds = near if len(near) == 2 else _far_ends(component.points)
    parts, fits = _two_spheres(component, radius, seeds)
    apart = len(fits) == 2 and np.linalg.norm(fits[0].center - fits[1].center) > _APART * radius
    if apart and np.concatenate([fit.inlier for fit in fits]).mean() >= _EXPLAINED:
        return list(zip(parts, fits, strict=True))
    return []


def _near(expected: np.ndarray, points: np.ndarray, radius: float) -> np.ndarray:
    low, high = points.min(0) - 2.0 * radius, points.max(0) + 2.0 * radius
    return np.all((expected > low) & (expected < high), axis=1)


def _fit(part: GlovePoints, radius: float, start: np.ndarray | None = None) -> SphereFit:
    if len(part.points) > _MOST_POINTS:
        part = part.select(np.arange(0, len(part.points), len(part.points) // _MOST_POINTS + 1))
    begin = center_from_mean(part.points, part.views, part.camera, radius) if start is None else start
    return fit_sphere(part.points, part.views, part.sigma, radius, begin)


def _far_ends(points: np.ndarray) -> np.ndarray:
    """Two points at the ends of the longest axis."""
    centred = points - points.mean(0)
    along = centred @ np.linalg.eigh(centred.T @ centred)[1][:, -1]
    return points[[int(along.argmin()), int(along.argmax())]]


def _two_spheres(component: GlovePoints, radius: float, seeds: np.ndarray) -> tuple[list[GlovePoints], list[SphereFit]]:
    """Two-means from seeds; a point goes to the nearer centre, which for equal spheres is the nearer sphere."""
    centers, before = np.asarray(seeds, dtype=float), None
    fits: list[SphereFit] = []
    parts: list[GlovePoints] = []
    for _ in range(_SPLIT_ROUNDS):
        nearer = np.linalg.norm(component.points[:, None] - centers, axis=-1).argmin(1)
        if min(np.bincount(nearer, minlength=2)) < 3 or (before is not None and np.array_equal(nearer, before)):
            break
        before = nearer
        parts = [component.select(np.flatnonzero(nearer == i)) for i in (0, 1)]
        fits = [_fit(part, radius) for part in parts]
        centers = np.stack([fit.center for fit in fits])
    return parts, fits

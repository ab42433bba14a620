from __future__ import annotations

import numpy as np
import pytest

from eaip_prob.errors import InputError, ShapeError
from eaip_prob.perception.glove_offset import center_from_mean, fit_sphere

CENTER = np.array([0.9, -0.2, 0.3])


def seen_side(generator, radius, view, count, shown=1.0):
    """Points of a sphere as pixels of equal size across the line of sight show it, out to a share of the radius."""
    view = np.asarray(view, dtype=float) / np.linalg.norm(view)
    across = np.linalg.svd(view[None])[2][1:]
    rho = shown * radius * np.sqrt(generator.uniform(size=count))
    angle = generator.uniform(0.0, 2.0 * np.pi, count)
    offset = rho[:, None] * (np.cos(angle)[:, None] * across[0] + np.sin(angle)[:, None] * across[1])
    points = CENTER + offset - np.sqrt(radius**2 - rho**2)[:, None] * view
    return points, np.tile(view, (count, 1))


@pytest.mark.parametrize("radius", [0.04, 0.07])
def test_mean_of_the_near_side_is_two_thirds_of_a_radius_in_front(radius):
    points, views = seen_side(np.random.default_rng(0), radius, (1.0, 2.0, -1.0), 20_000)
    found = center_from_mean(points, views, np.zeros(len(points), dtype=int), radius)
    assert np.linalg.norm(found - CENTER) < 4.0 * radius / np.sqrt(20_000)


def test_each_camera_is_corrected_along_its_own_view():
    generator = np.random.default_rng(1)
    one, other = seen_side(generator, 0.05, (0, 1, 0), 9000), seen_side(generator, 0.05, (0, -1, -1), 3000)
    points, views = (np.concatenate(pair) for pair in zip(one, other, strict=True))
    found = center_from_mean(points, views, np.repeat([0, 1], [9000, 3000]), 0.05)
    assert np.linalg.norm(found - CENTER) < 2e-3


@pytest.mark.parametrize("radius", [0.035, 0.06])
@pytest.mark.parametrize("shown", [0.6, 1.0])
def test_fit_finds_the_centre_though_only_a_part_is_seen(radius, shown):
    generator = np.random.default_rng(2)
    points, views = seen_side(generator, radius, (1.0, 0.5, -0.8), 300, shown)
    half = points[:, 2] > CENTER[2]  # the lower half is behind something
    start = points[half].mean(0)
    fit = fit_sphere(points[half], views[half], np.full(half.sum(), 0.0015), radius, start)
    np.testing.assert_allclose(fit.center, CENTER, atol=1e-6)


def test_points_of_something_else_do_not_pull():
    generator = np.random.default_rng(3)
    points, views = seen_side(generator, 0.05, (1, 0, -1), 200, 0.8)
    points[:20] += 0.16 * views[:20]  # behind the whole sphere
    fit = fit_sphere(points, views, np.full(200, 0.0015), 0.05, points.mean(0))
    assert np.linalg.norm(fit.center - CENTER) < 2e-3
    assert not fit.inlier[:20].any() and fit.inlier[20:].all()


def test_covariance_is_the_spread_of_the_estimate():
    generator, errors, covariance = np.random.default_rng(4), [], np.zeros((3, 3))
    for _ in range(150):
        points, views = seen_side(generator, 0.05, (1, 0, -1), 80, 0.8)
        points = points + 0.003 * generator.normal(size=(80, 1)) * views
        fit = fit_sphere(points, views, np.full(80, 0.003), 0.05, CENTER + 0.01, radius_sigma=0.0)
        errors.append(fit.center - CENTER)
        covariance += fit.covariance / 150
    found = np.cov(np.array(errors).T)
    ratio = np.linalg.eigvalsh(np.linalg.solve(covariance, found))
    assert ratio.min() > 0.2 and ratio.max() < 1.6  # never too sure; lateral noise was not drawn


def test_error_of_the_radius_shows_along_the_view():
    points, views = seen_side(np.random.default_rng(5), 0.05, (0, 0, -1), 200, 0.7)
    known, unsure = (
        fit_sphere(points, views, np.full(200, 0.0015), 0.05, CENTER, radius_sigma=s).covariance for s in (0.0, 0.004)
    )
    wrong = fit_sphere(points, views, np.full(200, 0.0015), 0.054, CENTER, radius_sigma=0.004).center
    more = np.sqrt(np.diag(unsure - known))
    assert more[2] == pytest.approx(abs(wrong - CENTER)[2], rel=0.1) and more[:2].max() < 1e-3


def test_wrong_arguments_are_named():
    with pytest.raises(ShapeError, match="at least 3"):
        fit_sphere(np.zeros((2, 3)), np.zeros((2, 3)), np.ones(2), 0.05, np.zeros(3))
    with pytest.raises(InputError, match="radius"):
        fit_sphere(np.zeros((4, 3)), np.zeros((4, 3)), np.ones(4), 0.0, np.zeros(3))

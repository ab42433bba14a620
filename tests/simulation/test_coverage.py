from __future__ import annotations

import numpy as np
import pytest

from eaip_prob.errors import InputError, ShapeError
from eaip_prob.simulation import box, covered_points, joined, sheet, surface_points

THING = box((0.4, 0.6, 0.8), (1, 0, 0)).at(0.9, 0.1, 0.4)
AXIS = (0.9, 0.1)


def roof(height=0.9, size=2.0):
    x, y = np.meshgrid([-size, size], [-size, size])
    return sheet(np.stack([x + AXIS[0], y + AXIS[1], np.full_like(x, height)], -1), (1, 1, 1))


def points(count=500):
    return surface_points(THING, count, np.random.default_rng(1))


def test_a_box_over_all_of_it_covers_all():
    cover = box((0.5, 0.7, 1.0), (1, 1, 1)).at(0.9, 0.1, 0.41)
    assert covered_points(points(), cover, AXIS).all()


@pytest.mark.parametrize("cloth", [roof(), roof(height=-0.1), box((0.1, 0.1, 0.1), (1, 1, 1)).at(5.0, 5.0, 0.5)])
def test_a_roof_a_carpet_and_something_elsewhere_cover_nothing(cloth):
    assert not covered_points(points(), cloth, AXIS).any()


def test_walls_alone_cover_nothing_and_half_a_cover_covers_its_half():
    walls = [box((2.0, 0.01, 1.0), (1, 1, 1)).at(0.9, 0.1 + side * 0.5, 0.5) for side in (-1.0, 1.0)]
    walls += [box((0.01, 1.0, 1.0), (1, 1, 1)).at(0.9 + side * 0.5, 0.1, 0.5) for side in (-1.0, 1.0)]
    assert not covered_points(points(), joined(walls), AXIS)[points()[:, 2] < 0.79].any()
    found = covered_points(points(), joined([roof(), *(wall.at(z=0.5) for wall in walls)]), AXIS)
    assert (found == (points()[:, 2] > 0.5)).all()


def test_outwards_is_away_from_the_axis_and_not_towards_it():
    wall = joined([roof(), box((0.01, 4.0, 2.0), (1, 1, 1)).at(1.5, 0.1, 0.5)])
    pair = np.array([[1.1, 0.1, 0.4], [0.7, 0.1, 0.4]])
    assert covered_points(pair, wall, AXIS).tolist() == [True, False]
    assert covered_points(pair, wall, (0.5, 0.1)).tolist() == [True, True]
    assert covered_points(pair, wall, (1.2, 0.1)).tolist() == [False, False]


def test_a_point_on_the_axis_needs_a_cover_too():
    above = np.array([[*AXIS, 0.8]])
    cover = box((0.5, 0.7, 1.0), (1, 1, 1)).at(0.9, 0.1, 0.41)
    assert covered_points(above, cover, AXIS).tolist() == [True]
    assert covered_points(above, roof(), AXIS).tolist() == [False]


def test_a_point_just_under_the_cloth_is_covered():
    cover = box((1.0, 1.0, 3.0), (1, 1, 1)).at(*AXIS, 0.9 - 1.5)
    close = np.array([[1.0, 0.1, 0.9 - 2e-4], [1.4 - 2e-4, 0.1, 0.0], [1.0, 0.1, 0.9 + 2e-4]])
    assert covered_points(close, cover, AXIS).tolist() == [True, True, False]


def test_points_are_drawn_evenly_by_area():
    drawn = surface_points(THING, 20000, np.random.default_rng(3))
    local = np.abs(drawn - [0.9, 0.1, 0.4])
    on = [np.isclose(local[:, k], size / 2) for k, size in enumerate((0.4, 0.6, 0.8))]
    assert np.logical_or.reduce(on).all()
    area = np.array([0.6 * 0.8, 0.4 * 0.8, 0.4 * 0.6])
    share, expected = np.array([face.mean() for face in on]), area / area.sum()
    assert np.abs(share - expected).max() < 4 * np.sqrt(0.25 / 20000)
    side = drawn[on[0]]
    assert side[:, 1].mean() == pytest.approx(0.1, abs=4 * 0.6 / np.sqrt(12 * len(side)))
    assert side[:, 1].std() == pytest.approx(0.6 / np.sqrt(12), rel=0.05)  # in each triangle too


def test_the_same_generator_draws_the_same_points():
    assert (points() == points()).all()


def test_what_cannot_be_is_refused():
    with pytest.raises(InputError, match="count of at least 1, got 0"):
        surface_points(THING, 0, np.random.default_rng(0))
    with pytest.raises(ShapeError, match=r"points \(any, 3\) and an axis \(x, y\), got \(3,\) and \(2,\)"):
        covered_points(np.zeros(3), THING, AXIS)
    with pytest.raises(ShapeError, match=r"got \(2, 3\) and \(3,\)"):
        covered_points(np.zeros((2, 3)), THING, (0.0, 0.0, 0.0))

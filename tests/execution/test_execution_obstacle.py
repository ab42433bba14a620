from __future__ import annotations

import numpy as np
import pytest
import torch

from eaip_prob.detection import Detections
from eaip_prob.errors import InputError, NotPositiveDefiniteError, ShapeError
from eaip_prob.execution import Obstacle, clearance

PLACE = np.array([0.9, 0.1, -0.4, 0.5, 0.4, 0.9])


def slow_clearance(point: np.ndarray, sides: np.ndarray) -> float:
    """Distance to the nearest of many points on the outline, which reaches far down."""
    middle, half, top = sides
    across, down = np.linspace(-half, half, 4001), np.linspace(0.0, 4.0, 40001)
    outline = [np.column_stack([middle + across, np.full(4001, top)])]
    outline += [np.column_stack([np.full(40001, middle + side * half), top - down]) for side in (-1, 1)]
    distance = np.linalg.norm(np.concatenate(outline) - point, axis=-1).min()
    inside = abs(point[0] - middle) < half and point[1] < top
    return -distance if inside else distance


def test_clearance_is_the_distance_to_the_outline():
    rng = np.random.default_rng(0)
    sides = np.column_stack([rng.normal(0, 0.3, 4), rng.uniform(0.05, 0.5, 4), rng.normal(0, 0.3, 4)])
    points = rng.uniform(-1.0, 1.0, size=(4, 12, 2))
    exact = [[slow_clearance(point, side) for point in row] for row, side in zip(points, sides, strict=True)]
    fast = clearance(points, sides)
    np.testing.assert_allclose(fast, exact, atol=2e-4)
    assert (fast < 0).any()
    assert (fast > 0).any()
    np.testing.assert_array_equal(clearance(points[2], sides[2]), fast[2])


def test_a_negative_width_is_none():
    points = np.array([[0.0, -0.2], [0.3, 0.4]])
    np.testing.assert_allclose(clearance(points, np.array([0.0, -0.1, 0.0])), [0.0, 0.5])


def test_sides_have_the_mean_and_covariance_of_the_place():
    root = np.random.default_rng(1).normal(size=(6, 6)) * [[0.02], [0.03], [0.01], [0.02], [0.05], [0.04]]
    covariance = root @ root.T
    rows = np.array([[0, 1, 0, 0, 0, 0], [0, 0, 0, 0, 0.5, 0], [0, 0, 1, 0, 0, 0.5]])
    drawn = Obstacle(PLACE, covariance).sides(40000, torch.Generator().manual_seed(0))
    exact = rows @ covariance @ rows.T
    error = np.sqrt(exact.diagonal() / 40000)
    assert (np.abs(drawn.mean(0) - [0.1, 0.2, 0.05]) < 4 * error).all()
    np.testing.assert_allclose(np.cov(drawn.T), exact, atol=4 * exact.max() * np.sqrt(2 / 40000))


def test_what_is_known_exactly_is_drawn_exactly():
    drawn = Obstacle(PLACE, np.zeros((6, 6))).sides(3, torch.Generator().manual_seed(0))
    np.testing.assert_allclose(drawn, np.tile([0.1, 0.2, 0.05], (3, 1)), atol=1e-12)


def detections(place: np.ndarray | None) -> Detections:
    covariance = None if place is None else np.where(np.isnan(place[:, :, None]), np.nan, np.eye(6) * 1e-4)
    count = 2 if place is None else len(place)
    boxes = np.tile([9.0, 9.0, 4.0, 4.0], (count, 1))
    return Detections(
        ("chair",) * count, np.linspace(0.9, 0.5, count), boxes, (20, 20), place=place, place_covariance=covariance
    )


def test_the_first_detection_with_a_place_is_the_obstacle():
    found = Obstacle.most_certain(detections(np.stack([np.full(6, np.nan), PLACE, PLACE + 1.0])))
    assert found is not None
    np.testing.assert_array_equal(found.place, PLACE)
    assert Obstacle.most_certain(detections(None)) is None
    assert Obstacle.most_certain(detections(np.full((1, 6), np.nan))) is None


def test_an_obstacle_that_is_not_seen_becomes_uncertain_on_the_floor():
    before = Obstacle(PLACE, 1e-4 * np.eye(6))
    after = before.unseen_for(5.0, speed=0.02)
    np.testing.assert_allclose(after.covariance.diagonal(), [1e-4 + 0.01, 1e-4 + 0.01, 1e-4, 1e-4, 1e-4, 1e-4])
    np.testing.assert_array_equal(before.covariance, 1e-4 * np.eye(6))
    spread = after.sides(4000, torch.Generator().manual_seed(0))[:, 0].std()
    assert spread == pytest.approx(np.sqrt(0.0101), rel=0.05)
    for wrong in ((-1.0, 0.1), (1.0, -0.1), (float("nan"), 0.1)):
        with pytest.raises(InputError, match="seconds and speed of at least 0"):
            before.unseen_for(*wrong)


def test_what_is_no_box_is_refused():
    good = 1e-4 * np.eye(6)
    with pytest.raises(InputError, match="finite numbers in place"):
        Obstacle(np.where(np.arange(6) == 2, np.nan, PLACE), good)
    with pytest.raises(InputError, match="finite numbers in covariance"):
        Obstacle(PLACE, np.full((6, 6), np.inf))
    with pytest.raises(ShapeError, match="place with shape"):
        Obstacle(PLACE[:5], good)
    with pytest.raises(InputError, match="edge lengths above zero"):
        Obstacle(PLACE * [1, 1, 1, 1, -1, 1], good)
    with pytest.raises(InputError, match="symmetric"):
        Obstacle(PLACE, good + np.triu(good.max() * np.ones((6, 6)), 1))
    with pytest.raises(NotPositiveDefiniteError):
        Obstacle(PLACE, -good)

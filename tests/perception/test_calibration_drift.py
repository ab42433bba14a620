from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from eaip_prob.errors import InputError, ShapeError
from eaip_prob.perception.drift import drift


def clouds(generator, count=20000, noise=0.002):
    """A bumpy, patterned piece of a surface, sampled anew at each call."""
    x, y = generator.uniform(0.0, 0.8, (2, count))
    points = np.column_stack([x, y, 0.08 * np.sin(9.0 * x) * np.cos(7.0 * y)])
    colors = np.column_stack([127.0 + 120.0 * np.sin(25.0 * x), 127.0 + 120.0 * np.cos(18.0 * y), 90.0 + 0.0 * x])
    return points + generator.normal(0.0, noise, points.shape), colors.astype(np.uint8)


@pytest.mark.slow
@pytest.mark.parametrize(("shift", "angle"), [(0.0, 0.0), (0.006, 0.0), (0.004, 0.5), (0.015, 1.0)])
def test_drift_is_what_the_second_cloud_was_moved_by(shift, angle):
    rng = np.random.default_rng(1)
    (points_a, colors_a), (points_b, colors_b) = clouds(rng), clouds(rng)
    turn = Rotation.from_rotvec([0.0, 0.0, np.radians(angle)])
    centre = points_a.mean(0)
    moved = turn.apply(points_b - centre) + centre + (0.6 * shift, 0.0, 0.8 * shift)
    before = points_a.copy()
    found = drift(points_a, colors_a, moved, colors_b)
    assert found.error.millimetres == pytest.approx(1e3 * shift, abs=0.8)
    assert found.error.degrees == pytest.approx(angle, abs=0.1)
    assert found.overlap > 0.9
    np.testing.assert_array_equal(points_a, before)


@pytest.mark.slow
def test_clouds_apart_are_refused():
    points, colors = clouds(np.random.default_rng(2), count=2000)
    with pytest.raises(InputError, match="clouds of one scene, got 0%"):
        drift(points, colors, points + 3.0, colors)


@pytest.mark.parametrize(
    ("points", "colors", "error", "message"),
    [
        (np.zeros((300, 2)), np.zeros((300, 2), np.uint8), ShapeError, r"points_b \(P, 3\)"),
        (np.zeros((300, 3)), np.zeros((299, 3), np.uint8), ShapeError, "a colour for each"),
        (np.zeros((9, 3)), np.zeros((9, 3), np.uint8), InputError, "200 or more"),
        (np.full((300, 3), np.nan), np.zeros((300, 3), np.uint8), InputError, "finite points in points_b"),
    ],
)
def test_bad_clouds_are_refused(points, colors, error, message):
    good = np.zeros((300, 3))
    with pytest.raises(error, match=message):
        drift(good, good.astype(np.uint8), points, colors)

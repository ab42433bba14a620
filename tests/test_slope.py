from __future__ import annotations

import math

import numpy as np
import pytest
import torch

from eaip_prob.errors import ShapeError
from eaip_prob.slope import Slope


def deviations(slope: float, noise: float, groups: int = 12, per_group: int = 9, seed: int = 0) -> list[np.ndarray]:
    """[predicted (groups, samples), true]: people differ in how far their motions move."""
    draw = np.random.default_rng(seed)
    predicted = draw.gamma(3.0, 0.4, (groups, 1)) * draw.normal(size=(groups, per_group))
    return [predicted, slope * predicted + noise * draw.normal(size=predicted.shape)]


def slope_of(predicted: np.ndarray, true: np.ndarray) -> Slope:
    sums = [(predicted * true).sum(1), (predicted**2).sum(1), (true**2).sum(1)]
    return Slope.of(*map(torch.tensor, sums))


@pytest.mark.parametrize("towards", [0.0, 1.0])
@pytest.mark.parametrize(("groups", "variance"), [(2, 9.0), (3, 4.5), (4, 3.0), (12, 11 / 9)])
def test_a_slope_goes_as_far_as_its_gain_is_certain(towards: float, groups: int, variance: float) -> None:
    predicted, true = deviations(0.63, 0.5, groups=groups, seed=3)
    sums = [torch.tensor(part.sum(1)) for part in (predicted * true, predicted**2, true**2)]
    plain, drawn = Slope.of(*sums), Slope.of(*sums, towards=towards)
    gains = [
        float(((one - towards * moved) ** 2 - (one - plain.value * moved) ** 2).sum())
        for moved, one in zip(predicted, true, strict=True)
    ]
    mean = sum(gains) / groups
    error = math.sqrt(sum((gain - mean) ** 2 for gain in gains) / (groups - 1) / groups)
    expected = towards + (plain.value - towards) * mean**2 / (mean**2 + variance * error**2)
    assert (drawn.estimate, drawn.error) == (plain.estimate, plain.error)
    assert drawn.value == pytest.approx(expected, rel=1e-9)
    assert abs(drawn.value - towards) < abs(plain.value - towards)
    left = ((true - expected * predicted) ** 2).sum() / (true**2).sum()
    assert drawn.explained == pytest.approx(1.0 - left, rel=1e-9)


def test_nothing_gained_is_nothing_moved() -> None:
    predicted, true = deviations(1.7, 0.1, groups=6)
    sums = [torch.tensor(part.sum(1)) for part in (predicted * true, predicted**2, true**2)]
    assert Slope.of(*sums, towards=1.0).value == 1.0  # above 1 all is believed
    one = [part[:1] for part in sums]
    assert Slope.of(*one, towards=0.0).value == 0.0


def test_the_best_share_of_a_noisy_gain() -> None:
    truth, draws = 0.5, np.random.default_rng(0).normal(0.5, 0.4, 200_000)
    shares = np.linspace(0.0, 1.5, 301)
    risk = [((share * draws - truth) ** 2).mean() for share in shares]
    assert shares[int(np.argmin(risk))] == pytest.approx(truth**2 / (truth**2 + 0.16), abs=0.02)


def through_origin(predicted: np.ndarray, true: np.ndarray) -> float:
    return float(np.linalg.lstsq(predicted.reshape(-1, 1), true.ravel(), rcond=None)[0][0])


@pytest.mark.parametrize("unit", [1.0, 1000.0])
@pytest.mark.parametrize("seed", [0, 1, 2])
def test_against_regression_and_a_jackknife_loop(seed: int, unit: float) -> None:
    predicted, true = (unit * part for part in deviations(0.63, 0.5, seed=seed))
    came = slope_of(predicted, true)
    expected = through_origin(predicted, true)
    without = []
    for out in range(len(predicted)):
        kept = [i for i in range(len(predicted)) if i != out]
        without.append(through_origin(predicted[kept], true[kept]))
    count = len(without)
    error = math.sqrt((count - 1) / count * sum((one - sum(without) / count) ** 2 for one in without))
    left = ((true - expected * predicted) ** 2).sum()
    assert came.estimate == pytest.approx(expected, rel=1e-10)
    assert came.value == came.estimate
    assert came.error == pytest.approx(error, rel=1e-9)
    assert came.explained == pytest.approx(1.0 - left / (true**2).sum(), rel=1e-9)


def test_the_known_slope_is_found_and_its_error_is_honest() -> None:
    found = [slope_of(*deviations(0.4, 1.0, groups=15, seed=seed)) for seed in range(300)]
    estimates, errors = np.array([one.estimate for one in found]), np.array([one.error for one in found])
    assert abs(estimates.mean() - 0.4) < 3.5 * estimates.std() / len(found) ** 0.5
    assert np.sqrt((errors**2).mean()) == pytest.approx(estimates.std(), rel=0.15)
    assert 0.88 < (np.abs(estimates - 0.4) < 2.0 * errors).mean() <= 0.99


@pytest.mark.parametrize("slope", [-0.8, 0.3, 1.0, 2.4])
def test_the_value_is_the_share_between_none_and_all_that_leaves_least(slope: float) -> None:
    predicted, true = deviations(slope, 0.05)
    came = slope_of(predicted, true)
    left = [((true - share * predicted) ** 2).sum() for share in np.linspace(0.0, 1.0, 1001)]
    assert came.value == pytest.approx(int(np.argmin(left)) / 1000, abs=6e-4)
    assert came.estimate == pytest.approx(slope, abs=0.03)
    assert came.explained == pytest.approx(1.0 - min(left) / (true**2).sum(), abs=1e-5)


@pytest.mark.parametrize(("total", "expected"), [(199.0, 1.0), (201.0, 0.0)])
def test_what_explains_less_than_half_a_percent_is_not_believed(total: float, expected: float) -> None:
    ones = torch.full((4,), 0.25)
    came = Slope.of(ones, ones, total * ones)
    assert came.value == expected and came.estimate == 1.0
    assert came.explained == (pytest.approx(1 / total) if expected else 0.0)


@pytest.mark.parametrize("below", [False, True])
def test_what_lies_below_one_standard_error_is_not_believed(below: bool) -> None:
    # Two groups with slopes 1 +- d: the jackknife's standard error is d.
    apart = 1.02 if below else 0.98
    came = Slope.of(torch.tensor([1.0 + apart, 1.0 - apart]), torch.ones(2), 3.0 * torch.ones(2))
    assert came.error == pytest.approx(apart, rel=1e-6)
    assert came.value == (0.0 if below else 1.0)


def test_degenerate_sums() -> None:
    one = torch.ones(1)
    assert Slope.of(one, one, one) == Slope(0.0, 1.0, math.inf, 0.0)
    still, moving = torch.zeros(3), torch.ones(3)
    assert Slope.of(still, still, moving) == Slope(0.0, 0.0, math.inf, 0.0)
    assert Slope.of(still, moving, still) == Slope(0.0, 0.0, math.inf, 0.0)
    # Only one group is moved: without it there is no slope, so nothing is known of its error.
    alone = Slope.of(torch.tensor([1.0, 0.0]), torch.tensor([1.0, 0.0]), moving[:2])
    assert alone.value == 0.0 and alone.error == math.inf


def test_useless_evidence_is_mostly_closed() -> None:
    closed = [slope_of(*deviations(0.0, 1.0, seed=seed)).value == 0.0 for seed in range(200)]
    # Above one standard error by chance in 16 %; +- 3 standard errors of 200 draws.
    assert np.mean(closed) > 0.84 - 3 * (0.84 * 0.16 / 200) ** 0.5


@pytest.mark.parametrize(
    "sums",
    [(torch.ones(2), torch.ones(3), torch.ones(2)), [torch.ones(2, 2)] * 3, [torch.ones(0)] * 3],
)
def test_sums_of_other_shapes_are_refused(sums: list[torch.Tensor]) -> None:
    with pytest.raises(ShapeError, match=r"three sums with shape \(groups,\), got"):
        Slope.of(*sums)

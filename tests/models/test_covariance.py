from __future__ import annotations

import numpy as np
import pytest
import torch
from scipy.stats import multivariate_normal

from eaip_prob.errors import InputError
from eaip_prob.folds import group_folds
from eaip_prob.models import EmpiricalCovariance, ShrinkageCovariance
from eaip_prob.models.covariance import _AMOUNTS, DEFAULT_AMOUNT, _conditional_log_likelihood, sample_covariance, shrunk

NONE = torch.tensor([], dtype=torch.long)
ROBOT, FEATURES = torch.tensor([2, 5, 6]), torch.tensor([7, 3])


def rows(num: int = 14, columns: int = 8, seed: int = 0, noise: float = 0.3) -> torch.Tensor:
    generator = torch.Generator().manual_seed(seed)
    hidden = torch.randn(num, 3, generator=generator, dtype=torch.float64)
    mixing = torch.randn(3, columns, generator=generator, dtype=torch.float64)
    extra = noise * torch.randn(num, columns, generator=generator, dtype=torch.float64)
    scale = torch.logspace(-2, 3, columns, dtype=torch.float64)
    return (hidden @ mixing + extra + 4.0) * scale


def slow_shrunk(values: np.ndarray, features: list[int], amount: float) -> np.ndarray:
    """Residuals of a least-squares regression on the features, shrunk, plus what the regression explains."""
    centred = values - values.mean(0)
    explained = np.zeros_like(centred)
    if features:
        inputs = centred[:, features]
        explained = inputs @ np.linalg.lstsq(inputs, centred, rcond=1e-10)[0]
    rest = centred - explained
    cov = rest.T @ rest / len(values)
    return explained.T @ explained / len(values) + (1 - amount) * cov + amount * np.diag(np.diag(cov))


def slow_conditional(cov: np.ndarray, deviation: np.ndarray, target: list[int]) -> float:
    given = [i for i in range(len(cov)) if i not in target]
    gain = cov[np.ix_(target, given)] @ np.linalg.inv(cov[np.ix_(given, given)])
    rest = cov[np.ix_(target, target)] - gain @ cov[np.ix_(given, target)]
    rest = 0.5 * (rest + rest.T)
    return sum(multivariate_normal.logpdf(d[target], gain @ d[given], rest) for d in deviation)


def slow_scores(values: torch.Tensor, folds: list[torch.Tensor], features: list[int], target: list[int]) -> list[float]:
    data = (values / values.std(0)).numpy()
    scores = []
    for amount in _AMOUNTS:
        score = 0.0
        for fold in folds:
            train = np.delete(data, fold.numpy(), axis=0)
            held_out = data[fold.numpy()] - train.mean(0)
            score += slow_conditional(slow_shrunk(train, features, amount), held_out, target)
        scores.append(score)
    return scores


def test_empirical_is_divided_by_the_number_of_demonstrations() -> None:
    values = rows()
    estimate = EmpiricalCovariance().estimate(values, [], ROBOT, NONE)
    np.testing.assert_allclose(estimate, np.cov(values.numpy().T, bias=True), rtol=1e-12)


def test_amount_zero_is_the_sample_covariance() -> None:
    values = rows()
    for features in (NONE, FEATURES):
        estimate = ShrinkageCovariance(0.0).estimate(values, [], ROBOT, features)
        scale = values.std(0)
        torch.testing.assert_close(
            estimate / scale / scale[:, None], sample_covariance(values / scale), rtol=0, atol=1e-12
        )


def test_amount_one_without_features_is_diagonal() -> None:
    values = rows()
    estimate = ShrinkageCovariance(1.0).estimate(values, [], ROBOT, NONE)
    torch.testing.assert_close(estimate, torch.diag(values.var(0, correction=0)))


@pytest.mark.parametrize("amount", [0.03, 0.4, 1.0])
@pytest.mark.parametrize("num", [2, 5, 30])
def test_shrunk_is_the_regression_plus_shrunk_residuals(amount: float, num: int) -> None:
    values = rows(num)
    scale = values.std(0)
    estimate = ShrinkageCovariance(amount).estimate(values, [], ROBOT, FEATURES) / scale / scale[:, None]
    expected = slow_shrunk((values / scale).numpy(), FEATURES.tolist(), amount)
    np.testing.assert_allclose(estimate, expected, atol=1e-9)


def test_cross_covariance_with_features_is_kept() -> None:
    values = rows()
    kept = ShrinkageCovariance(0.7).estimate(values, [], ROBOT, FEATURES)[:, FEATURES]
    torch.testing.assert_close(kept, sample_covariance(values)[:, FEATURES], rtol=1e-9, atol=0)


def test_amounts_are_batched() -> None:
    covariance = sample_covariance(rows() / rows().std(0))
    amounts = torch.tensor([[0.1, 0.5, 0.2], [0.0, 1.0, 0.3]], dtype=torch.float64)
    together = shrunk(covariance, FEATURES, amounts)
    assert together.shape == (2, 3, 8, 8)
    for i in range(2):
        for j in range(3):
            torch.testing.assert_close(together[i, j], shrunk(covariance, FEATURES, amounts[i, j]))


@pytest.mark.parametrize("features", [NONE, FEATURES])
@pytest.mark.parametrize("column", [0, 2, 3, 7])
@pytest.mark.parametrize("unit", [1000.0, 1e-7])
def test_units_change_nothing_but_the_units(features: torch.Tensor, column: int, unit: float) -> None:
    values, folds = rows(), group_folds(range(14))
    factor = torch.ones(8, dtype=torch.float64)
    factor[column] = unit
    chosen = [ShrinkageCovariance.chosen_amount(v, folds, ROBOT, features) for v in (values, values * factor)]
    assert chosen[0] == chosen[1]
    before, after = (ShrinkageCovariance().estimate(v, folds, ROBOT, features) for v in (values, values * factor))
    torch.testing.assert_close(after, before * factor * factor[:, None], rtol=1e-8, atol=0)


def test_conditional_likelihood_against_scipy() -> None:
    covariance = torch.from_numpy(np.stack([slow_shrunk(rows(30).numpy() / 100.0, [], a) for a in (0.2, 0.6)]))
    deviation = rows(5, seed=3) / 100.0
    deviation = deviation - deviation.mean(0)
    scale = covariance[0].diagonal().sqrt()
    covariance, deviation = covariance / scale / scale[:, None], deviation / scale
    came = _conditional_log_likelihood(covariance, deviation, 5)
    expected = [slow_conditional(c.numpy(), deviation.numpy(), [5, 6, 7]) for c in covariance]
    np.testing.assert_allclose(came, expected, rtol=1e-9)


@pytest.mark.parametrize(
    ("features", "noise", "num"), [(NONE, 0.3, 14), (FEATURES, 0.3, 14), (FEATURES, 3.0, 8), (NONE, 0.02, 40)]
)
def test_chosen_amount_maximises_the_held_out_likelihood(features: torch.Tensor, noise: float, num: int) -> None:
    values, folds = rows(num, noise=noise), group_folds(range(num))
    scores = slow_scores(values, folds, features.tolist(), ROBOT.tolist())
    assert ShrinkageCovariance.chosen_amount(values, folds, ROBOT, features) == _AMOUNTS[int(np.argmax(scores))]


def test_chosen_amounts_differ_between_problems() -> None:
    chosen = {
        ShrinkageCovariance.chosen_amount(rows(num, noise=noise), group_folds(range(num)), ROBOT, NONE)
        for noise, num in [(0.3, 14), (3.0, 8), (0.02, 40)]
    }
    assert len(chosen) == 3


def test_default_amount_without_folds() -> None:
    values = rows()
    came = ShrinkageCovariance().estimate(values, [], ROBOT, FEATURES)
    torch.testing.assert_close(came, ShrinkageCovariance(DEFAULT_AMOUNT).estimate(values, [], ROBOT, FEATURES))


def test_constant_target_takes_the_default() -> None:
    values = rows()
    values[:, ROBOT] = 2.5
    assert ShrinkageCovariance.chosen_amount(values, group_folds(range(14)), ROBOT, FEATURES) == DEFAULT_AMOUNT


def degenerate(kind: str) -> tuple[torch.Tensor, torch.Tensor]:
    values = rows(10, columns=40 if kind == "few" else 8)
    if kind == "duplicates":
        values = torch.stack([values[0], values[1]]).repeat(5, 1)
    elif kind == "all equal":
        values = values[:1].repeat(10, 1)
    elif kind == "constant columns":
        values[:, [0, 6]] = 0.1
    elif kind == "constant feature":
        values[:, 3] = 0.1
    elif kind == "repeated feature":
        values[:, 3] = 0.5 * values[:, 7] - 3.0
    elif kind == "two":
        values = values[:2]
    elif kind == "constant in one fold":
        values[:, 5] = 1.0
        values[0, 5] = 2.0
    return values, FEATURES


KINDS = [
    "few",
    "duplicates",
    "all equal",
    "constant columns",
    "constant feature",
    "repeated feature",
    "two",
    "constant in one fold",
]


@pytest.mark.parametrize("kind", KINDS)
def test_degenerate_demonstrations_give_a_covariance(kind: str) -> None:
    values, features = degenerate(kind)
    estimate = ShrinkageCovariance().estimate(values, group_folds(range(len(values))), ROBOT, features)
    assert torch.isfinite(estimate).all()
    torch.testing.assert_close(estimate, estimate.mT, rtol=1e-12, atol=1e-15)
    variance = values.var(0, correction=0)
    torch.testing.assert_close(estimate.diagonal(), variance, rtol=1e-8, atol=1e-24)
    scale = torch.where(variance > 1e-20, variance, 1.0).sqrt()
    assert torch.linalg.eigvalsh(estimate / scale / scale[:, None]).min() > -1e-9


@pytest.mark.parametrize("amount", [-0.1, 1.5])
def test_amount_out_of_range(amount: float) -> None:
    with pytest.raises(InputError, match="amount between 0 and 1"):
        ShrinkageCovariance(amount)


def test_demonstrations_are_left_unchanged() -> None:
    values = rows()
    before = values.clone()
    ShrinkageCovariance().estimate(values, group_folds(range(14)), ROBOT, FEATURES)
    assert torch.equal(values, before)

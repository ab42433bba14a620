from __future__ import annotations

import numpy as np
import pytest
import torch
from scipy.stats import multivariate_normal

from eaip_prob.errors import InputError
from eaip_prob.models import EmpiricalCovariance, GaussianJointModel, LowRankCovariance
from eaip_prob.models.low_rank import factor_analysis

NONE = torch.tensor([], dtype=torch.long)
FEATURES = torch.tensor([6, 2])


def rows(num: int = 40, columns: int = 8, rank: int = 3, seed: int = 0) -> torch.Tensor:
    generator = torch.Generator().manual_seed(seed)
    hidden = torch.randn(num, rank, generator=generator, dtype=torch.float64)
    mixing = torch.randn(rank, columns, generator=generator, dtype=torch.float64)
    own = 0.6 * torch.randn(num, columns, generator=generator, dtype=torch.float64)
    return (hidden @ mixing + own + 4.0) * torch.logspace(-2, 3, columns, dtype=torch.float64)


def standardised(values: torch.Tensor) -> torch.Tensor:
    centred = values - values.mean(0)
    return centred / centred.square().mean(0).sqrt()


def slow_em(data: np.ndarray, rank: int, least: float, rounds: int) -> tuple[np.ndarray, np.ndarray, list[float]]:
    """One demonstration at a time, with the factors' posterior from the dense covariance; starts on principal axes."""
    num, size = data.shape
    sample = data.T @ data / num
    values, axes = np.linalg.eigh(sample)
    values, axes = values[::-1], axes[:, ::-1]
    left = values[rank:].sum() / (size - rank)
    loading = axes[:, :rank] * np.sqrt(np.maximum(values[:rank] - left, least * values[0]))
    own = np.maximum(np.diag(sample) - (loading**2).sum(1), least)
    likelihoods = []
    for _ in range(rounds):
        dense = loading @ loading.T + np.diag(own)
        likelihoods.append(multivariate_normal.logpdf(data, cov=dense).mean())
        gain = loading.T @ np.linalg.inv(dense)
        first, second, cross = [], np.zeros((rank, rank)), np.zeros((size, rank))
        for row in data:
            factors = gain @ row
            first.append(factors)
            second += np.eye(rank) - gain @ loading + np.outer(factors, factors)
            cross += np.outer(row, factors)
        loading = cross @ np.linalg.inv(second)
        predicted = np.stack(first) @ loading.T
        own = np.maximum((data**2).mean(0) - (predicted * data).mean(0), least)
    return loading, own, likelihoods


@pytest.mark.parametrize(("num", "columns", "rank"), [(40, 8, 2), (6, 12, 3), (9, 5, 1)])
@pytest.mark.parametrize("rounds", [1, 7])
def test_em_against_a_slow_loop(num: int, columns: int, rank: int, rounds: int) -> None:
    data = standardised(rows(num, columns))
    loading, own = factor_analysis(data, rank, 0.02, 1e-300, rounds)
    expected, left, _ = slow_em(data.numpy(), rank, 0.02, rounds)
    np.testing.assert_allclose(loading @ loading.mT, expected @ expected.T, atol=1e-9)
    np.testing.assert_allclose(own, left, rtol=1e-8)


@pytest.mark.parametrize(("num", "columns", "rank"), [(40, 8, 2), (6, 12, 3)])
def test_the_likelihood_never_falls_and_em_stops_where_it_no_longer_grows(num: int, columns: int, rank: int) -> None:
    data = standardised(rows(num, columns))
    seen = []
    for rounds in range(1, 40):
        loading, own = factor_analysis(data, rank, 1e-3, 1e-300, rounds)
        dense = loading @ loading.mT + torch.diag(own)
        seen.append(multivariate_normal.logpdf(data.numpy(), cov=dense.numpy()).mean())
    growth = np.diff(seen)
    assert growth.min() > -1e-10
    assert growth[0] > 1e-2
    tolerance = float(np.sqrt(growth[10] * growth[11]))
    stopped, _ = factor_analysis(data, rank, 1e-3, tolerance)
    last, _ = factor_analysis(data, rank, 1e-3, 1e-300, int((growth >= tolerance).argmin()) + 2)
    torch.testing.assert_close(stopped, last, rtol=0, atol=0)


@pytest.mark.parametrize("rank", [1, 2])
def test_the_maximum_meets_its_equations(rank: int) -> None:
    data = standardised(rows(60, 8, 2))
    loading, own = factor_analysis(data, rank, 1e-3, 1e-13, 20_000)
    assert float(own.min()) > 2e-3
    dense, sample = (loading @ loading.mT + torch.diag(own)).numpy(), (data.mT @ data / len(data)).numpy()
    np.testing.assert_allclose(np.diag(dense), np.diag(sample), atol=1e-5)
    np.testing.assert_allclose(sample @ np.linalg.inv(dense) @ loading.numpy(), loading, atol=1e-5)


def test_a_known_factor_model_is_recovered() -> None:
    num, size, rank = 20_000, 7, 2
    generator = torch.Generator().manual_seed(4)
    loading = torch.randn(size, rank, generator=generator, dtype=torch.float64)
    own = 0.2 + torch.rand(size, generator=generator, dtype=torch.float64)
    truth = loading @ loading.mT + torch.diag(own)
    values = torch.randn(num, rank, generator=generator, dtype=torch.float64) @ loading.mT
    values = values + torch.randn(num, size, generator=generator, dtype=torch.float64) * own.sqrt() + 3.0
    came = LowRankCovariance(rank, tolerance=1e-9, max_rounds=2000).estimate(values, [], NONE, NONE)
    # The factor model is the truth, so that its estimate errs no more than the sample covariance does.
    spread = truth.diagonal()
    error = ((spread[:, None] * spread + truth.square()) / num).sqrt()
    assert float(((came - truth).abs() / error).max()) < 4.5


@pytest.mark.parametrize("features", [NONE, FEATURES])
@pytest.mark.parametrize("column", [0, 2, 5])
def test_units_of_one_weight(column: int, features: torch.Tensor) -> None:
    values, units = rows(), torch.ones(8, dtype=torch.float64)
    units[column] = 1000.0
    estimator = LowRankCovariance(2)
    before = estimator.estimate(values, [], NONE, features)
    after = estimator.estimate(values * units, [], NONE, features)
    scale = before.diagonal().sqrt()
    torch.testing.assert_close(
        after / units / units[:, None] / scale / scale[:, None], before / scale / scale[:, None], rtol=0, atol=1e-9
    )


def test_features_are_regressed_on_and_the_rest_has_factors() -> None:
    values = rows(30)
    came = LowRankCovariance(2, tolerance=1e-8).estimate(values, [], NONE, FEATURES)
    sample = EmpiricalCovariance().estimate(values, [], NONE, FEATURES)
    scale = sample.diagonal().sqrt()
    correlation, plain = came / scale / scale[:, None], sample / scale / scale[:, None]
    torch.testing.assert_close(correlation[FEATURES], plain[FEATURES], rtol=0, atol=1e-10)
    centred = (values - values.mean(0)).numpy()
    inputs, others = centred[:, FEATURES], [0, 1, 3, 4, 5, 7]
    slope = np.linalg.lstsq(inputs, centred, rcond=None)[0]
    rest = centred - inputs @ slope
    explained = slope.T @ (inputs.T @ inputs / 30) @ slope
    size = np.sqrt((rest[:, others] ** 2).mean(0))
    loading, own = factor_analysis(torch.from_numpy(rest[:, others] / size), 2, tolerance=1e-8)
    expected = (loading @ loading.mT + torch.diag(own)).numpy() * size * size[:, None] + explained[
        np.ix_(others, others)
    ]
    lengths = np.sqrt(np.diag(expected))
    np.testing.assert_allclose(
        came.numpy()[np.ix_(others, others)] / lengths / lengths[:, None],
        expected / lengths / lengths[:, None],
        atol=1e-9,
    )


@pytest.mark.parametrize("num", [2, 3, 5])
def test_the_rank_is_capped_below_the_number_of_demonstrations(num: int) -> None:
    values = rows(num)
    came = LowRankCovariance(16).estimate(values, [], NONE, NONE)
    torch.testing.assert_close(came, LowRankCovariance(num - 1).estimate(values, [], NONE, NONE), rtol=0, atol=0)
    scale = came.diagonal().sqrt()
    assert float(torch.linalg.eigvalsh(came / scale / scale[:, None]).min()) > 5e-4


def test_weights_that_do_not_vary_or_follow_the_features() -> None:
    values = rows(12)
    values[:, 0] = 3.0
    values[:, 1] = 2.0 * values[:, 6] - 5.0 * values[:, 2]
    came = LowRankCovariance(2).estimate(values, [], NONE, FEATURES)
    assert float(came[0].abs().max()) < 1e-12
    torch.testing.assert_close(came[1, 1], values[:, 1].var(correction=0), rtol=1e-9, atol=0)
    assert bool(torch.isfinite(came).all())
    only = torch.arange(8)
    torch.testing.assert_close(
        LowRankCovariance(2).estimate(values[:, 1:2].expand(-1, 8), [], NONE, only),
        EmpiricalCovariance().estimate(values[:, 1:2].expand(-1, 8), [], NONE, only),
        rtol=1e-9,
        atol=0,
    )


def test_alone_it_takes_the_middle_rank() -> None:
    values = rows()
    plain = LowRankCovariance().estimate(values, [], NONE, NONE)
    assert torch.equal(plain, LowRankCovariance(4).estimate(values, [], NONE, NONE))
    ranks = [model.covariance for model in GaussianJointModel(LowRankCovariance(least_share=0.05)).candidates()]
    assert ranks == [LowRankCovariance(rank, 0.05) for rank in (1, 2, 4, 8, 16)]
    assert ranks[len(ranks) // 2] == LowRankCovariance(4, 0.05)
    assert LowRankCovariance(3).candidates() == (LowRankCovariance(3),)


def test_two_estimates_are_the_same_and_change_nothing() -> None:
    values = rows()
    before = values.clone()
    one, other = (LowRankCovariance(3).estimate(values, [], NONE, FEATURES) for _ in range(2))
    assert torch.equal(one, other)
    assert torch.equal(values, before)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"rank": 0}, "rank of at least 1"),
        ({"least_share": 0.0}, "above 0"),
        ({"least_share": 1.5}, "least_share"),
        ({"tolerance": 0.0}, "above 0"),
        ({"max_rounds": 0}, "above 0"),
    ],
)
def test_input_that_cannot_be_used(arguments: dict[str, float], message: str) -> None:
    with pytest.raises(InputError, match=message):
        LowRankCovariance(**arguments)

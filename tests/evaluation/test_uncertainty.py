from __future__ import annotations

import math

import numpy as np
import pytest
import torch
from scipy import optimize, stats
from torch import Tensor

from eaip_prob.errors import InputError
from eaip_prob.evaluation import coverage, interval, mixture_interval, mixture_pit, mixture_quantile, pit

LEVELS = [0.025, 0.3, 0.5, 0.95]


def mixture(batch: tuple[int, ...], num_components: int = 4) -> tuple[Tensor, Tensor, Tensor]:
    g = torch.Generator().manual_seed(11)
    shape = (*batch, num_components, 3, 2)
    means = torch.randn(shape, generator=g, dtype=torch.float64) * 20.0 - 100.0
    variances = torch.rand(shape, generator=g, dtype=torch.float64) * 16.0 + 0.01
    return means, variances, torch.randn(shape[:-2], generator=g, dtype=torch.float64) * 2.0 + 300.0


def gaussian_draws(count: int = 20_000) -> tuple[Tensor, Tensor, Tensor]:
    g = torch.Generator().manual_seed(12)
    mean = torch.rand(count, 1, 1, generator=g, dtype=torch.float64) * 100.0
    variance = torch.rand(count, 1, 1, generator=g, dtype=torch.float64) * 30.0 + 0.1
    return mean, variance, mean + variance.sqrt() * torch.randn(mean.shape, generator=g, dtype=torch.float64)


def mixture_draws(count: int = 20_000) -> tuple[Tensor, Tensor, Tensor, Tensor]:
    g = torch.Generator().manual_seed(13)
    means = torch.randn(count, 3, 1, 1, generator=g, dtype=torch.float64) * 5.0
    variances = torch.rand(count, 3, 1, 1, generator=g, dtype=torch.float64) * 4.0 + 0.1
    log_weight = torch.randn(count, 3, generator=g, dtype=torch.float64)
    chosen = torch.multinomial(log_weight.softmax(-1), 1, generator=g)[..., None, None]
    noise = torch.randn(count, 1, 1, generator=g, dtype=torch.float64)
    truth = means.gather(1, chosen)[:, 0] + variances.gather(1, chosen)[:, 0].sqrt() * noise
    return means, variances, log_weight, truth


@pytest.mark.parametrize("level", [0.5, 0.9])
def test_true_gaussian_is_covered_at_the_nominal_rate(level: float) -> None:
    mean, variance, truth = gaussian_draws()
    inside = coverage(*interval(mean, variance, level), truth, truth > -math.inf)
    assert abs(float(inside.mean()) - level) < 4 * math.sqrt(level * (1 - level) / len(truth))


@pytest.mark.parametrize("level", [0.5, 0.9])
def test_true_mixture_is_covered_at_the_nominal_rate(level: float) -> None:
    means, variances, log_weight, truth = mixture_draws()
    inside = coverage(*mixture_interval(means, variances, log_weight, level), truth, truth > -math.inf)
    assert abs(float(inside.mean()) - level) < 4 * math.sqrt(level * (1 - level) / len(truth))


def test_pit_of_true_models_is_uniform() -> None:
    mean, variance, truth = gaussian_draws()
    means, variances, log_weight, mixed = mixture_draws()
    for sample in (pit(mean, variance, truth), mixture_pit(means, variances, log_weight, mixed)):
        assert stats.kstest(sample.flatten().numpy(), "uniform").pvalue > 1e-4
    # The test has the power to see a deviation 5 % too small.
    assert stats.kstest(pit(mean, 0.9 * variance, truth).flatten().numpy(), "uniform").pvalue < 1e-3


def test_interval_and_pit_equal_scipy() -> None:
    mean, variance, truth = gaussian_draws(50)
    low, high = interval(mean, variance, 0.8)
    normal = stats.norm(mean.numpy(), variance.sqrt().numpy())
    np.testing.assert_allclose(np.stack([low, high]), np.stack(normal.interval(0.8)), rtol=1e-12)
    np.testing.assert_allclose(pit(mean, variance, truth), normal.cdf(truth.numpy()), rtol=1e-11)


def scipy_cdf(value: float, means: Tensor, variances: Tensor, log_weight: Tensor) -> float:
    return float(log_weight.softmax(-1).numpy() @ stats.norm.cdf(value, means.numpy(), variances.sqrt().numpy()))


@pytest.mark.parametrize("level", LEVELS)
@pytest.mark.parametrize("batch", [(), (2, 3)])
def test_mixture_quantile_equals_brentq(batch: tuple[int, ...], level: float) -> None:
    means, variances, log_weight = mixture(batch)
    quantile = mixture_quantile(means, variances, log_weight, level)
    assert quantile.shape == (*batch, 3, 2)
    members = [()] if not batch else [(0, 1), (1, 2)]
    for index in members:
        for t, d in [(0, 0), (2, 1)]:
            part = means[index][:, t, d], variances[index][:, t, d], log_weight[index]
            expected = optimize.brentq(lambda x, part=part: scipy_cdf(x, *part) - level, -400.0, 200.0, xtol=1e-12)
            assert float(quantile[(*index, t, d)]) == pytest.approx(expected, abs=1e-9)
            value = scipy_cdf(-95.0, *part)
            assert float(mixture_pit(*mixture(batch), quantile * 0.0 - 95.0)[(*index, t, d)]) == pytest.approx(value)


@pytest.mark.parametrize("level", LEVELS)
def test_one_component_is_exact(level: float) -> None:
    means, variances, log_weight = mixture((2, 3), num_components=1)
    z = torch.special.ndtri(torch.tensor(level, dtype=torch.float64))
    expected = means[..., 0, :, :] + variances[..., 0, :, :].sqrt() * z
    assert torch.equal(mixture_quantile(means, variances, log_weight, level), expected)
    torch.testing.assert_close(
        mixture_pit(means, variances, log_weight, expected), torch.full_like(expected, level), rtol=1e-12, atol=0.0
    )


def test_pit_inverts_quantile_and_ignores_weightless_component() -> None:
    means, variances, log_weight = mixture((2,))
    means[:, 1], variances[:, 1] = 1e12, math.nan
    log_weight[:, 1] = -math.inf
    quantile = mixture_quantile(means, variances, log_weight, 0.2)
    kept = [0, 2, 3]
    expected = mixture_quantile(means[:, kept], variances[:, kept], log_weight[:, kept], 0.2)
    torch.testing.assert_close(quantile, expected, rtol=1e-12, atol=0.0)
    torch.testing.assert_close(
        mixture_pit(means, variances, log_weight, quantile), torch.full_like(quantile, 0.2), rtol=1e-9, atol=0.0
    )


def test_certain_components_are_steps() -> None:
    means = torch.tensor([[[1.0]], [[5.0]]], dtype=torch.float64)
    zero, log_weight = torch.zeros_like(means), torch.tensor([0.25, 0.75], dtype=torch.float64).log()
    assert float(mixture_quantile(means, zero, log_weight, 0.2)) == pytest.approx(1.0)
    assert float(mixture_quantile(means, zero, log_weight, 0.3)) == pytest.approx(5.0)
    assert mixture_pit(means, zero, log_weight, torch.tensor([[1.0]], dtype=torch.float64)).item() == pytest.approx(
        0.25
    )


def test_coverage_counts_scored_samples_only() -> None:
    truth = torch.tensor([[[0.0], [5.0], [1.0], [math.nan]]], dtype=torch.float64)
    mask = torch.tensor([[True, True, True, False]])
    low, high = torch.full_like(truth, -1.0), torch.ones_like(truth)
    low[..., 3, :] = math.nan
    assert coverage(low, high, truth, mask).tolist() == pytest.approx([2 / 3])
    with pytest.raises(InputError, match="lower <= upper"):
        coverage(high, low, truth, mask)


@pytest.mark.parametrize("level", [0.0, 1.0, 90.0])
def test_levels_are_fractions(level: float) -> None:
    means, variances, log_weight = mixture(())
    with pytest.raises(InputError, match="level above 0 and below 1"):
        mixture_quantile(means, variances, log_weight, level)
    with pytest.raises(InputError, match="level above 0 and below 1"):
        interval(means, variances, level)


def test_negative_variance_is_refused() -> None:
    means, variances, log_weight = mixture(())
    with pytest.raises(InputError, match="variances of zero or more"):
        mixture_pit(means, -variances, log_weight, means[0])
    with pytest.raises(InputError, match="variance of zero or more"):
        interval(means, -variances, 0.9)

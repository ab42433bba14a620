from __future__ import annotations

import math

import pytest
import torch
from scipy import stats

from eaip_prob.errors import InputError, ShapeError
from eaip_prob.evaluation import bootstrap_gain, paired_gain, success_share


def people(num_groups: int, sizes: tuple[int, ...], seed: int, gain: float = 2.0) -> tuple[torch.Tensor, ...]:
    g = torch.Generator().manual_seed(seed)
    groups = torch.cat([torch.full((sizes[i % len(sizes)],), 7 * i + 3) for i in range(num_groups)])
    person = 4.0 * torch.randn(num_groups, generator=g, dtype=torch.float64)
    within = 0.5 * torch.randn(len(groups), generator=g, dtype=torch.float64)
    method = 50.0 + 5.0 * torch.randn(len(groups), generator=g, dtype=torch.float64)
    shift = torch.cat([person[i].expand(sizes[i % len(sizes)]) for i in range(num_groups)])
    order = torch.randperm(len(groups), generator=g)
    return (method + gain + shift + within)[order], method[order], groups[order]


def test_interval_equals_scipy_on_group_means() -> None:
    baseline, method, groups = people(8, (1, 9, 3), seed=0)
    gain = paired_gain(baseline, method, groups, level=0.9)
    means = [float((baseline - method)[groups == label].mean()) for label in groups.unique()]
    expected = stats.ttest_1samp(means, 0.0).confidence_interval(0.9)
    assert gain.num_groups == 8
    assert gain.mean == pytest.approx(sum(means) / 8)
    assert (gain.low, gain.high) == pytest.approx((expected.low, expected.high))


def test_interval_covers_at_its_nominal_rate() -> None:
    num_trials, level = 1_200, 0.9
    hits = 0
    for seed in range(num_trials):
        gain = paired_gain(*people(5, (2, 6), seed=seed, gain=1.5), level=level)
        hits += gain.low <= 1.5 <= gain.high
    assert abs(hits / num_trials - level) < 4 * math.sqrt(level * (1 - level) / num_trials)


def test_bootstrap_agrees_with_many_groups() -> None:
    baseline, method, groups = people(150, (2, 5), seed=3)
    exact = paired_gain(baseline, method, groups)
    drawn = bootstrap_gain(baseline, method, groups, torch.Generator().manual_seed(4))
    width = exact.high - exact.low
    assert drawn.mean == exact.mean
    assert abs(drawn.low - exact.low) < 0.05 * width
    assert abs(drawn.high - exact.high) < 0.05 * width
    assert drawn == bootstrap_gain(baseline, method, groups, torch.Generator().manual_seed(4))


def test_sign_says_who_is_better() -> None:
    baseline, method = torch.tensor([5.0, 5.1, 4.9]), torch.tensor([1.0, 1.1, 0.8])
    assert paired_gain(baseline, method, "abc").low > 0
    assert paired_gain(method, baseline, "abc").high < 0
    assert not paired_gain(baseline, method, "abc").holds_zero
    assert paired_gain(baseline, baseline, "abc").holds_zero


def test_one_group_leaves_everything_open() -> None:
    baseline, method = torch.tensor([5.0, 6.0]), torch.tensor([1.0, 1.0])
    for gain in (
        paired_gain(baseline, method, ["ann", "ann"]),
        bootstrap_gain(baseline, method, ["ann", "ann"], torch.Generator()),
    ):
        assert (gain.mean, gain.low, gain.high, gain.num_groups) == (4.5, -math.inf, math.inf, 1)
        assert gain.holds_zero


def test_bad_errors_are_refused() -> None:
    error = torch.tensor([1.0, 2.0])
    with pytest.raises(InputError, match="method_error"):
        paired_gain(error, torch.tensor([1.0, math.nan]), [0, 1])
    with pytest.raises(ShapeError, match=r"one shape \(N,\)"):
        paired_gain(error, torch.tensor([1.0]), [0, 1])
    with pytest.raises(ShapeError, match="one group per motion"):
        paired_gain(error, error, [0, 1, 2])
    with pytest.raises(InputError, match="level"):
        paired_gain(error, error, [0, 1], level=95)


@pytest.mark.parametrize(("successes", "trials"), [(0, 7), (3, 11), (8, 8), (61, 400)])
@pytest.mark.parametrize("level", [0.9, 0.95])
def test_share_equals_scipy_wilson(successes: int, trials: int, level: float) -> None:
    result = success_share(successes, trials, level)
    expected = stats.binomtest(successes, trials).proportion_ci(level, method="wilson")
    assert result.share == successes / trials
    assert (result.low, result.high) == pytest.approx((expected.low, expected.high), abs=1e-12)


def test_share_refuses_impossible_counts() -> None:
    for successes, trials in [(0, 0), (3, 2), (-1, 4)]:
        with pytest.raises(InputError, match="num_successes"):
            success_share(successes, trials)

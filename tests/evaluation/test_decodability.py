from __future__ import annotations

import numpy as np
import pytest
import torch

from eaip_prob.errors import InputError, ShapeError
from eaip_prob.evaluation import explained
from eaip_prob.evaluation.decodability import RIDGES


def reaches(
    num_groups: int = 6, size: int = 5, num_inputs: int = 4, noise: float = 0.3, seed: int = 0
) -> tuple[torch.Tensor, torch.Tensor, torch.Tensor]:
    g = torch.Generator().manual_seed(seed)
    groups = torch.arange(num_groups).repeat_interleave(size)
    beginnings = torch.randn(len(groups), num_inputs, generator=g, dtype=torch.float64) * 30.0 + 200.0
    weights = torch.randn(num_inputs, 2, generator=g, dtype=torch.float64)
    unrelated = torch.randn(num_groups, 1, generator=g, dtype=torch.float64)[groups]
    related = beginnings @ weights
    related = related + noise * related.std(0) * torch.randn(related.shape, generator=g, dtype=torch.float64)
    order = torch.randperm(len(groups), generator=g)
    return torch.cat([related, unrelated], -1)[order], beginnings[order], groups[order]


def numpy_ridge(x: np.ndarray, y: np.ndarray, query: np.ndarray, ridge: float) -> np.ndarray:
    centre, scale = x.mean(0), x.std(0)
    known = (x - centre) / scale
    rows = np.vstack([known / np.sqrt(len(x)), np.sqrt(ridge * x.shape[1]) * np.eye(x.shape[1])])
    right = np.concatenate([(y - y.mean()) / np.sqrt(len(x)), np.zeros(x.shape[1])])
    return y.mean() + (query - centre) / scale @ np.linalg.lstsq(rows, right, rcond=None)[0]


def slow_explained(y: np.ndarray, x: np.ndarray, groups: np.ndarray) -> float:
    predicted = np.empty_like(y)
    for held in np.unique(groups):
        rest = groups != held
        errors = []
        for ridge in RIDGES:
            error = 0.0
            for inner in np.unique(groups[rest]):
                fit, out = rest & (groups != inner), groups == inner
                error += ((numpy_ridge(x[fit], y[fit], x[out], ridge) - y[out]) ** 2).sum()
            errors.append(error)
        predicted[~rest] = numpy_ridge(x[rest], y[rest], x[~rest], RIDGES[int(np.argmin(errors))])
    return 1.0 - ((y - predicted) ** 2).sum() / ((y - y.mean()) ** 2).sum()


@pytest.mark.parametrize("num_inputs", [4, 31])
def test_equals_slow_loop_on_both_sides_of_the_dual(num_inputs: int) -> None:
    features, beginnings, groups = reaches(num_groups=4, size=4, num_inputs=num_inputs)
    score = explained(features, beginnings, groups)
    for feature in range(3):
        expected = slow_explained(features[:, feature].numpy(), beginnings.numpy(), groups.numpy())
        assert float(score[feature]) == pytest.approx(expected, rel=1e-6, abs=1e-8)


def test_share_of_noise_is_the_share_not_explained() -> None:
    features, beginnings, groups = reaches(num_groups=30, size=8, noise=0.5)
    score = explained(features, beginnings, groups)
    expected = 1.0 / (1.0 + 0.5**2)
    assert torch.allclose(score[:2], torch.tensor(expected, dtype=torch.float64), atol=0.1)
    assert -0.3 < float(score[2]) < 0.05


def test_memory_of_a_group_does_not_count() -> None:
    # Each group has its own place and its own feature, without relation: only seen groups could be told apart.
    features, _, groups = reaches(num_groups=8, size=6)
    places = torch.randn(8, 12, generator=torch.Generator().manual_seed(5), dtype=torch.float64)[groups]
    beginnings = places + 0.01 * torch.randn(places.shape, generator=torch.Generator().manual_seed(6))
    assert float(explained(features[:, 2:], beginnings, groups)) < 0.1
    assert float(explained(features[:, 2:], beginnings, torch.arange(len(groups)))) > 0.9


def test_units_and_constant_inputs_do_not_matter() -> None:
    features, beginnings, groups = reaches()
    score = explained(features, beginnings, groups)
    scaled = explained(
        features * torch.tensor([1e3, 1e-3, 7.0]), beginnings * torch.tensor([1e3, 1.0, 1e-4, 2.0]) - 5.0, groups
    )
    torch.testing.assert_close(score, scaled, rtol=1e-6, atol=1e-8)
    constant = torch.cat([beginnings, torch.full_like(beginnings[:, :1], 0.1)], -1)
    amounts = [ridge * 5 / 4 for ridge in RIDGES]
    padded = explained(features, constant, groups, ridges=RIDGES)
    torch.testing.assert_close(padded, explained(features, beginnings, groups, ridges=amounts), rtol=1e-6, atol=1e-8)


def test_string_groups_equal_numbers() -> None:
    features, beginnings, groups = reaches()
    names = [f"box {int(label)}" for label in groups]
    assert torch.equal(explained(features, beginnings, groups), explained(features, beginnings, names))


def test_bad_input_is_refused() -> None:
    features, beginnings, groups = reaches()
    with pytest.raises(InputError, match="at least 3 groups, .* got 2"):
        explained(features, beginnings, groups % 2)
    with pytest.raises(InputError, match="feature 1 is constant"):
        explained(torch.stack([features[:, 0], torch.ones(30)], -1), beginnings, groups)
    with pytest.raises(InputError, match="finite numbers in beginnings"):
        explained(features, beginnings * torch.nan, groups)
    with pytest.raises(ShapeError, match="beginnings"):
        explained(features, beginnings[:5], groups)
    with pytest.raises(InputError, match="ridges above zero"):
        explained(features, beginnings, groups, ridges=[0.0])

from __future__ import annotations

import numpy as np
import pytest
import torch

from eaip_prob.errors import InputError, ShapeError
from eaip_prob.primitives.least_squares import mean_power, ridge_fit

T, B, D = 17, 5, 3


def draw(seed, *shape):
    return torch.randn(*shape, generator=torch.Generator().manual_seed(seed), dtype=torch.float64)


def coin(seed, *shape):
    return torch.rand(*shape, generator=torch.Generator().manual_seed(seed)) > 0.3


RIDGE = torch.tensor([1e-3, 0.2, 1e-6, 3e-3, 1e-2], dtype=torch.float64)


def slow_fit(design, values, mask, ridge, rest=None):
    """One motion, one signal, by numpy's least squares on rows stacked with the ridge."""
    a, y = design.numpy()[mask.numpy()], values.numpy()[mask.numpy()]
    mean = 0.0 if rest is None else y.mean()
    root = ridge.sqrt().numpy()
    rows = np.concatenate([a / np.sqrt(len(y)), np.diag(root)])
    target = np.concatenate([(y - mean) / np.sqrt(len(y)), np.zeros(len(root))])
    weights = np.linalg.lstsq(rows, target, rcond=None)[0]
    return torch.from_numpy(weights + (0.0 if rest is None else mean * rest.numpy()))


@pytest.mark.parametrize("batch", [(), (4,), (2, 3)])
@pytest.mark.parametrize("own_design", [False, True])
@pytest.mark.parametrize("masked", ["no", "together", "apart"])
@pytest.mark.parametrize("with_rest", [False, True])
def test_equals_a_loop_of_numpys_least_squares(batch, own_design, masked, with_rest):
    design = draw(0, *(batch if own_design else ()), T, B)
    values = 300.0 + 20.0 * draw(1, *batch, T, D)
    mask = {
        "no": torch.ones_like(values, dtype=torch.bool),
        "together": coin(2, *batch, T, 1),
        "apart": coin(2, *batch, T, D),
    }[masked]
    mask = mask.expand_as(values)
    rest = draw(3, B) if with_rest else None
    got = ridge_fit(design, values, mask, RIDGE, rest)
    assert got.shape == (*batch, D, B)
    for index in np.ndindex(*batch):
        for d in range(D):
            one = design[index] if own_design else design
            slow = slow_fit(one, values[index][:, d], mask[index][:, d], RIDGE, rest)
            assert torch.allclose(got[index][d], slow, rtol=1e-9, atol=1e-9)


@pytest.mark.parametrize("masked", [False, True])
def test_values_under_the_mask_are_never_read(masked):
    values, mask = draw(1, 2, T, D), coin(2, 2, T, D if masked else 1).expand(2, T, D)
    spoilt = torch.where(mask, values, torch.nan)
    assert torch.equal(ridge_fit(draw(0, T, B), values, mask, RIDGE), ridge_fit(draw(0, T, B), spoilt, mask, RIDGE))


@pytest.mark.parametrize("masked", [False, True])
def test_fit_follows_units_and_with_rest_the_origin(masked):
    design = torch.softmax(3 * draw(0, T, B), -1)
    values, mask = draw(1, 4, T, D), (coin(2, 4, T, D) if masked else torch.ones(4, T, D, dtype=torch.bool))
    rest = torch.ones(B, dtype=torch.float64)
    units, origin = torch.tensor([1000.0, 1.0, 0.001]).double(), torch.tensor([0.0, 500.0, -7.0]).double()
    weights = ridge_fit(design, values, mask, RIDGE, rest)
    changed = ridge_fit(design, units * values + origin, mask, RIDGE, rest)
    assert torch.allclose(changed, weights * units[:, None] + origin[:, None], rtol=1e-10, atol=1e-10)


def test_a_ridge_by_mean_power_does_not_depend_on_the_scale_of_a_basis():
    design, values = draw(0, T, B), draw(1, T, D)
    scaled = design * torch.tensor([1.0, 1e3, 1e-3, 1.0, 50.0], dtype=torch.float64)
    mask = torch.ones_like(values, dtype=torch.bool)
    one, other = (ridge_fit(a, values, mask, 1e-2 * mean_power(a)) for a in (design, scaled))
    assert torch.allclose(other @ scaled.mT, one @ design.mT, rtol=1e-7)


def test_a_signal_without_any_sample_is_named():
    values, mask = draw(1, 2, T, D), torch.ones(2, T, D, dtype=torch.bool)
    mask[1, :, 2] = False
    with pytest.raises(InputError, match=r"got none for \(motion.., signal\) \(1, 2\)"):
        ridge_fit(draw(0, T, B), values, mask, RIDGE)


def test_another_number_of_samples_is_refused():
    with pytest.raises(ShapeError, match="got 17 phases for 16 samples"):
        ridge_fit(draw(0, T, B), draw(1, T - 1, D), torch.ones(T - 1, D, dtype=torch.bool), RIDGE)

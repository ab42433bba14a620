from __future__ import annotations

import numpy as np
import pytest
import torch
from scipy.stats import multivariate_normal
from torch import Tensor

from eaip_prob.conditioning import Information
from eaip_prob.errors import EaipError, InputError, ShapeError
from eaip_prob.observation import LinearObservation, SharedDesignObservation

D, T, B = 3, 7, 4
NAN = float("nan")


def randn(*shape: int, seed: int = 0) -> Tensor:
    return torch.randn(*shape, generator=torch.Generator().manual_seed(seed), dtype=torch.float64)


def positive(*shape: int, seed: int = 0) -> Tensor:
    return 0.1 + randn(*shape, seed=seed).square()


def covariances(*shape: int, seed: int = 0) -> Tensor:
    rows = randn(*shape, T, 2 * T, seed=seed)
    return rows @ rows.mT / T + 0.1 * torch.eye(T, dtype=torch.float64)


def dense_precision(information: Information) -> Tensor:
    blocks = information.precision
    size = information.shift.shape[-1] // blocks.shape[-1]
    blocks = blocks.expand(*blocks.shape[:-3], size, *blocks.shape[-2:])
    flat = blocks.reshape(-1, *blocks.shape[-3:])
    whole = torch.stack([torch.block_diag(*member) for member in flat])
    return whole.reshape(*blocks.shape[:-3], *whole.shape[-2:])


def some_mask(*batch: int) -> Tensor:
    mask = torch.rand(*batch, D, T, generator=torch.Generator().manual_seed(5)) > 0.4
    mask[..., 1, :] = False
    return mask


MASKS = {
    "none": None,
    "all": torch.ones(D, T, dtype=torch.bool),
    "some": some_mask(),
    "signals": torch.tensor([[True], [False], [True]]),
    "samples": torch.tensor([[True, False, True, True, False, True, True]]),
    "batch": some_mask(2, 3),
}
NOISES = {
    "each": (positive(D, T), False),
    "signal": (positive(D, 1), False),
    "time": (positive(1, T), False),
    "one": (positive(1, 1), False),
    "batch": (positive(2, 3, D, T), False),
    "correlated": (covariances(D), True),
    "correlated shared": (covariances(1), True),
    "correlated batch": (covariances(2, 3, D), True),
}


@pytest.mark.parametrize("noise", NOISES)
@pytest.mark.parametrize("mask", MASKS)
@pytest.mark.parametrize("batch", [(), (2, 3)])
def test_shared_design_equals_its_written_rows(noise: str, mask: str, batch: tuple[int, ...]) -> None:
    design, offset, mean = randn(*batch, T, B), 10 + randn(*batch, 1, T), randn(D * B, seed=4)
    variance, correlated = NOISES[noise]
    value = 10 + randn(*batch, D, T, seed=1)
    shared = SharedDesignObservation("human", design, offset, value, variance, MASKS[mask], correlated)
    left, right = shared.information({"human": mean}), shared.dense().information({"human": mean})
    assert left is not None and right is not None
    for one, two in ((dense_precision(left), dense_precision(right)), (left.shift, right.shift)):
        torch.testing.assert_close(*torch.broadcast_tensors(one, two), rtol=1e-9, atol=1e-9)
    torch.testing.assert_close(*torch.broadcast_tensors(left.log_scale, right.log_scale), rtol=1e-10, atol=1e-10)


@pytest.mark.parametrize("correlated", [True, False])
def test_shared_design_matches_a_loop_over_seen_samples(correlated: bool) -> None:
    design, offset, value, mean = randn(T, B), 10 + randn(D, T), 10 + randn(D, T, seed=1), randn(D * B, seed=4)
    noise, mask = covariances(D) if correlated else positive(D, T), some_mask()
    information = SharedDesignObservation("human", design, offset, value, noise, mask, correlated).information(
        {"human": mean}
    )
    assert information is not None
    log_scale, shift, precision = 0.0, np.zeros((D, B)), np.zeros((D, B, B))
    for d in range(D):
        seen = mask[d].numpy()
        rows, noise_d = design.numpy()[seen], noise[d].numpy()
        noise_d = noise_d[np.ix_(seen, seen)] if correlated else np.diag(noise_d[seen])
        residual = (value - offset)[d].numpy()[seen] - rows @ mean.numpy().reshape(D, B)[d]
        shift[d] = rows.T @ np.linalg.solve(noise_d, residual)
        precision[d] = rows.T @ np.linalg.solve(noise_d, rows)
        if seen.any():
            log_scale += multivariate_normal(np.zeros(seen.sum()), noise_d).logpdf(residual)
    np.testing.assert_allclose(information.shift, shift.ravel(), rtol=1e-9, atol=1e-12)
    np.testing.assert_allclose(information.precision, precision, rtol=1e-9, atol=1e-12)
    assert float(information.log_scale) == pytest.approx(log_scale, rel=1e-10)


def test_rows_of_several_blocks_are_one_likelihood() -> None:
    left, right, noise = randn(5, 2), randn(5, 3, seed=1), positive(5)
    value, offset, mean = randn(5, seed=2), randn(5, seed=3), {"a": randn(2, seed=4), "b": randn(3, seed=5)}
    step = randn(5, seed=6)
    information = LinearObservation({"b": right, "a": left}, offset, value, noise).information(mean)
    assert information is not None
    predicted = (left @ (mean["a"] + step[3:]) + right @ (mean["b"] + step[:3]) + offset).numpy()
    expected = multivariate_normal(predicted, np.diag(noise.numpy())).logpdf(value.numpy())
    got = information.log_scale + information.shift @ step - 0.5 * step @ dense_precision(information) @ step
    assert float(got) == pytest.approx(expected, rel=1e-10)


@pytest.mark.parametrize("correlated", [True, False])
def test_hidden_rows_may_hold_anything(correlated: bool) -> None:
    mask, mean = some_mask(), {"human": randn(D * B, seed=4)}
    noise = covariances(D) if correlated else positive(D, T)
    value, offset = randn(D, T), randn(D, T, seed=1)
    clean = SharedDesignObservation("human", randn(T, B), offset, value, noise, mask, correlated)
    hidden = ~(mask[:, :, None] & mask[:, None, :]) if correlated else ~mask
    dirty = SharedDesignObservation(
        "human",
        randn(T, B),
        offset.masked_fill(~mask, float("inf")),
        value.masked_fill(~mask, NAN),
        noise.masked_fill(hidden, NAN),
        mask,
        correlated,
    )
    for one, two in ((clean, dirty), (clean.dense(), dirty.dense())):
        left, right = one.information(mean), two.information(mean)
        assert left is not None and right is not None
        assert torch.equal(left.shift, right.shift)
        assert torch.equal(left.precision, right.precision)
        assert torch.equal(left.log_scale, right.log_scale)


def test_no_finite_information_without_noise_unless_the_row_is_hidden() -> None:
    mean, eye = {"a": randn(2)}, torch.eye(2)
    noise, hidden = torch.tensor([0.0, 1.0]), torch.tensor([False, True])
    assert LinearObservation({"a": eye}, torch.zeros(2), torch.ones(2), noise).information(mean) is None
    assert LinearObservation({"a": eye}, torch.zeros(2), torch.ones(2), noise, hidden).information(mean) is not None
    covariance = torch.diag(noise)
    assert (
        LinearObservation({"a": eye}, torch.zeros(2), torch.ones(2), covariance, None, True).information(mean) is None
    )


def test_inputs_keep_their_values_and_become_float64() -> None:
    value, mask = torch.ones(D, T, dtype=torch.float32), some_mask()
    before = value.clone(), mask.clone()
    seen = SharedDesignObservation("human", randn(T, B), torch.zeros(1, 1), value, torch.ones(D, 1), mask)
    seen.information({"human": randn(D * B)})
    assert torch.equal(value, before[0]) and torch.equal(mask, before[1])
    assert seen.value.dtype == torch.float64 and seen.num_columns == {"human": D * B} and seen.blocks == ("human",)


def shared(**changes: object) -> SharedDesignObservation:
    arguments = {"design": randn(T, B), "offset": torch.zeros(1, 1), "value": randn(D, T), "noise": torch.ones(D, 1)}
    return SharedDesignObservation("human", **(arguments | changes))  # type: ignore[arg-type]


def rows(**changes: object) -> LinearObservation:
    arguments = {"matrices": {"a": randn(2, 3)}, "offset": randn(2), "value": randn(2), "noise": torch.ones(2)}
    return LinearObservation(**(arguments | changes))  # type: ignore[arg-type]


BAD: list[tuple[object, dict[str, object], type[EaipError], str]] = [
    (shared, {"design": randn(T - 1, B)}, ShapeError, r"design with shape \(\*batch, 7, B\)"),
    (shared, {"value": randn(T)}, ShapeError, "value with shape"),
    (shared, {"offset": randn(D, 2)}, ShapeError, r"offset with shape \(\*batch, 3, 7\), or 1"),
    (shared, {"noise": torch.ones(D)}, ShapeError, "noise with shape"),
    (shared, {"noise": covariances(D)[..., :1], "correlated": True}, ShapeError, "noise with shape"),
    (shared, {"mask": torch.ones(2, T, dtype=torch.bool)}, ShapeError, "mask with shape"),
    (shared, {"mask": torch.ones(D, T)}, InputError, "mask as booleans"),
    (shared, {"design": NAN * randn(T, B)}, InputError, "finite numbers in design"),
    (shared, {"value": NAN * randn(D, T)}, InputError, "finite numbers in value"),
    (shared, {"offset": torch.full((1, 1), NAN)}, InputError, "finite numbers in offset"),
    (shared, {"offset": torch.full((1, 1), NAN), "mask": some_mask()}, InputError, "finite numbers in offset"),
    (shared, {"noise": torch.full((D, 1), float("inf"))}, InputError, "finite numbers in noise"),
    (shared, {"noise": -torch.ones(D, 1)}, InputError, "variances.*negative"),
    (shared, {"noise": -covariances(D), "correlated": True}, InputError, "variances.*negative"),
    (rows, {"matrices": {}}, InputError, "at least one block"),
    (rows, {"matrices": {"a": randn(3, 3)}}, ShapeError, r"matrices\['a'\] with shape \(\*batch, 2, K\)"),
    (rows, {"matrices": {"a": randn(3)}}, ShapeError, r"matrices\['a'\]"),
    (rows, {"matrices": {"a": NAN * randn(2, 3)}}, InputError, r"finite numbers in matrices\['a'\]"),
    (rows, {"value": torch.tensor(1.0)}, InputError, "value with shape"),
    (rows, {"value": torch.tensor([1.0, NAN])}, InputError, "finite numbers in value"),
    (rows, {"offset": torch.tensor([1.0, NAN])}, InputError, "finite numbers in offset"),
    (rows, {"offset": randn(3)}, ShapeError, "offset with shape"),
    (rows, {"noise": torch.tensor([1.0, -1.0])}, InputError, "variances.*negative"),
    (rows, {"noise": torch.ones(2), "correlated": True}, ShapeError, r"noise with shape \(\*batch, 2, 2\)"),
    (rows, {"mask": torch.ones(3, dtype=torch.bool)}, ShapeError, "mask with shape"),
]


@pytest.mark.parametrize(("make", "changes", "error", "match"), BAD)
def test_bad_input_is_refused_by_name(make, changes: dict[str, object], error: type[EaipError], match: str) -> None:
    with pytest.raises(error, match=match):
        make(**changes)


@pytest.mark.parametrize("make", [shared, rows])
def test_values_whose_sum_overflows_are_finite(make) -> None:
    make(value=1e308 * torch.ones_like(make().value))


def test_a_negative_variance_that_is_hidden_is_never_read() -> None:
    assert rows(noise=torch.tensor([1.0, -1.0]), mask=torch.tensor([True, False])).mask is not None

"""One member is updated in numpy and LAPACK, everything else in torch: both must say the same."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import AbstractContextManager, ExitStack
from typing import Any
from unittest import mock

import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from torch import Tensor

from eaip_prob import conditioning, linalg, observation
from eaip_prob.conditioning import Information, SplitRoot, update_by_information
from eaip_prob.errors import NotPositiveDefiniteError
from eaip_prob.gaussian import BlockGaussian, BlockLayout
from eaip_prob.observation import AbstractObservation, LinearObservation, SharedDesignObservation


@pytest.fixture(autouse=True, scope="module")
def whatever_the_threads() -> Iterator[None]:
    with mock.patch.object(linalg, "_ONE_THREAD", True):
        yield


def torch_only() -> AbstractContextManager[Any]:
    stack = ExitStack()
    for module in (conditioning, observation):
        stack.enter_context(mock.patch.object(module, "single_arrays", lambda *tensors: None))
    return stack


def randn(*shape: int, generator: torch.Generator) -> Tensor:
    return torch.randn(*shape, generator=generator, dtype=torch.float64)


def belief(sizes: dict[str, int], rank: int, generator: torch.Generator, batch: tuple[int, ...] = ()) -> BlockGaussian:
    total = sum(sizes.values())
    root = randn(total, rank, generator=generator)
    if rank < total:
        root[0] = 0.0
    return BlockGaussian(3.0 + randn(*batch, total, generator=generator), root @ root.mT / rank, BlockLayout(sizes))


def motion(
    signals: int, bases: int, samples: int, noise: str, masked: bool, batch: tuple[int, ...], generator: torch.Generator
) -> SharedDesignObservation:
    shape = {"one": (1, 1), "each signal": (signals, 1), "each sample": (signals, samples), "over time": (1, samples)}
    variance = 0.05 + torch.rand(*shape[noise], generator=generator, dtype=torch.float64)
    value = randn(*batch, signals, samples, generator=generator)
    mask = torch.rand(signals, samples, generator=generator) < 0.6 if masked else None
    design, offset = randn(*batch, samples, bases, generator=generator), randn(signals, 1, generator=generator)
    return SharedDesignObservation("human", design, offset, value, variance, mask)


def feature(total: int, generator: torch.Generator) -> LinearObservation:
    matrices = {"scene": randn(2, 2, generator=generator), "human": randn(2, total, generator=generator)}
    zero, noise = torch.zeros(2), torch.tensor([0.3, 2.0])
    return LinearObservation(matrices, zero, randn(2, generator=generator), noise)


def same(one: Tensor, two: Tensor) -> None:
    assert one.shape == two.shape and one.dtype == two.dtype
    torch.testing.assert_close(one, two, rtol=1e-10, atol=1e-10 * (1.0 + float(two.abs().amax())))


@settings(max_examples=50, deadline=None, derandomize=True)
@given(
    seed=st.integers(0, 10_000),
    shape=st.tuples(st.integers(1, 4), st.integers(1, 5), st.integers(1, 30)),
    rank=st.sampled_from([1, 4, 60]),
    noise=st.sampled_from(["one", "each signal", "each sample", "over time"]),
    masked=st.booleans(),
    batch=st.sampled_from([(), (1,), (1, 1)]),
    keep=st.sampled_from([None, ("robot",), ("scene", "human")]),
    more=st.booleans(),
)
def test_both_paths_agree(
    seed: int,
    shape: tuple[int, int, int],
    rank: int,
    noise: str,
    masked: bool,
    batch: tuple[int, ...],
    keep: tuple[str, ...] | None,
    more: bool,
) -> None:
    generator = torch.Generator().manual_seed(seed)
    sizes = {"robot": 3, "human": shape[0] * shape[1], "scene": 2}
    seen: list[AbstractObservation] = [motion(*shape, noise, masked, batch, generator)]
    seen += [feature(sizes["human"], generator)] if more else []
    prior = belief(sizes, rank, generator)
    ours, evidence = prior.update(seen, keep)
    with torch_only():
        plain, plain_evidence = BlockGaussian(prior.mean, prior.covariance, prior.layout).update(seen, keep)
    same(ours.mean, plain.mean)
    same(ours.covariance, plain.covariance)
    same(evidence, plain_evidence)
    assert ours.layout == plain.layout


def test_threads_leave_it_to_torch(monkeypatch: pytest.MonkeyPatch) -> None:
    array = torch.zeros(1, 3, dtype=torch.float64)
    found = linalg.single_arrays((array, 1), (array, 2))
    assert found is not None and [part.shape for part in found[0]] == [(3,), (1, 3)] and found[1] == 1
    monkeypatch.setattr(linalg, "_ONE_THREAD", False)
    assert linalg.single_arrays((array, 1)) is None


@pytest.mark.parametrize("batch", [(3,), (2, 3)])
def test_a_batch_is_its_members(batch: tuple[int, ...]) -> None:
    generator = torch.Generator().manual_seed(1)
    prior = belief({"human": 8, "robot": 3, "scene": 2}, 13, generator, batch)
    seen = motion(2, 4, 9, "each signal", False, batch, generator)
    posterior, evidence = prior.update([seen], ("robot",))
    for index in torch.cartesian_prod(*map(torch.arange, batch)).reshape(-1, len(batch)).tolist():
        member = tuple(index)
        one = SharedDesignObservation("human", seen.design[member], seen.offset, seen.value[member], seen.noise)
        alone, gained = BlockGaussian(prior.mean[member], prior.covariance, prior.layout).update([one], ("robot",))
        same(alone.mean, posterior.mean[member])
        same(alone.covariance, posterior.covariance[member])
        same(gained, evidence[member])


def test_torch_is_left_to_batches_and_gradients(monkeypatch: pytest.MonkeyPatch) -> None:
    factored: list[int] = []
    plain = conditioning.lapack_cholesky
    monkeypatch.setattr(conditioning, "lapack_cholesky", lambda matrix: factored.append(len(matrix)) or plain(matrix))
    generator = torch.Generator().manual_seed(2)
    prior = belief({"human": 8, "robot": 3, "scene": 2}, 13, generator)
    prior.update([motion(2, 4, 9, "one", False, (), generator)])
    prior.update([motion(2, 4, 9, "one", False, (2,), generator)])
    assert len(factored) == 1


@pytest.mark.filterwarnings("ignore:Converting a tensor with requires_grad")
@pytest.mark.parametrize("name", ["value", "noise", "design"])
def test_gradients_pass(name: str) -> None:
    generator = torch.Generator().manual_seed(3)
    prior = belief({"human": 4, "robot": 3, "scene": 2}, 9, generator)
    fields = {"design": randn(5, 2, generator=generator), "value": randn(2, 5, generator=generator)}
    fields |= {"offset": torch.zeros(1, 1).double(), "noise": torch.full((2, 1), 0.4, dtype=torch.float64)}

    def evidence(part: Tensor) -> Tensor:
        return prior.update([SharedDesignObservation("human", **(fields | {name: part}))])[1]

    torch.autograd.gradcheck(evidence, (fields[name].clone().requires_grad_(),))


def test_inputs_are_unchanged_and_runs_alike() -> None:
    generator = torch.Generator().manual_seed(4)
    prior = belief({"human": 120, "robot": 60, "scene": 2}, 182, generator)
    seen = motion(6, 20, 50, "each signal", False, (), generator)
    before = [part.clone() for part in (prior.mean, prior.covariance, seen.design, seen.value, seen.noise)]
    results = [prior.update([seen], ("robot",)) for _ in range(20)]
    first = results[0][0].covariance.clone()
    for posterior, evidence in results:
        assert torch.equal(posterior.covariance, first) and torch.equal(evidence, results[0][1])
    after = (prior.mean, prior.covariance, seen.design, seen.value, seen.noise)
    assert all(torch.equal(one, two) for one, two in zip(before, after, strict=True))


def precision(diagonal: float) -> tuple[SplitRoot, list[tuple[Tensor, Tensor]]]:
    inner, pull = torch.diag(torch.tensor([diagonal, 1.0])).double(), torch.ones(2, dtype=torch.float64)
    return SplitRoot.of(torch.eye(3, dtype=torch.float64), 2, torch.tensor([0, 2])), [(inner, pull)]


@pytest.mark.parametrize("diagonal", [-5.0, float("nan"), float("inf")])
def test_no_factor_raises(diagonal: float) -> None:
    with pytest.raises(NotPositiveDefiniteError):
        update_by_information(*precision(diagonal))


def test_the_jitter_policy_decides_where_lapack_has_no_factor() -> None:
    ours = update_by_information(*precision(-1.0))
    with torch_only():
        plain = update_by_information(*precision(-1.0))
    assert all(torch.equal(one, two) and torch.isfinite(one).all() for one, two in zip(ours, plain, strict=True))


def test_evidence_too_strong_is_refused_by_both() -> None:
    eye = torch.eye(2, dtype=torch.float64)
    for strength in (2e10, float("nan")):
        strong = Information(strength * eye[None], torch.ones(2, dtype=torch.float64), torch.zeros(()).double())
        assert strong.pulled(eye) is None
        with torch_only():
            assert strong.pulled(eye) is None


@pytest.mark.parametrize("size", [1, 2, 3, 7, 40])
def test_symmetric_product(size: int) -> None:
    generator = torch.Generator().manual_seed(size)
    left, weight = randn(size + 2, size, generator=generator), randn(size + 2, size + 2, generator=generator)
    right = (weight + weight.mT) @ left
    product = torch.from_numpy(conditioning._symmetric_product(left.numpy(), right.numpy()))
    same(product, left.mT @ right)
    assert torch.equal(product[: size // 2, size // 2 :], product[size // 2 :, : size // 2].mT)

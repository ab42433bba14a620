"""Laws that conditioning obeys, checked on random problems; each law catches a bug planted for it."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Any

import pytest
import torch
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from torch import Tensor

from eaip_prob import conditioning, gaussian
from eaip_prob.conditioning import SplitRoot
from eaip_prob.gaussian import BlockGaussian, BlockLayout
from eaip_prob.observation import AbstractObservation, LinearObservation, SharedDesignObservation

Problem = tuple[BlockGaussian, list[AbstractObservation]]
LAYOUT = BlockLayout({"human": 6, "robot": 3, "environment": 2})


def problem(seed: int, rank: int = 30, exact: bool = False) -> Problem:
    generator = torch.Generator().manual_seed(seed)

    def randn(*shape: int) -> Tensor:
        return torch.randn(*shape, generator=generator, dtype=torch.float64)

    rows = randn(rank, 11)
    belief = BlockGaussian(5 + randn(11), rows.mT @ rows / rank, LAYOUT)
    mask = torch.rand(2, 5, generator=generator) > 0.3
    noise = 0.1 + randn(2, 5).square()
    motion = SharedDesignObservation("human", randn(5, 3), randn(2, 5), 5 + 3 * randn(2, 5), noise, mask)
    variance = torch.tensor([0.0, 0.5]) if exact else torch.tensor([0.3, 0.5])
    matrices = {"robot": randn(2, 3), "human": randn(2, 6)}
    relation = LinearObservation(matrices, randn(2), randn(2), variance)
    scene = LinearObservation({"environment": torch.eye(2)}, torch.zeros(2), 5 + randn(2), 0.1 + randn(2).square())
    return belief, [motion, relation, scene]


def same(one: Tensor, two: Tensor, tolerance: float = 1e-7) -> None:
    torch.testing.assert_close(one, two, rtol=tolerance, atol=tolerance)


def same_belief(one: BlockGaussian, two: BlockGaussian) -> None:
    assert one.layout.names == two.layout.names
    same(one.mean, two.mean)
    same(one.covariance, two.covariance)


def check_order_is_irrelevant(belief: BlockGaussian, seen: list[AbstractObservation]) -> None:
    forward, backward = belief.update(seen), belief.update(seen[::-1])
    same_belief(forward[0], backward[0])
    same(forward[1], backward[1])


def check_one_by_one_is_all_at_once(belief: BlockGaussian, seen: list[AbstractObservation]) -> None:
    posterior, total = belief, torch.zeros((), dtype=torch.float64)
    for observation in seen:
        posterior, evidence = posterior.update([observation])
        total = total + evidence
    expected, evidence = belief.update(seen)
    same_belief(posterior, expected)
    same(total, evidence)


def check_nothing_seen_changes_nothing(belief: BlockGaussian, seen: list[AbstractObservation]) -> None:
    for nothing in ([], [hidden(observation.dense(), keep=0) for observation in seen]):
        posterior, evidence = belief.update(nothing)
        same_belief(posterior, belief)
        same(evidence, torch.zeros((), dtype=torch.float64))


def check_shifts_pass_through(belief: BlockGaussian, seen: list[AbstractObservation]) -> None:
    shift = torch.linspace(-40.0, 70.0, LAYOUT.total, dtype=torch.float64)
    moved = []
    for observation in seen:
        rows = observation.dense()
        offset = sum(rows.matrices[block] @ shift[LAYOUT.slice(block)] for block in rows.blocks)
        moved.append(replace(rows, offset=rows.offset - offset))
    plain = belief.update(seen)
    there = BlockGaussian(belief.mean + shift, belief.covariance, LAYOUT).update(moved)
    same_belief(BlockGaussian(plain[0].mean + shift, plain[0].covariance, LAYOUT), there[0])
    same(plain[1], there[1])


def check_units_are_irrelevant(belief: BlockGaussian, seen: list[AbstractObservation]) -> None:
    unit = torch.ones(LAYOUT.total, dtype=torch.float64)
    unit[LAYOUT.slice("human")], unit[LAYOUT.slice("environment")] = 1e3, 1e-3
    scaled = BlockGaussian(belief.mean * unit, belief.covariance * unit[:, None] * unit, LAYOUT)
    other = []
    for observation in seen:
        rows = observation.dense()
        matrices = {block: matrix / unit[LAYOUT.slice(block)] for block, matrix in rows.matrices.items()}
        other.append(replace(rows, matrices=matrices))
    plain, there = belief.update(seen), scaled.update(other)
    same(plain[0].mean, there[0].mean / unit)
    same(plain[0].covariance, there[0].covariance / unit[:, None] / unit)
    same(plain[1], there[1])


def hidden(rows: LinearObservation, keep: int = 1) -> LinearObservation:
    """The first `keep` rows seen, the others full of nonsense."""
    count = rows.value.shape[-1]
    mask, nonsense = torch.arange(count) < keep, torch.full((count,), 1e6, dtype=torch.float64)
    value, noise = torch.where(mask, rows.value, float("nan")), torch.where(mask, rows.noise, 1e-9)
    matrices = {block: torch.where(mask[:, None], part, nonsense[:, None]) for block, part in rows.matrices.items()}
    return LinearObservation(matrices, rows.offset, value, noise, mask)


def check_hidden_rows_are_absent(belief: BlockGaussian, seen: list[AbstractObservation]) -> None:
    written = [observation.dense() for observation in seen]
    first = [
        LinearObservation({b: m[:1] for b, m in rows.matrices.items()}, rows.offset[:1], rows.value[:1], rows.noise[:1])
        for rows in written
    ]
    masked, absent = belief.update([hidden(rows) for rows in written]), belief.update(first)
    same_belief(masked[0], absent[0])
    same(masked[1], absent[1])


def check_evidence_only_shrinks(belief: BlockGaussian, seen: list[AbstractObservation]) -> None:
    posterior = belief.condition(seen).covariance
    same(posterior, posterior.mT)
    assert float(torch.linalg.eigvalsh(posterior).amin()) > -1e-10
    assert float(torch.linalg.eigvalsh(belief.covariance - posterior).amin()) > -1e-10
    assert float((belief.covariance - posterior).diagonal().sum()) > 1e-3


def check_parts_are_marginals(belief: BlockGaussian, seen: list[AbstractObservation]) -> None:
    whole, total = belief.update(seen[:1])
    for keep in (("robot",), ("environment", "human"), ("environment",)):
        part, evidence = belief.update(seen[:1], keep)
        same_belief(part, whole.marginal(keep))
        same(evidence, total)


def check_block_order_is_irrelevant(belief: BlockGaussian, seen: list[AbstractObservation]) -> None:
    order = ("environment", "human", "robot")
    plain, other = belief.update(seen), belief.marginal(order).update(seen)
    same_belief(plain[0].marginal(order), other[0])
    same(plain[1], other[1])


Law = Callable[[BlockGaussian, list[AbstractObservation]], None]
LAWS: dict[str, Law] = {
    name.removeprefix("check_"): law for name, law in globals().items() if name.startswith("check_")
}


@pytest.mark.parametrize("law", LAWS)
@settings(max_examples=15, deadline=None, derandomize=True, suppress_health_check=[HealthCheck.too_slow])
@given(seed=st.integers(0, 10_000), rank=st.sampled_from([30, 8, 4]), exact=st.booleans())
def test_law(law: str, seed: int, rank: int, exact: bool) -> None:
    LAWS[law](*problem(seed, rank, exact))


PLAIN_INFORMATION, PLAIN_ROWS = gaussian.update_by_information, LinearObservation.rows
PLAIN_ROWS_INFORMATION, PLAIN_UPDATE = LinearObservation.information, BlockGaussian.update
PLAIN_SPLIT = SplitRoot.of.__func__  # type: ignore[attr-defined]


def only_the_last(split: SplitRoot, pulled: Sequence[Any]) -> Any:
    return PLAIN_INFORMATION(split, pulled[-1:])


def covariance_left_behind(self: BlockGaussian, observations: Any, keep: Any = None) -> Any:
    posterior, evidence = PLAIN_UPDATE(self, observations, keep)
    return BlockGaussian(posterior.mean, self.marginal(posterior.layout.names).covariance, posterior.layout), evidence


def hidden_rows_counted(self: LinearObservation, mean: Any) -> Any:
    information = PLAIN_ROWS_INFORMATION(self, mean)
    missing = 0.0 if self.mask is None else (~self.mask).sum(dtype=torch.float64)
    return information and replace(information, log_scale=information.log_scale - 0.9 * missing)


def offset_forgotten(self: LinearObservation, mean: Any) -> Any:
    design, residual, noise = PLAIN_ROWS(self, mean)
    return design, residual + self.offset, noise


def prior_with_a_ridge(cls: type[SplitRoot], root: Tensor, num_seen: int, kept: Tensor) -> SplitRoot:
    return PLAIN_SPLIT(cls, root + 1e-2 * torch.eye(*root.shape[-2:], dtype=root.dtype), num_seen, kept)


def mask_ignored(self: LinearObservation, mean: Any) -> Any:
    value = torch.nan_to_num(self.value)
    return PLAIN_ROWS(LinearObservation(self.matrices, self.offset, value, self.noise), mean)


def sign_flipped(split: SplitRoot, pulled: Sequence[Any]) -> Any:
    step, covariance, evidence = PLAIN_INFORMATION(split, pulled)
    prior = split.kept @ split.kept.mT + (0 if split.unexplained is None else split.unexplained)
    return step, 2 * prior - covariance, evidence


def columns_not_rotated(rows: Tensor) -> Tensor:
    return torch.eye(rows.shape[-1], dtype=rows.dtype)


def blocks_sorted(self: BlockLayout, blocks: Sequence[str]) -> Tensor:
    return torch.cat([torch.arange(self.total)[self.slice(block)] for block in sorted(blocks)])


MUTANTS: list[tuple[str, Any, str, Any]] = [
    ("order_is_irrelevant", gaussian, "update_by_information", only_the_last),
    ("one_by_one_is_all_at_once", BlockGaussian, "update", covariance_left_behind),
    ("nothing_seen_changes_nothing", LinearObservation, "information", hidden_rows_counted),
    ("shifts_pass_through", LinearObservation, "rows", offset_forgotten),
    ("units_are_irrelevant", SplitRoot, "of", classmethod(prior_with_a_ridge)),
    ("hidden_rows_are_absent", LinearObservation, "rows", mask_ignored),
    ("evidence_only_shrinks", gaussian, "update_by_information", sign_flipped),
    ("parts_are_marginals", conditioning, "trailing_rotation", columns_not_rotated),
    ("block_order_is_irrelevant", BlockLayout, "indices", blocks_sorted),
]


@pytest.mark.parametrize(("law", "owner", "name", "bug"), MUTANTS)
def test_each_law_catches_its_bug(law: str, owner: Any, name: str, bug: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    belief, seen = problem(0)
    LAWS[law](belief, seen)
    monkeypatch.setattr(owner, name, bug)
    with pytest.raises(AssertionError):
        LAWS[law](*problem(0))


def test_every_law_has_a_bug() -> None:
    assert {law for law, *_ in MUTANTS} == set(LAWS)

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
import torch

from eaip_prob.data.merging import merged
from eaip_prob.data.trajectory import Trajectory
from eaip_prob.errors import InputError

NAMES = ("x", "y", "z")


def part(times: list[float], seed: int, noise: bool = False, seen: float = 0.6) -> Trajectory:
    draw = torch.Generator().manual_seed(seed)
    shape = (len(times), len(NAMES))
    values = 5.0 + 40.0 * torch.randn(shape, generator=draw, dtype=torch.float64)
    mask = torch.rand(shape, generator=draw) < seen
    root = torch.randn(*shape, 3, generator=draw, dtype=torch.float64)
    return Trajectory(times, values, NAMES, mask, root @ root.mT if noise else None)


def looped(parts: list[Trajectory]) -> Trajectory:
    """Sample by sample and signal by signal, the later arrival over the earlier one."""
    times = sorted({float(time) for one in parts for time in one.time})
    values, noises = {}, {}
    for number, one in enumerate(parts):
        for row, time in enumerate(one.time.tolist()):
            for column in range(3):
                if one.mask[row, column]:
                    values[time, column] = (float(one.values[row, column]), number)
            for pair in np.ndindex(3, 3):
                if one.noise is not None:
                    noises[time, number, pair] = float(one.noise[row][pair])
    mask, table, noise = np.zeros((len(times), 3), bool), np.zeros((len(times), 3)), np.zeros((len(times), 3, 3))
    for row, time in enumerate(times):
        for column in range(3):
            if (time, column) in values:
                mask[row, column], table[row, column] = True, values[time, column][0]
        for i, j in np.ndindex(3, 3):
            sources = [values.get((time, column), (0.0, None))[1] for column in (i, j)]
            # Errors of different frames have nothing in common.
            if sources[0] is not None and sources[0] == sources[1]:
                noise[row, i, j] = noises.get((time, sources[0], (i, j)), 0.0)
    given = torch.tensor(noise) if parts[0].noise is not None else None
    return Trajectory(times, torch.tensor(table), NAMES, torch.tensor(mask), given)


def assert_same(came: Trajectory, expected: Trajectory) -> None:
    assert came.names == expected.names and torch.equal(came.mask, expected.mask)
    assert torch.equal(came.time, expected.time) and torch.equal(came.values, expected.values)
    assert (came.noise is None) == (expected.noise is None)
    if came.noise is not None and expected.noise is not None:
        seen = came.mask[:, :, None] & came.mask[:, None, :]
        assert torch.equal(torch.where(seen, came.noise, 0.0), expected.noise)


CASES = {
    "after": [[0.1, 0.4], [0.5, 0.9, 1.0]],
    "before": [[3.0, 3.5], [-0.2, 0.1]],
    "between": [[0.0, 1.0, 2.0], [0.5, 1.5]],
    "around": [[0.5], [0.0, 1.0]],
    "the same": [[0.3, 0.7, 1.1], [0.3, 0.7, 1.1]],
    "touching": [[0.3, 0.7], [0.7, 0.9]],
    "one by one": [[0.7], [0.7], [0.2], [1.3], [0.7], [0.2, 1.3]],
}


@pytest.mark.parametrize("noise", [False, True])
@pytest.mark.parametrize("seed", [0, 1, 2])
@pytest.mark.parametrize("case", list(CASES))
def test_against_a_loop_over_times_and_signals(case: str, seed: int, noise: bool) -> None:
    parts = [part(times, 10 * seed + number, noise) for number, times in enumerate(CASES[case])]
    came = parts[0]
    for one in parts[1:]:
        came = merged(came, one)
    assert_same(came, looped(parts))


@pytest.mark.parametrize("noise", [False, True])
def test_random_arrivals(noise: bool) -> None:
    draw = np.random.default_rng(3)
    for trial in range(20):
        times = [sorted(draw.choice(12, draw.integers(1, 5), replace=False) / 8.0) for _ in range(6)]
        parts = [part(chosen, 100 * trial + number, noise) for number, chosen in enumerate(times)]
        came = parts[0]
        for one in parts[1:]:
            came = merged(came, one)
        assert_same(came, looped(parts))


def test_noise_of_a_merged_sample_is_a_covariance() -> None:
    draw = np.random.default_rng(0)
    came = part([0.4], 0, noise=True, seen=1.0)
    for seed in range(1, 20):
        came = merged(came, part([0.4], seed, noise=True, seen=draw.uniform(0.2, 0.8)))
        assert came.noise is not None
        assert float(torch.linalg.eigvalsh(came.noise[0]).min()) > -1e-12


def test_nothing_seen_keeps_what_was_known() -> None:
    known, blind = part([0.0, 0.5], 1, noise=True), part([0.0, 0.5], 2, noise=True, seen=0.0)
    assert_same(merged(known, blind), looped([known]))
    came = merged(known, part([0.25, 0.75], 3, noise=True, seen=0.0))
    assert came.time.tolist() == [0.0, 0.25, 0.5, 0.75]
    assert came.seen.tolist() == [bool(known.seen[0]), False, bool(known.seen[1]), False]


def test_what_is_merged_is_unchanged() -> None:
    parts = [part([0.0, 0.5], 1, noise=True), part([0.25, 0.5], 2, noise=True)]
    before = [[getattr(one, name).clone() for name in ("time", "values", "mask", "noise")] for one in parts]
    merged(*parts)
    after = [[getattr(one, name) for name in ("time", "values", "mask", "noise")] for one in parts]
    assert all(torch.equal(a, b) for one, two in zip(before, after, strict=True) for a, b in zip(one, two, strict=True))


def test_parts_that_do_not_belong_together_are_refused() -> None:
    one, noisy = part([0.0, 0.5], 1), part([0.2], 2, noise=True)
    with pytest.raises(InputError, match=r"signals \('x', 'y', 'z'\), got \('x', 'z', 'y'\)"):
        merged(one, dataclasses.replace(one, names=("x", "z", "y")))
    batch = Trajectory([0.0, 0.5], one.values.expand(4, 2, 3), NAMES)
    for first, second in ((one, batch), (batch, one)):
        with pytest.raises(InputError, match=r"single trajectories .* \(4,\)"):
            merged(first, second)
    for first, second in ((one, noisy), (noisy, one)):
        with pytest.raises(InputError, match="noise for all samples or for none"):
            merged(first, second)

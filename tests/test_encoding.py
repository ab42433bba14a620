from __future__ import annotations

import math

import numpy as np
import pytest
import torch

from eaip_prob.data.demonstrations import Demonstration, DemonstrationSet
from eaip_prob.data.trajectory import Trajectory, stack
from eaip_prob.encoding import encode
from eaip_prob.phase import AbstractPhaseEstimator, ElapsedClock, KnownPhase
from eaip_prob.primitives import DMP, AbstractPrimitive, ProMP

RANGE = torch.tensor([1.0, 200.0], dtype=torch.float64)

LENGTHS = (1.6, 2.0, 2.9)


def motions(step: float = 0.05) -> list[Trajectory]:
    result = []
    for i, length in enumerate(LENGTHS):
        time = 7.0 + torch.arange(round(length / step) + 1, dtype=torch.float64) * step * (1 + 0.01 * i)
        s = (time - time[0]) / (time[-1] - time[0])
        values = torch.stack([3 + torch.sin(3 * s + i), 200 * s**2 - 50 * i], -1)
        result.append(Trajectory(time, values, ("x", "y")))
    return result


def clock_for(clock: AbstractPhaseEstimator, parts: list[Trajectory]) -> AbstractPhaseEstimator:
    return clock.fit(DemonstrationSet([Demonstration(part) for part in parts]), "human")


def assert_same_motion(
    primitive: AbstractPrimitive, one: torch.Tensor, other: torch.Tensor, duration: torch.Tensor
) -> None:
    """Weights may differ along what the ridge alone decides; paths may not."""
    phase = torch.linspace(0, primitive.limit, 40, dtype=torch.float64)
    difference = primitive.decode(one, phase, duration) - primitive.decode(other, phase, duration)
    assert (difference.abs() / RANGE).max() < 2e-4


@pytest.mark.parametrize("clock", [ElapsedClock(), KnownPhase()])
@pytest.mark.parametrize("primitive", [ProMP(num_basis=6), DMP(num_basis=6)])
def test_batch_equals_loop(clock: AbstractPhaseEstimator, primitive: AbstractPrimitive) -> None:
    parts = motions()
    fitted = clock_for(clock, parts)
    spanning, batch = primitive.spanning(fitted.limit), stack(parts)
    whole = encode(spanning, batch, fitted.encoding(batch), fitted.limit)
    for i, part in enumerate(parts):
        single = stack([part])
        alone = encode(spanning, single, fitted.encoding(single), fitted.limit)
        duration = fitted.encoding(single).duration[..., 0].reshape(())
        assert_same_motion(spanning, whole.weights[i], alone.weights[0], duration)
        torch.testing.assert_close(whole.boundary.start[i], part.values[0])


@pytest.mark.parametrize("primitive", [ProMP(num_basis=9), DMP(num_basis=9)])
def test_last_value_is_held_up_to_the_limit(primitive: AbstractPrimitive) -> None:
    parts = motions()
    clock = clock_for(ElapsedClock(), parts)
    assert clock.limit > 1.3
    spanning, batch = primitive.spanning(clock.limit), stack(parts)
    phase = clock.encoding(batch)
    came = encode(spanning, batch, phase, clock.limit)
    duration = phase.duration[..., 0]
    for i, part in enumerate(parts):
        step = float(part.time[1] - part.time[0])
        count = math.floor(clock.limit * float(duration) / step + 1e-6) + 1
        time = torch.arange(count, dtype=torch.float64) * step
        values = torch.cat([part.values, part.values[-1:].expand(max(count - part.num_samples, 0), 2)])[:count]
        expected = spanning.encode(Trajectory(time, values), (time / duration).clamp_max(clock.limit), duration)
        assert_same_motion(spanning, came.weights[i], expected, duration)
    goal = spanning.decode(came.weights, torch.tensor([clock.limit], dtype=torch.float64), duration)[:, 0]
    last = torch.stack([part.values[-1] for part in parts])
    assert ((goal - last).abs() / RANGE).max() < 0.02


def test_own_duration_ends_at_one() -> None:
    parts = motions()
    clock, batch = clock_for(KnownPhase(), parts), stack(parts)
    assert clock.limit == 1.0
    came = encode(ProMP(num_basis=9), batch, clock.encoding(batch), clock.limit)
    for i, part in enumerate(parts):
        phase = (part.time - part.time[0]) / (part.time[-1] - part.time[0])
        expected = ProMP(num_basis=9).encode(part, phase, torch.tensor(1.0))
        assert_same_motion(ProMP(num_basis=9), came.weights[i], expected, torch.tensor(1.0))


@pytest.mark.parametrize("clock", [ElapsedClock(), KnownPhase()])
@pytest.mark.parametrize("hidden", [False, True])
def test_residual_is_the_mean_square_of_what_is_lost(clock: AbstractPhaseEstimator, hidden: bool) -> None:
    parts = motions()
    if hidden:
        masks = [torch.ones_like(part.mask) for part in parts]
        masks[1][3:9, 0] = False
        parts = [Trajectory(p.time, p.values, p.names, m) for p, m in zip(parts, masks, strict=True)]
    fitted, batch = clock_for(clock, parts), stack(parts)
    primitive = ProMP(num_basis=4).spanning(fitted.limit)
    phase = fitted.encoding(batch)
    came = encode(primitive, batch, phase, fitted.limit)
    squares: list[list[float]] = [[], []]
    for i, part in enumerate(parts):
        duration = float(phase.duration[..., 0].expand(3)[i])
        path = primitive.decode(came.weights[i], (part.time - part.time[0]) / duration)
        for d in range(2):
            squares[d] += ((path - part.values)[:, d] ** 2)[part.mask[:, d]].tolist()
    np.testing.assert_allclose(came.residual, [np.mean(s) for s in squares], rtol=1e-8)
    assert came.residual.min() > 1e-6


def test_residual_is_never_zero() -> None:
    parts = [Trajectory(p.time, torch.zeros_like(p.values), p.names) for p in motions()]
    clock, batch = clock_for(ElapsedClock(), parts), stack(parts)
    came = encode(ProMP(num_basis=4).spanning(clock.limit), batch, clock.encoding(batch), clock.limit)
    assert bool((came.residual > 0).all())
    assert came.residual.max() < 1e-15


def test_shared_clock_keeps_one_design() -> None:
    parts = [
        Trajectory(torch.linspace(0, 2, 30), torch.randn(30, 1, generator=torch.Generator().manual_seed(i)))
        for i in range(4)
    ]
    clock, batch = clock_for(ElapsedClock(), parts), stack(parts)
    assert batch.time.ndim == 1
    whole = encode(ProMP(num_basis=5), batch, clock.encoding(batch), clock.limit)
    for i, part in enumerate(parts):
        expected = ProMP(num_basis=5).encode(part, torch.linspace(0, 1, 30, dtype=torch.float64), torch.tensor(2.0))
        torch.testing.assert_close(whole.weights[i], expected, rtol=1e-5, atol=1e-4)


def test_motions_are_left_unchanged() -> None:
    parts = motions()
    clock, batch = clock_for(ElapsedClock(), parts), stack(parts)
    before = batch.values.clone()
    encode(DMP(num_basis=4).spanning(clock.limit), batch, clock.encoding(batch), clock.limit)
    assert torch.equal(batch.values, before)

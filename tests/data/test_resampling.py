from __future__ import annotations

import math

import numpy as np
import pytest
import torch

from eaip_prob.data import Trajectory, held, resample, resampled_at_rate, stack, time_normalised
from eaip_prob.errors import InputError, ShapeError


def make(batch=(2, 3), num_samples=23, num_signals=3, seed=0, seen=0.7, noise=False, shared=False):
    """Irregular time away from zero, per-motion steps, drop-outs per signal and padding behind different ends."""
    generator = torch.Generator().manual_seed(seed)
    steps = 0.05 + 0.1 * torch.rand(*(() if shared else batch), num_samples, generator=generator, dtype=torch.float64)
    values = 40 * torch.randn(*batch, num_samples, num_signals, generator=generator, dtype=torch.float64) + 150
    mask = torch.rand(*batch, num_samples, num_signals, generator=generator) < seen
    length = torch.randint(num_samples // 2, num_samples + 1, batch, generator=generator)
    mask &= (torch.arange(num_samples) < length[..., None])[..., None]
    root = torch.randn(*batch, num_samples, num_signals, num_signals, generator=generator, dtype=torch.float64)
    names = [f"s{i}" for i in range(num_signals)]
    return Trajectory(steps.cumsum(-1) - 0.4, values, names, mask, root @ root.mT if noise else None)


def copy(trajectory):
    return [None if part is None else part.clone() for part in _tensors(trajectory)]


def _tensors(trajectory):
    return trajectory.time, trajectory.values, trajectory.mask, trajectory.noise


def members(trajectory):
    return (
        [trajectory[index] for index in np.ndindex(*trajectory.batch_shape)] if trajectory.batch_shape else [trajectory]
    )


def slow_resample(trajectory, time, max_gap):
    """One motion, one signal, one sample at a time."""
    values, mask = np.zeros((len(time), trajectory.num_signals)), np.zeros((len(time), trajectory.num_signals), bool)
    own = trajectory.time.numpy()
    for signal in range(trajectory.num_signals):
        seen = trajectory.mask[:, signal].numpy()
        times, samples = own[seen], trajectory.values[:, signal].numpy()[seen]
        for new, t in enumerate(time.numpy()):
            earlier, later = np.flatnonzero(times <= t), np.flatnonzero(times > t)
            exact = len(earlier) and times[earlier[-1]] == t
            joined = len(earlier) and len(later) and times[later[0]] - times[earlier[-1]] <= max_gap
            mask[new, signal] = exact or joined
            if mask[new, signal]:
                values[new, signal] = np.interp(t, times, samples)
    return values, mask


@pytest.mark.parametrize("batch", [(), (2, 3)])
@pytest.mark.parametrize("max_gap", [None, 0.21, math.inf])
@pytest.mark.parametrize("shared", [True, False])
def test_resample_is_the_slow_loop(batch, max_gap, shared):
    trajectory = make(batch, shared=shared)
    low, high = float(trajectory.time.min()), float(trajectory.time.max())
    own = trajectory.time.flatten()[[0, 3, 7]]
    time = torch.cat([torch.linspace(low - 0.3, high + 0.3, 61, dtype=torch.float64), own]).sort().values
    result = resample(trajectory, time, max_gap)
    assert result.time.shape == time.shape
    for old, new in zip(members(trajectory), members(result), strict=True):
        gap = 3.0 * float(np.quantile(np.diff(old.time), 0.5, method="lower")) if max_gap is None else max_gap
        values, mask = slow_resample(old, time, gap)
        np.testing.assert_array_equal(new.mask, mask)
        np.testing.assert_allclose(new.values, values, atol=1e-10)
    assert 0.1 < result.mask.double().mean() < 0.95


def test_resample_at_own_time_is_the_identity():
    trajectory = make()
    same = resample(trajectory, trajectory.time, max_gap=1e-3)
    assert torch.equal(same.values, trajectory.values)
    assert torch.equal(same.mask, trajectory.mask)


def test_never_across_masked_samples():
    values = torch.tensor([[1.0], [9e9], [3.0], [4.0]])
    trajectory = Trajectory([0.0, 2.0, 4.0, 6.0], values, mask=torch.tensor([[True], [False], [True], [True]]))
    assert resample(trajectory, [1.0, 2.0, 3.0]).values.flatten().tolist() == [1.5, 2.0, 2.5]


def test_default_gap_fills_two_lost_samples_and_not_three():
    mask = torch.ones(12, 2, dtype=torch.bool)
    mask[3:5, 0] = False
    mask[3:6, 1] = False
    trajectory = Trajectory(0.1 * torch.arange(12, dtype=torch.float64), torch.ones(12, 2), mask=mask)
    result = resample(trajectory, 0.05 + 0.1 * torch.arange(11, dtype=torch.float64))
    assert result.mask[:, 0].all()
    assert result.mask[:, 1].nonzero().flatten().tolist() == [0, 1, 6, 7, 8, 9, 10]


def test_round_off_at_the_ends_is_forgiven():
    trajectory = Trajectory([0.3, 0.7, 1.1], [[1.0], [2.0], [4.0]])
    result = resample(trajectory, [0.3 - 1e-12, 1.1 + 1e-12])
    assert result.mask.all()
    np.testing.assert_allclose(result.values.flatten(), [1.0, 4.0], atol=1e-9)
    assert not resample(trajectory, [0.3 - 1e-4, 1.1 + 1e-4]).mask.any()


def test_one_motion_at_a_batch_of_times():
    trajectory = make(())
    time = torch.tensor([[0.0, 0.2, 0.5], [0.11, 0.3, 0.31]], dtype=torch.float64)
    result = resample(trajectory, time)
    assert result.batch_shape == (2,)
    for row in range(2):
        assert torch.equal(result.values[row], resample(trajectory, time[row]).values)


def test_time_per_motion():
    trajectory = make((4,))
    time = trajectory.time[:, :1] + torch.linspace(0.0, 1.3, 9, dtype=torch.float64)
    result = resample(trajectory, time)
    for row in range(4):
        assert torch.equal(result.values[row], resample(trajectory[row], time[row]).values)


def test_single_sample():
    single = Trajectory([0.5], [[7.0]])
    assert resample(single, [0.4, 0.5, 0.6]).mask.flatten().tolist() == [False, True, False]


@pytest.mark.parametrize(
    "resampler", [lambda t: resample(t, torch.linspace(-0.2, 1.5, 30), math.inf), lambda t: held(t, 2.0)]
)
def test_noise_is_that_of_the_linear_map(resampler):
    """The matrix of the map is read off by passing unit vectors; the covariance follows from it densely."""
    trajectory = make((), num_samples=9, noise=True)
    size, signals = trajectory.num_samples, trajectory.num_signals
    zero = torch.zeros_like(trajectory.values)
    result = resampler(trajectory)
    expected = torch.zeros_like(result.noise)
    for sample in range(size):
        rows = []
        for signal in range(signals):
            unit = zero.clone()
            unit[sample, signal] = 1.0
            rows.append(resampler(Trajectory(trajectory.time, unit, trajectory.names, trajectory.mask)).values)
        matrix = torch.stack(rows, dim=-1)
        expected += matrix @ trajectory.noise[sample] @ matrix.mT
    both = result.mask[:, :, None] & result.mask[:, None, :]
    torch.testing.assert_close(result.noise[both], expected[both])
    assert torch.linalg.eigvalsh(result.noise).min() > -1e-12


def test_noise_at_the_edge_of_a_gap_is_that_of_its_sample():
    noise = torch.tensor([1.0, 2.0, 4.0, 8.0], dtype=torch.float64)[:, None, None]
    trajectory = Trajectory([0.0, 1e3, 2e3, 9e3], torch.ones(4, 1), noise=noise)
    result = resample(trajectory, [2e3 + 5e-4])
    assert result.mask.all()
    assert abs(float(result.noise) - 4.0) < 1e-9


def test_noise_by_monte_carlo():
    trajectory = Trajectory([0.0, 2.0], [[1.0], [3.0]], noise=[[[4.0]], [[1.0]]])
    generator = torch.Generator().manual_seed(3)
    draws = 20_000
    errors = torch.randn(draws, 2, 1, generator=generator, dtype=torch.float64) * torch.tensor([[2.0], [1.0]])
    noisy = Trajectory(trajectory.time, trajectory.values + errors, trajectory.names)
    sampled = resample(noisy, [0.5]).values.var()
    exact = float(resample(trajectory, [0.5]).noise)
    assert abs(float(sampled) - exact) < 4 * exact * math.sqrt(2.0 / draws)


def test_batched_noise_is_the_loop():
    trajectory = make((2, 3), noise=True)
    result = resample(trajectory, torch.linspace(-0.3, 1.8, 17))
    for old, new in zip(members(trajectory), members(result), strict=True):
        torch.testing.assert_close(new.noise, resample(old, new.time).noise)


@pytest.mark.parametrize(
    ("time", "max_gap", "error", "message"),
    [
        (0.5, None, ShapeError, "got a single number"),
        ([0.0, math.nan], None, InputError, "finite numbers in time"),
        ([0.5, 0.5], None, InputError, "strictly increasing time"),
        ([[0.0, 1.0]] * 4, None, ShapeError, r"batch axes that fit \(2, 3\), got shape \(4, 2\)"),
        ([0.0], 0.0, InputError, "max_gap above zero"),
        ([0.0], math.nan, InputError, "max_gap above zero"),
    ],
)
def test_resample_refuses(time, max_gap, error, message):
    with pytest.raises(error, match=message):
        resample(make(), time, max_gap)


def ragged():
    """A 2.5 s motion from -0.5 s, and one of 0.9 s from 0.1 s, straight lines in each signal."""
    times = [torch.linspace(-0.5, 2.0, 26, dtype=torch.float64), torch.linspace(0.1, 1.0, 10, dtype=torch.float64)]
    return stack([Trajectory(t, torch.stack([2.0 * t + 1.0, 5.0 - t], dim=-1), ["a", "b"]) for t in times])


def test_time_normalised_keeps_real_seconds_of_a_ragged_batch():
    result = time_normalised(ragged(), 31)
    np.testing.assert_allclose(result.time[0], np.linspace(-0.5, 2.0, 31), atol=1e-12)
    np.testing.assert_allclose(result.time[1], np.linspace(0.1, 1.0, 31))
    assert result.mask.all()
    torch.testing.assert_close(result.values[..., 0], 2.0 * result.time + 1.0)
    torch.testing.assert_close(result.values[..., 1], 5.0 - result.time)


@pytest.mark.parametrize("num_samples", [2, 7, 50, 199])
def test_time_normalised_meets_the_last_seen_sample(num_samples):
    trajectory = make((40,), seen=0.9, num_samples=60, seed=num_samples)
    result = time_normalised(trajectory, num_samples)
    last = trajectory.seen.long().cumsum(-1).argmax(-1)
    expected = trajectory.values[torch.arange(40), last]
    seen = trajectory.mask[torch.arange(40), last]
    assert torch.equal(result.mask[:, -1], seen)
    torch.testing.assert_close(result.values[:, -1][seen], expected[seen])
    torch.testing.assert_close(result.end, trajectory.end)


def test_time_normalised_shares_time_only_where_ends_agree():
    values = torch.ones(3, 5, 1, dtype=torch.float64)
    time = torch.tensor([0.0, 0.5, 1.0, 1.5, 2.5], dtype=torch.float64)
    assert time_normalised(Trajectory(time, values), 4).time.shape == (4,)
    mask = torch.ones(3, 5, 1, dtype=torch.bool)
    mask[1, 3:] = False
    result = time_normalised(Trajectory(time, values, mask=mask), 4)
    assert result.time.shape == (3, 4)
    assert result.time[:, -1].tolist() == [2.5, 1.0, 2.5]


def test_time_normalised_refuses():
    with pytest.raises(InputError, match="num_samples of at least 2, got 1"):
        time_normalised(ragged(), 1)
    unseen = Trajectory(
        [0.0, 1.0], torch.ones(3, 2, 1), mask=torch.tensor([True, True, False])[:, None, None].expand(3, 2, 1)
    )
    with pytest.raises(InputError, match=r"got none in batch member \(2,\)"):
        time_normalised(unseen, 5)


def test_resampled_at_rate():
    result = resampled_at_rate(ragged(), 20.0)
    assert result.num_samples == 51
    torch.testing.assert_close(result.time.diff(dim=-1), torch.full((2, 50), 0.05, dtype=torch.float64))
    assert result.time[:, 0].tolist() == [-0.5, 0.1]
    assert result.mask.all(-1).sum(-1).tolist() == [51, 19]
    torch.testing.assert_close(result.values[1, :19, 0], 2.0 * result.time[1, :19] + 1.0)
    with pytest.raises(InputError, match="rate above zero"):
        resampled_at_rate(ragged(), 0.0)


def test_resampled_at_rate_keeps_shared_time():
    trajectory = Trajectory([0.0, 1.0, 2.0], torch.ones(4, 3, 1))
    assert resampled_at_rate(trajectory, 1.5).time.tolist() == [0.0, 2 / 3, 4 / 3, 2.0]


@pytest.mark.parametrize("noise", [True, False])
@pytest.mark.parametrize("until", [0.1, 3.7, "each"])
@pytest.mark.parametrize("shared", [True, False])
def test_held_is_the_slow_loop(noise, until, shared):
    trajectory = make((2, 3), noise=noise, shared=shared)
    until = torch.linspace(0.5, 4.0, 6, dtype=torch.float64).reshape(2, 3) if until == "each" else until
    result = held(trajectory, until)
    assert (result.time.ndim == 1) is shared
    assert (result.time[..., -1] >= torch.as_tensor(until) - 1e-9).all()
    size = trajectory.num_samples
    assert torch.equal(result.time[..., :size], trajectory.time)
    for old, new in zip(members(trajectory), members(result), strict=True):
        end = int(old.seen.nonzero()[-1])
        assert torch.equal(new.mask[: end + 1], old.mask[: end + 1])
        assert torch.equal(new.values[: end + 1], old.values[: end + 1])
        assert new.mask[end + 1 :].all()
        last = [int(old.mask[:, signal].nonzero()[-1]) for signal in range(3)]
        for signal in range(3):
            assert (new.values[end + 1 :, signal] == old.values[last[signal], signal]).all()
            if noise:
                assert (new.noise[end + 1 :, signal, signal] == old.noise[last[signal], signal, signal]).all()
        if noise:
            assert torch.equal(new.noise[: end + 1], old.noise[: end + 1])
        steps = new.time.diff()[size - 1 :]
        np.testing.assert_allclose(steps, np.quantile(np.diff(old.time), 0.5, method="lower"), atol=1e-12)


def test_held_appends_no_more_than_needed():
    trajectory = Trajectory([0.0, 0.5, 1.0], torch.ones(3, 1))
    assert held(trajectory, 2.0).time.tolist() == [0.0, 0.5, 1.0, 1.5, 2.0]
    assert held(trajectory, 2.01).num_samples == 6
    assert held(trajectory, -5.0).num_samples == 3


def test_held_leaves_unseen_signals_and_motions_unseen():
    mask = torch.ones(2, 3, 2, dtype=torch.bool)
    mask[0, :, 1] = False
    mask[1] = False
    result = held(Trajectory([0.0, 0.5, 1.0], torch.ones(2, 3, 2), mask=mask), 2.0)
    assert result.mask[0].all(0).tolist() == [True, False]
    assert not result.mask[1].any()


def test_held_refuses():
    with pytest.raises(ShapeError, match=r"one number or with batch axes \(2, 3\), got \(2,\)"):
        held(make(), [1.0, 2.0])
    with pytest.raises(InputError, match="finite numbers in until"):
        held(make(), math.nan)
    with pytest.raises(InputError, match="at least two samples"):
        held(Trajectory([0.0], [[1.0]]), 1.0)


@pytest.mark.parametrize(
    "call",
    [
        lambda t: resample(t, torch.linspace(0.0, 2.0, 9)),
        lambda t: time_normalised(t, 11),
        lambda t: resampled_at_rate(t, 7.0),
        lambda t: held(t, 5.0),
        lambda t: held(t, 0.0),
        lambda t: t.hide(["s1"]),
        lambda t: t.first(3),
        lambda t: stack(members(t)),
    ],
)
def test_inputs_are_unchanged(call):
    trajectory = make(noise=True)
    before = copy(trajectory)
    call(trajectory)
    for old, new in zip(before, _tensors(trajectory), strict=True):
        assert torch.equal(old, new)


def test_queries_are_unchanged():
    time, until = torch.tensor([0.1, 0.4], dtype=torch.float64), torch.tensor([3.0], dtype=torch.float64)
    resample(make(), time)
    held(make(), until)
    assert time.tolist() == [0.1, 0.4]
    assert until.tolist() == [3.0]

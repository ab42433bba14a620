from __future__ import annotations

import numpy as np
import pytest
import torch

from eaip_prob.data.trajectory import Trajectory
from eaip_prob.errors import InputError, ShapeError
from eaip_prob.primitives import ProMP
from eaip_prob.primitives.basis import phase_basis

D, B = 3, 8


def draw(seed, *shape):
    return torch.randn(*shape, generator=torch.Generator().manual_seed(seed), dtype=torch.float64)


def grid(end, num):
    return torch.linspace(0.0, end, num, dtype=torch.float64)


def make(**keywords):
    return ProMP(**{"num_basis": B, "limit": 1.3, **keywords})


@pytest.mark.parametrize("batch", [(), (2, 3)])
@pytest.mark.parametrize("own_phases", [False, True])
def test_positions_equal_a_loop_over_motions_signals_and_samples(batch, own_phases):
    promp, weights = make(), draw(0, *batch, D * B)
    phase = grid(1.5, 5) * (0.3 + draw(1, *batch, 1).abs()) if own_phases else grid(1.5, 5)
    got = promp.decode(weights, phase, duration=2.7)
    assert got.shape == (*batch, 5, D)
    for index in np.ndindex(*batch, 5, D):
        *motion, t, d = index
        s = phase.expand(*batch, 5)[(*motion, slice(t, t + 1))]
        basis = phase_basis(s, B, 1.3, 1.0)[0]
        assert float(got[index]) == pytest.approx(float(basis @ weights[tuple(motion)][d * B : (d + 1) * B]))


@pytest.mark.parametrize("duration", [0.7, 2.7, (0.7, 2.7)])
def test_velocities_are_per_second(duration):
    promp, weights, h = make(), draw(0, 2, D * B), 1e-6
    duration = torch.tensor(duration, dtype=torch.float64)
    time = duration[..., None] * grid(1.25, 23)[1:]
    later, earlier = (promp.decode(weights, (time + step) / duration[..., None]) for step in (h, -h))
    got = promp.velocity(weights, time / duration[..., None], duration)
    assert torch.allclose(got, (later - earlier) / (2 * h), rtol=0, atol=1e-6)


def test_behind_the_limit_the_last_position_is_held_at_rest():
    promp, weights, phase = make(), draw(0, D * B), torch.tensor([1.3, 1.3001, 9.0], dtype=torch.float64)
    positions, velocities = promp.decode(weights, phase), promp.velocity(weights, phase, 2.7)
    assert torch.equal(positions[1:], positions[:1].expand(2, D))
    assert velocities[0].all() and not velocities[1:].any()


def test_weights_of_a_decoded_motion_are_found_again():
    promp, phase = make(ridge=1e-13), grid(1.3, 90)
    weights = 300.0 + 20.0 * draw(1, 2, 3, D * B)
    values = promp.decode(weights, phase)
    assert torch.allclose(promp.encode(Trajectory(2.7 * phase, values), phase, 2.7), weights, rtol=1e-5)


def test_motions_that_start_at_speed_survive_encoding_with_their_velocity():
    promp, phase = ProMP(), grid(1.0, 200)
    trajectory = Trajectory(2.7 * phase, torch.stack([torch.sin(3 * phase), 7.0 * phase + 500.0], -1))
    weights = promp.encode(trajectory, phase, 2.7)
    assert torch.allclose(promp.decode(weights, phase), trajectory.values, rtol=0, atol=1e-3)
    velocity = promp.velocity(weights, phase[:1], 2.7)[0]
    assert velocity.tolist() == pytest.approx([3 / 2.7, 7.0 / 2.7], rel=0.05)


@pytest.mark.parametrize("own_phases", [False, True])
def test_masked_batches_equal_the_loop_and_unseen_values_do_not_matter(own_phases):
    promp, phase = make(limit=1.0), grid(1.0, 40)
    values, mask = 300.0 + draw(2, 3, 40, D).cumsum(1), torch.ones(3, 40, D, dtype=torch.bool)
    mask[0, 25:], mask[1, 4:9, 1], mask[2, 3] = False, False, False
    if own_phases:
        phase = (phase * torch.tensor([1.6, 1.0, 0.8])[:, None]).clamp_max(1.0)
    time = 2.7 * grid(1.0, 40)
    whole = promp.encode(Trajectory(time, values, mask=mask), phase, 2.7)
    spoilt = Trajectory(time, torch.where(mask, values, torch.nan), mask=mask)
    assert torch.equal(whole, promp.encode(spoilt, phase, 2.7))
    for n in range(3):
        one = promp.encode(Trajectory(time, values[n], mask=mask[n]), phase.expand(3, 40)[n], 2.7)
        assert torch.allclose(whole[n], one, rtol=1e-9)


def test_weights_follow_units_and_the_origin():
    promp, phase = make(limit=1.0), grid(1.0, 40)
    values = draw(2, 4, 40, D).cumsum(1)
    units, origin = torch.tensor([1000.0, 1.0, 1e-3]).double(), torch.tensor([0.0, 5e4, 1.0]).double()
    weights = promp.encode(Trajectory(2.7 * phase, values), phase, 2.7).unflatten(-1, (D, B))
    moved = promp.encode(Trajectory(2.7 * phase, units * values + origin), phase, 2.7).unflatten(-1, (D, B))
    assert torch.allclose(moved, weights * units[:, None] + origin[:, None], rtol=1e-9, atol=1e-9)


def test_a_constant_signal_has_constant_weights():
    phase = grid(1.0, 12)
    still = Trajectory(0.7 * phase, torch.full((12, 1), -7.0))
    assert torch.allclose(make(limit=1.0).encode(still, phase, 0.7), torch.full((B,), -7.0).double(), rtol=1e-12)


def test_what_no_sample_reaches_stays_near_the_mean():
    phase, promp = grid(1.0, 400), make(limit=1.0, num_basis=20)
    beginning = Trajectory(2.7 * phase[:40], 5.0 + phase[:40, None])
    weights = promp.encode(beginning, phase[:40], 2.7)
    assert torch.allclose(weights[8:], beginning.values.mean().expand(12), atol=1e-3)
    assert float(weights.min()) > 4.0 and float(weights.max()) < 6.0


def test_padding_does_not_move_the_weights():
    promp, phase, values = make(limit=1.0), grid(1.0, 30), 300.0 + draw(4, 30, D).cumsum(0)
    padded = torch.cat([phase, torch.ones(7, dtype=torch.float64)])
    mask = (torch.arange(37) < 30)[:, None].expand(37, D)
    long = Trajectory(torch.arange(37) / 10, torch.cat([values, values[:7] * 1e3]), mask=mask)
    part = promp.encode(Trajectory(torch.arange(30) / 10, values), phase, 2.9)
    assert torch.allclose(promp.encode(long, padded, 2.9), part, rtol=1e-10)


def test_bases_span_a_new_limit():
    wide = make().spanning(1.8)
    assert wide.limit == 1.8 and wide.num_basis == B
    assert wide.velocity(draw(0, D * B), torch.tensor([1.7]), 2.7).all()


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"num_basis": 3}, "num_basis of at least 4.*got 3"),
        ({"num_basis": 1}, "num_basis of at least 4.*got 1"),
        ({"ridge": -1e-6}, "ridge of at least 0"),
        ({"limit": 0.0}, "limit above zero"),
        ({"overlap": float("inf")}, "overlap above zero and finite"),
    ],
)
def test_bad_constants_are_refused(change, message):
    with pytest.raises(InputError, match=message):
        ProMP(**change)


def test_bad_input_is_refused_by_name():
    with pytest.raises(ShapeError, match=r"multiples of 8 .*got \(9,\)"):
        make().decode(draw(0, 9), grid(1.0, 4))
    with pytest.raises(ShapeError, match="got 5 phases for 4 samples"):
        make().encode(Trajectory(grid(1.0, 4), draw(0, 4, D)), grid(1.0, 5), 1.0)
    hidden = Trajectory(grid(2.0, 9), draw(0, 2, 9, D)).hide(["1"])
    with pytest.raises(InputError, match=r"seen sample of every signal.*\(0, 1\)"):
        make().encode(hidden, grid(1.0, 9), 2.0)

from __future__ import annotations

import numpy as np
import pytest
import torch
from scipy.integrate import solve_ivp

from eaip_prob.data.trajectory import Trajectory
from eaip_prob.errors import InputError, ShapeError
from eaip_prob.primitives import DMP, Boundary, initial_boundary
from eaip_prob.primitives.basis import forcing_basis

D, B = 2, 9


def draw(seed, *shape):
    return torch.randn(*shape, generator=torch.Generator().manual_seed(seed), dtype=torch.float64)


def row(*values):
    return torch.tensor(values, dtype=torch.float64)


def grid(end, num):
    return torch.linspace(0.0, end, num, dtype=torch.float64)


def make(boundary="learned", **keywords):
    return DMP(**{"num_basis": B, "limit": 1.3, "alpha_x": 4.0, "boundary": boundary, **keywords})


def motion(duration, num=161, batch=()):
    s = grid(1.0, num)
    shape = draw(7, *batch, 1, D)
    values = (
        300.0
        + 40.0 * shape * (10 * s**3 - 15 * s**4 + 6 * s**5)[:, None]
        + 5.0 * torch.sin(4 * s)[:, None] * draw(8, *batch, 1, D)
    )
    return Trajectory(duration * s, values), s


def acceleration(dmp, weights, duration, t, y, v):
    """Eq. 1 in real time, one signal, tau = 1 / duration; x = exp(-alpha_x t / duration)."""
    phase = row(t / duration)
    f = float(forcing_basis(phase, dmp.num_basis, dmp.limit, dmp.alpha_x, dmp.overlap)[0] @ weights[: dmp.num_basis])
    return (dmp.alpha_y * (dmp.beta_y * (float(weights[dmp.num_basis]) - y) - duration * v) + f) / duration**2


def integrated(dmp, weights, duration, phase, y0, v0):
    solution = solve_ivp(
        lambda t, z: [z[1], acceleration(dmp, weights, duration, t, *z)],
        (0.0, duration * float(phase[-1])),
        [y0, v0],
        t_eval=(duration * phase).numpy(),
        rtol=1e-10,
        atol=1e-9,
    )
    return torch.from_numpy(solution.y)


@pytest.mark.parametrize("duration", [0.7, 2.7])
@pytest.mark.parametrize("boundary", ["learned", "given"])
@pytest.mark.parametrize(("alpha_y", "beta_y"), [(25.0, 6.25), (12.0, 9.0)])
def test_positions_and_velocities_equal_scipys_integration_of_eq_1(duration, boundary, alpha_y, beta_y):
    dmp, phase = make(boundary, alpha_y=alpha_y, beta_y=beta_y), grid(1.3, 7)
    weights = 300.0 * draw(0, D, dmp.num_weights)
    start = (
        Boundary(weights[:, -2], weights[:, -1])
        if boundary == "learned"
        else Boundary(draw(1, D) * 50, draw(2, D) * 90)
    )
    given = None if boundary == "learned" else start
    positions = dmp.decode(weights.flatten(), phase, duration, given)
    velocities = dmp.velocity(weights.flatten(), phase, duration, given)
    for d in range(D):
        y, v = integrated(dmp, weights[d], duration, phase, float(start.start[d]), float(start.velocity[d]))
        assert torch.allclose(positions[:, d], y, rtol=0, atol=1e-5)
        assert torch.allclose(velocities[:, d], v, rtol=0, atol=1e-4)


def test_error_of_an_euler_loop_halves_with_its_step():
    dmp, duration = make(num_basis=5), 2.7
    weights = 10.0 * draw(3, dmp.num_weights)
    exact = float(dmp.decode(weights, torch.tensor([0.6]), duration)[0, 0])

    def euler(num):
        y, v, dt = float(weights[-2]), float(weights[-1]), 0.6 * duration / num
        for k in range(num):
            y, v = y + dt * v, v + dt * acceleration(dmp, weights, duration, k * dt, y, v)
        return y

    errors = [euler(num) - exact for num in (200, 400, 800)]
    assert errors[0] / errors[1] == pytest.approx(2.0, abs=0.1)
    assert errors[1] / errors[2] == pytest.approx(2.0, abs=0.05)


@pytest.mark.parametrize("num_basis", [2, 60])
def test_the_tabulated_response_is_fine_enough_for_many_bases(num_basis):
    dmp, phase = DMP(num_basis=num_basis), grid(1.0, 5)
    weights = draw(4, dmp.num_weights)
    y, _ = integrated(dmp, weights, 1.0, phase, float(weights[-2]), float(weights[-1]))
    assert torch.allclose(dmp.decode(weights, phase)[:, 0], y, rtol=0, atol=1e-8)


@pytest.mark.parametrize("duration", [0.7, 2.7])
@pytest.mark.parametrize("boundary", ["learned", "given"])
def test_velocities_are_per_second(duration, boundary):
    dmp, time, h = make(boundary), duration * grid(1.25, 23)[1:], 1e-5
    weights, given = (
        50.0 * draw(5, D * dmp.num_weights),
        Boundary(draw(6, D), draw(7, D)) if boundary == "given" else None,
    )
    later, earlier = (dmp.decode(weights, (time + step) / duration, duration, given) for step in (h, -h))
    velocity = dmp.velocity(weights, time / duration, duration, given)
    assert torch.allclose(velocity, (later - earlier) / (2 * h), rtol=0, atol=1e-6 * float(velocity.abs().max()))


def test_behind_the_limit_the_last_position_is_held_at_rest():
    dmp, weights = make(), 20.0 * draw(8, D * (B + 3))
    phase = row(1.3, 1.3001, 4.0)
    positions, velocities = dmp.decode(weights, phase, 2.7), dmp.velocity(weights, phase, 2.7)
    assert torch.equal(positions[1:], positions[:1].expand(2, D))
    assert velocities[0].all() and not velocities[1:].any()


def test_without_forcing_a_long_motion_ends_at_its_goal():
    dmp = DMP(num_basis=B, limit=1.5)
    weights = torch.cat([torch.zeros(B), torch.tensor([40.0, 3.0, -20.0])]).double()
    assert float(dmp.decode(weights, torch.tensor([9.0]), 0.7)[0, 0]) == pytest.approx(40.0, abs=1e-4)


@pytest.mark.parametrize("boundary", ["learned", "given"])
@pytest.mark.parametrize("own", ["nothing", "durations", "phases", "both"])
def test_batches_equal_the_loop(boundary, own):
    dmp, batch = make(boundary), (2, 3)
    weights, start = 20.0 * draw(0, *batch, D * dmp.num_weights), Boundary(draw(1, *batch, D), draw(2, *batch, D))
    duration = 0.5 + draw(3, *batch).abs() if own in ("durations", "both") else torch.tensor(2.7)
    phase = grid(1.6, 11) * (0.5 + draw(4, *batch, 1).abs() if own in ("phases", "both") else 1.0)
    given = start if boundary == "given" else None
    for read in (dmp.decode, dmp.velocity):
        whole = read(weights, phase, duration, given)
        assert whole.shape == (*batch, 11, D)
        for i, j in np.ndindex(*batch):
            one = None if given is None else Boundary(start.start[i, j], start.velocity[i, j])
            s, T = phase.expand(*batch, 11)[i, j], duration.expand(batch)[i, j]
            assert torch.allclose(whole[i, j], read(weights[i, j], s, T, one), rtol=1e-12, atol=1e-10)


@pytest.mark.parametrize("boundary", ["learned", "given"])
def test_design_and_offset_give_the_positions(boundary):
    dmp, phase, duration = make(boundary), grid(1.3, 8), torch.tensor([0.7, 2.7])
    start = Boundary(draw(1, 2, D), draw(2, 2, D)) if boundary == "given" else None
    weights = draw(3, 2, D * dmp.num_weights)
    matrix, offset = dmp.design(phase, duration, start)
    direct = matrix @ weights.unflatten(-1, (D, -1)).mT + offset.mT
    assert torch.allclose(direct, dmp.decode(weights, phase, duration, start), atol=1e-12)


@pytest.mark.parametrize("duration", [0.7, 2.7])
@pytest.mark.parametrize("from_phase", [0.0, 0.31, 1.2])
def test_rollout_from_a_state_on_the_motion_continues_it(duration, from_phase):
    dmp, weights = make(), 30.0 * draw(0, 2, 3, D * (B + 3))
    here, onward = row(from_phase), row(from_phase, 1.25, 1.3, 1.9)
    present = Boundary(dmp.decode(weights, here, duration)[..., 0, :], dmp.velocity(weights, here, duration)[..., 0, :])
    path = dmp.rollout(weights, present, from_phase, onward, duration)
    assert torch.allclose(path, dmp.decode(weights, onward, duration), rtol=0, atol=1e-8)


def test_rollout_equals_scipys_integration_from_a_disturbed_state():
    dmp, duration, s0 = make(), 2.7, 0.4
    weights, phase = 100.0 * draw(1, dmp.num_weights), row(0.4, 0.45, 0.8, 1.3)
    got = dmp.rollout(weights, Boundary([7.0], [-90.0]), s0, phase, duration)
    solution = solve_ivp(
        lambda t, z: [z[1], acceleration(dmp, weights, duration, t, *z)],
        (s0 * duration, 1.3 * duration),
        [7.0, -90.0],
        t_eval=(duration * phase).numpy().clip(s0 * duration, 1.3 * duration),
        rtol=1e-10,
        atol=1e-9,
    )
    assert np.allclose(got[:, 0].numpy(), solution.y[0], rtol=0, atol=1e-5)


@pytest.mark.parametrize("from_phase", [0.5, 1.28, 1.6])
def test_a_disturbed_rollout_converges_to_the_undisturbed_end_however_late(from_phase):
    dmp, weights = make(), 30.0 * draw(2, D * (B + 3))
    path = dmp.rollout(weights, Boundary([1e3, -1e3], [500.0, 0.0]), from_phase, row(from_phase, 5.0), 0.7)
    assert torch.allclose(path[0], row(1e3, -1e3), atol=1e-9)
    assert torch.allclose(path[1], dmp.decode(weights, row(1.3), 0.7)[0], rtol=0, atol=1e-6)


def test_batched_rollouts_equal_the_loop():
    dmp, weights = make(), 30.0 * draw(2, 4, D * (B + 3))
    present, durations = Boundary(draw(3, 4, D), draw(4, 4, D)), 0.5 + draw(5, 4).abs()
    from_phase = draw(6, 4).abs() / 5
    phase = from_phase[:, None] + grid(0.9, 6)
    whole = dmp.rollout(weights, present, from_phase, phase, durations)
    for n in range(4):
        one = Boundary(present.start[n], present.velocity[n])
        assert torch.allclose(whole[n], dmp.rollout(weights[n], one, from_phase[n], phase[n], durations[n]), atol=1e-10)


@pytest.mark.parametrize("duration", [0.7, 2.7])
def test_weights_of_a_decoded_motion_are_found_again(duration):
    dmp, phase = make(ridge=1e-12), grid(1.3, 200)
    weights = 50.0 * draw(9, 3, D, dmp.num_weights)
    values = dmp.decode(weights.flatten(-2), phase, duration)
    found = dmp.encode(Trajectory(duration * phase, values), phase, torch.full((3,), duration)).unflatten(-1, (D, -1))
    assert torch.allclose(found[..., -2:], weights[..., -2:], rtol=0, atol=1e-2)
    assert torch.allclose(dmp.decode(found.flatten(-2), phase, duration), values, rtol=0, atol=1e-4)


@pytest.mark.parametrize("duration", [0.7, 2.7])
@pytest.mark.parametrize("boundary", ["learned", "given"])
def test_smooth_motions_survive_encoding(duration, boundary):
    dmp = make(boundary, limit=1.0, num_basis=20)
    trajectory, phase = motion(duration)
    weights = dmp.encode(trajectory, phase, torch.tensor(duration))
    given = initial_boundary(trajectory, 2) if boundary == "given" else None
    error = dmp.decode(weights, phase, duration, given) - trajectory.values
    assert float(error.abs().max()) < 0.1  # of a range of about 50
    velocity = torch.gradient(trajectory.values, spacing=(trajectory.time,), dim=0, edge_order=2)[0]
    error = dmp.velocity(weights, phase, duration, given) - velocity
    assert float(error.abs().max()) < 0.03 * float(velocity.abs().max())
    if boundary == "learned":
        assert torch.allclose(weights.unflatten(-1, (D, -1))[:, -1], velocity[0], rtol=0.05)


@pytest.mark.parametrize("masked", [False, True])
def test_forces_are_encoded_as_by_a_slow_loop_of_eq_3_and_4(masked):
    dmp, duration, num = make("given", ridge=0.0, limit=1.0), 2.7, 61
    trajectory, phase = motion(duration, num)
    mask = torch.ones(num, D, dtype=torch.bool)
    if masked:
        mask[[5, 20, 21, 60], [0, 0, 0, 1]] = False
    got = dmp.encode(Trajectory(trajectory.time, trajectory.values, mask=mask), phase, torch.tensor(duration))
    h, y = duration / (num - 1), trajectory.values.numpy()
    for d in range(D):
        seen = np.flatnonzero(mask[:, d].numpy())
        goal, rows, target = y[seen[-1], d], [], []
        for i in range(num):
            c = min(max(i, 1), num - 2)
            if not mask[c - 1 : c + 2, d].all():
                continue
            second = (y[c - 1, d] - 2 * y[c, d] + y[c + 1, d]) / h**2
            first = (y[c + 1, d] - y[c - 1, d]) / (2 * h) + second * h * (i - c)
            tau = 1.0 / duration
            target.append(second / tau**2 - dmp.alpha_y * (dmp.beta_y * (goal - y[i, d]) - first / tau))
            rows.append(forcing_basis(phase[i : i + 1], B, 1.0, dmp.alpha_x, 1.0)[0].numpy())
        slow = np.linalg.lstsq(np.array(rows), np.array(target), rcond=None)[0]
        weights = got.unflatten(-1, (D, -1))[d].numpy()
        assert weights[-1] == goal
        assert np.allclose(weights[:-1], slow, rtol=1e-6, atol=1e-6 * np.abs(slow).max())


def test_forces_are_known_where_all_three_samples_were_seen():
    mask = torch.ones(2, 9, 2, dtype=torch.bool)
    mask[0, 4, 0] = False
    mask[1, 0, 1] = mask[1, 7, 1] = False
    force, known = make().forces(draw(0, 2, 9, 2), mask, grid(1.0, 9))
    assert known[0, :, 0].tolist() == [True] * 3 + [False] * 3 + [True] * 3
    assert known[1, :, 1].tolist() == [False] * 2 + [True] * 4 + [False] * 3
    assert known[0, :, 1].all() and known[1, :, 0].all()
    assert not force[~known].any() and force[known].all()


def test_forces_equal_their_operator_and_unseen_values_do_not_matter():
    dmp, phase, values = make(), grid(1.0, 9) ** 1.3, 300.0 + draw(0, 2, 9, 2)
    mask = draw(1, 2, 9, 2) > -1.0
    force, known = dmp.forces(values, mask, phase)
    assert torch.allclose(force[known], (dmp.force_operator(phase) @ values)[known], rtol=1e-12)
    assert torch.equal(force, dmp.forces(torch.where(mask, values, torch.nan), mask, phase)[0])


def test_a_clock_at_rest_has_no_forces_there_and_the_others_stay():
    dmp, values = make(), draw(0, 7, 1)
    phase = row(0.0, 0.1, 0.25, 0.4, 0.4, 0.4, 0.4)
    force, known = dmp.forces(values, torch.ones(7, 1, dtype=torch.bool), phase)
    assert known[:, 0].tolist() == [True] * 3 + [False] * 4
    assert torch.allclose(force[:3], dmp.forces(values[:4], known[:1].expand(4, 1), phase[:4])[0][:3], rtol=1e-12)


@pytest.mark.parametrize("boundary", ["learned", "given"])
@pytest.mark.parametrize("own_phases", [False, True])
def test_masked_batches_equal_the_loop(boundary, own_phases):
    dmp, (trajectory, phase) = make(boundary, limit=1.0), motion(2.7, 60, (3,))
    mask = torch.ones(3, 60, D, dtype=torch.bool)
    mask[0, 40:], mask[1, 10:14, 1], mask[2, 3] = False, False, False
    if own_phases:
        phase = (phase * torch.tensor([1.5, 1.0, 0.9])[:, None]).clamp_max(1.0)
    durations = torch.tensor([1.8, 2.7, 3.0])
    whole = dmp.encode(Trajectory(trajectory.time, trajectory.values, mask=mask), phase, durations)
    for n in range(3):
        single = Trajectory(trajectory.time, trajectory.values[n], mask=mask[n])
        one = dmp.encode(single, phase.expand(3, 60)[n], durations[n])
        assert torch.allclose(whole[n], one, rtol=1e-7, atol=1e-7 * float(one.abs().max()))


def test_padding_does_not_move_the_weights():
    dmp, (trajectory, phase) = make(limit=1.0), motion(2.7, 60)
    padded = torch.cat([phase, row(*[1.0] * 8)])
    values = torch.cat([trajectory.values, torch.full((8, D), 1e6, dtype=torch.float64)])
    long = Trajectory(2.7 * torch.arange(68) / 59, values, mask=(torch.arange(68) < 60)[:, None].expand(68, D))
    whole, part = dmp.encode(long, padded, 2.7), dmp.encode(trajectory, phase, 2.7)
    assert torch.allclose(whole, part, rtol=1e-6, atol=1e-6)


@pytest.mark.parametrize("boundary", ["learned", "given"])
def test_weights_follow_units_and_the_origin(boundary):
    dmp, (trajectory, phase) = make(boundary, limit=1.0), motion(2.7)
    start = initial_boundary(trajectory) if boundary == "given" else None
    path = dmp.decode(dmp.encode(trajectory, phase, 2.7), phase, 2.7, start)
    units, origin = row(1000.0, 1.0), row(0.0, 5e4)
    moved = Trajectory(trajectory.time, units * trajectory.values + origin)
    start = initial_boundary(moved) if boundary == "given" else None
    weights = dmp.encode(moved, phase, 2.7)
    assert torch.allclose(dmp.decode(weights, phase, 2.7, start), units * path + origin, rtol=1e-9)


@pytest.mark.parametrize("boundary", ["learned", "given"])
def test_a_constant_signal_stays_constant(boundary):
    dmp, phase = make(boundary, limit=1.0), grid(1.0, 30)
    still = Trajectory(0.7 * phase, torch.full((30, D), -7.0))
    weights = dmp.encode(still, phase, 0.7)
    start = initial_boundary(still) if boundary == "given" else None
    assert torch.allclose(dmp.decode(weights, phase, 0.7, start), still.values, rtol=0, atol=1e-10)
    assert not dmp.velocity(weights, phase, 0.7, start).abs().max() > 1e-8


def test_bases_span_a_new_limit():
    wide = make().spanning(1.8)
    assert wide.limit == 1.8 and wide.num_basis == B
    assert wide.velocity(draw(0, D * (B + 3)), torch.tensor([1.7]), 2.7).all()
    with pytest.raises(InputError, match="limit above zero"):
        make().spanning(0.0)


def test_single_precision_and_lists_are_read_as_double():
    dmp, weights = make("given"), draw(0, D * (B + 1))
    single = dmp.decode(weights.float(), grid(1.0, 5).float(), 2.7, Boundary([1.0, 2.0], [0.0, 3.0]))
    assert single.dtype == torch.float64
    start = Boundary(row(1.0, 2.0), row(0.0, 3.0))
    assert torch.allclose(single, dmp.decode(weights, grid(1.0, 5), 2.7, start), rtol=1e-4, atol=1e-4)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"num_basis": 1}, "num_basis of at least 2.*got 1"),
        ({"ridge": -1.0}, "ridge of at least 0.*got 20 and -1.0"),
        ({"alpha_y": 0.0}, "alpha_y above zero"),
        ({"alpha_x": float("nan")}, "alpha_x above zero and finite"),
        ({"overlap": -1.0}, "overlap above zero"),
        ({"boundary": "free"}, "'learned' or 'given', got 'free'"),
    ],
)
def test_bad_constants_are_refused(change, message):
    with pytest.raises(InputError, match=message):
        DMP(**change)


def test_bad_input_is_refused_by_name():
    with pytest.raises(InputError, match="Expected a Boundary.*got None"):
        make("given").decode(draw(0, B + 1), grid(1.0, 4))
    with pytest.raises(ShapeError, match=r"multiples of 12.*got \(25,\)"):
        make().decode(draw(0, 25), grid(1.0, 4))
    with pytest.raises(InputError, match="finite numbers in phase"):
        make().decode(draw(0, 12), torch.tensor([0.0, torch.nan]))
    with pytest.raises(ShapeError, match="phase with shape"):
        make().decode(draw(0, 12), torch.tensor(0.5))
    with pytest.raises(InputError, match="at least 3 samples to differentiate twice, got 2"):
        make("given").encode(Trajectory([0.0, 1.0], draw(0, 2, D)), grid(1.0, 2), 1.0)
    hidden = Trajectory(grid(2.0, 9), draw(0, 9, D)).hide(["1"])
    for boundary in ("learned", "given"):
        with pytest.raises(InputError, match=r"seen sample of every signal.*\(1,\)"):
            make(boundary).encode(hidden, grid(1.0, 9), 2.0)

from __future__ import annotations

import math

import numpy as np
import pytest
import torch
from scipy.stats import multivariate_normal

from eaip_prob.data.trajectory import Trajectory
from eaip_prob.errors import InputError
from eaip_prob.evidence import ForcingEvidence
from eaip_prob.primitives import DMP, Boundary, ProMP

T, D, J, B = 9, 2, 3, 5


def draw(seed, *shape):
    return torch.randn(shape, generator=torch.Generator().manual_seed(seed), dtype=torch.float64)


def seconds():
    return 4.0 + 0.1 * torch.arange(T, dtype=torch.float64)


def phases(*batch):
    """J different clocks of irregular samples."""
    return ((0.05 + draw(1, *batch, J, T).abs() / 20).cumsum(-1), 0.5 + draw(2, *batch, J).abs())


def dmp(boundary="given", **keywords):
    return DMP(num_basis=B, limit=1.3, alpha_x=4.0, boundary=boundary, **keywords)


def log_density(rows, weights):
    """Log density of the rows seen, a list over motions and hypotheses."""
    size = rows.value.shape[-1]
    noise = rows.noise if rows.correlated else torch.diag_embed(rows.noise)
    error = rows.value - rows.offset - rows.matrices["arm"] @ weights
    batch, mask = error.shape[:-1], torch.ones(size, dtype=torch.bool) if rows.mask is None else rows.mask
    parts = [error, noise.expand(*batch, size, size), mask.expand(*batch, size)]
    return [
        float(multivariate_normal(cov=cov[seen][:, seen].numpy()).logpdf(residual[seen].numpy()))
        for residual, cov, seen in zip(*(part.reshape(-1, *part.shape[len(batch) :]) for part in parts), strict=True)
    ]


def observed(trajectory, paths, duration, sigma=(0.5, 2.0), boundary="given", **keywords):
    noise = torch.tensor(sigma, dtype=torch.float64)
    return ForcingEvidence(**keywords).observe(dmp(boundary), "arm", trajectory, paths, duration, noise)


@pytest.mark.parametrize("boundary", ["given", "learned"])
@pytest.mark.parametrize("duration", [0.7, 2.7])
def test_rows_of_a_rollout_are_met_by_its_weights_to_the_square_of_the_sampling_step(boundary, duration):
    primitive, weights = dmp(boundary), 40.0 * draw(0, D * (B + (1 if boundary == "given" else 3)))
    start = Boundary(draw(3, D), draw(4, D)) if boundary == "given" else None

    def error(num):
        phase = torch.linspace(0.1, 0.5, num, dtype=torch.float64)
        seen = Trajectory(duration * phase, primitive.decode(weights, phase, duration, start))
        rows = observed(seen, phase[None], torch.tensor([duration]), boundary=boundary).dense()
        residual = rows.value - rows.offset - rows.matrices["arm"] @ weights
        return float(residual.unflatten(-1, (D, num))[..., 1:-1].abs().max()), float(rows.value.abs().max())

    (coarse, _), (fine, size) = error(101), error(201)
    assert coarse / fine == pytest.approx(4.0, abs=0.5)
    assert fine < 0.02 * size


@pytest.mark.parametrize("batch", [(), (2, 3)])
@pytest.mark.parametrize("noise", ["white", "propagated"])
def test_each_phase_hypothesis_of_each_motion_equals_eq_12_by_a_slow_loop(batch, noise):
    paths, duration = phases(*batch)
    values = 300.0 + draw(0, *batch, T, D)
    rows = observed(Trajectory(seconds(), values), paths, duration, noise=noise, position_noise=0.1).dense()
    primitive = dmp()
    value = rows.value.expand(*batch, J, D * T)
    for index in np.ndindex(*batch, J):
        s, y = paths[index].numpy(), values[index[:-1]].numpy()
        for d in range(D):
            for t in range(1, T - 1):
                left, right = s[t] - s[t - 1], s[t + 1] - s[t]
                rise, fall = (y[t + 1, d] - y[t, d]) / right, (y[t, d] - y[t - 1, d]) / left
                first, second = (rise * left + fall * right) / (left + right), 2 * (rise - fall) / (left + right)
                force = second + primitive.alpha_y * (primitive.beta_y * y[t, d] + first)
                assert float(value[index][d * T + t]) == pytest.approx(force, rel=1e-9)


@pytest.mark.parametrize("boundary", ["given", "learned"])
def test_the_start_has_no_part_in_a_force(boundary):
    paths, duration = phases()
    rows = observed(Trajectory(seconds(), draw(0, T, D)), paths, duration, boundary=boundary).dense()
    matrix = rows.matrices["arm"][1, :T]
    x = torch.exp(-4.0 * paths[1])
    assert torch.allclose(matrix[:, :B].sum(-1), x)
    assert torch.allclose(matrix[:, B], torch.full((T,), 25.0 * 6.25).double())
    assert not matrix[:, B + 1 :].any()


def test_white_noise_is_eq_11():
    paths, duration = phases(2)
    rows = observed(Trajectory(seconds(), draw(0, 2, T, D)), paths, duration, (0.5, 2.0)).dense()
    assert not rows.correlated
    expected = torch.tensor([0.25] * T + [4.0] * T, dtype=torch.float64)
    assert torch.equal(rows.noise.expand(2, J, D * T)[1, 2], expected)


@pytest.mark.parametrize("own_sensor", [False, True])
def test_propagated_noise_is_the_covariance_of_forces_of_noisy_positions(own_sensor):
    num, (paths, duration) = 20000, phases()
    spread = 0.01 + draw(5, T, D).abs() if own_sensor else torch.full((T, D), 0.03, dtype=torch.float64)
    sensor = torch.diag_embed(spread.square()) if own_sensor else None
    seen = Trajectory(seconds(), 300.0 + draw(0, T, D), noise=sensor)
    sigma = (0.5, 2.0)
    position_noise = 1e6 if own_sensor else 0.03
    rows = observed(seen, paths, duration, sigma, noise="propagated", position_noise=position_noise)
    noisy = seen.values + spread * draw(6, num, T, D)
    for j in range(J):
        forces, _ = dmp().forces(noisy, torch.ones(num, T, D, dtype=torch.bool), paths[j])
        for d in range(D):
            sample = torch.cov((forces[..., d] + sigma[d] * draw(7, num, T)).T)
            model = rows.noise.expand(J, D, T, T)[j, d]
            variance = model.diagonal()
            error = ((model.square() + variance[:, None] * variance) / num).sqrt()
            z = ((sample - model) / error).abs()
            assert float(z.max()) < 5.0
            assert float(z.square().mean()) == pytest.approx(1.0, abs=1.0)


def test_white_is_propagated_without_position_noise():
    paths, duration = phases()
    seen = Trajectory(seconds(), draw(0, T, D), noise=torch.zeros(T, D, D))
    white, propagated = (
        observed(seen, paths, duration).dense(),
        observed(seen, paths, duration, noise="propagated").dense(),
    )
    assert torch.equal(torch.diag_embed(white.noise).expand(J, D * T, D * T), propagated.noise.expand(J, D * T, D * T))


@pytest.mark.parametrize("noise", ["white", "propagated"])
def test_unseen_samples_take_away_the_forces_that_need_them_and_nothing_else(noise):
    paths, duration = phases(2)
    values, mask = 300.0 + draw(0, 2, T, D), torch.ones(2, T, D, dtype=torch.bool)
    mask[0, 5:], mask[1, 3, 1] = False, False
    weights = draw(8, D * (B + 1))

    def rows(trajectory, paths, duration):
        return observed(trajectory, paths, duration, noise=noise, position_noise=0.1).dense()

    whole = rows(Trajectory(seconds(), values, mask=mask), paths, duration)
    known = whole.mask.expand(2, J, D * T).unflatten(-1, (D, T))
    assert known[0, 1].sum(-1).tolist() == [4, 4]
    assert known[1, 1].tolist() == [[True] * T, [True] * 2 + [False] * 3 + [True] * (T - 5)]
    spoilt = rows(Trajectory(seconds(), torch.where(mask, values, torch.nan), mask=mask), paths, duration)
    assert log_density(spoilt, weights) == log_density(whole, weights)
    tail = (torch.arange(6) < 5)[:, None].expand(6, D)
    short = rows(Trajectory(seconds()[:6], values[0, :6], mask=tail), paths[0, :, :6], duration[0])
    assert log_density(short, weights) == pytest.approx(log_density(whole, weights)[:J], rel=1e-9)


def test_a_hidden_signal_leaves_only_the_rows_of_the_other():
    paths, duration = phases()
    seen = Trajectory(seconds(), draw(0, T, D), names=["x", "y"]).hide(["y"])
    assert observed(seen, paths, duration).dense().mask.expand(J, D * T)[1].tolist() == [True] * T + [False] * T


def test_a_clock_at_rest_says_nothing_there():
    paths, duration = phases()
    paths[1, 4:] = paths[1, 4]
    rows = observed(
        Trajectory(seconds(), draw(0, T, D)), paths, duration, noise="propagated", position_noise=0.1
    ).dense()
    assert rows.mask.expand(J, D * T).unflatten(-1, (D, T)).sum(-1).tolist() == [[T, T], [4, 4], [T, T]]
    assert np.isfinite(log_density(rows, draw(8, D * (B + 1)))).all()


@pytest.mark.parametrize("num", [1, 2])
def test_fewer_than_three_samples_hold_no_force(num):
    seen = Trajectory(seconds()[:num], draw(0, num, D))
    assert observed(seen, phases()[0][:, :num], phases()[1]) is None


def test_scale_is_one_number_for_all_signals():
    phase = torch.linspace(0.0, 0.4, T, dtype=torch.float64)
    values = draw(0, 4, T, D) * torch.tensor([1.0, 9.0], dtype=torch.float64)
    mask = torch.ones(4, T, D, dtype=torch.bool)
    mask[0, 3, 0] = False
    got = ForcingEvidence().scale(dmp(), Trajectory(seconds(), values, mask=mask), phase)
    force, known = dmp().forces(values, mask, phase)
    each = [np.var(force[..., d][known[..., d]].numpy()) for d in range(D)]
    assert got.tolist() == pytest.approx([math.sqrt(sum(each) / D)] * D)


def test_bad_arguments_are_refused_by_name():
    with pytest.raises(InputError, match="'white' or 'propagated'.*got 'pink' and 0.0"):
        ForcingEvidence(noise="pink")
    with pytest.raises(InputError, match="position_noise of at least 0.*-1.0"):
        ForcingEvidence(noise="propagated", position_noise=-1.0)
    paths, duration = phases()
    with pytest.raises(InputError, match="give position_noise above zero"):
        observed(Trajectory(seconds(), draw(0, T, D)), paths, duration, noise="propagated")
    with pytest.raises(InputError, match="Expected a DMP for forcing evidence, got ProMP"):
        ForcingEvidence().scale(ProMP(), Trajectory(seconds(), draw(0, T, D)), paths[0])

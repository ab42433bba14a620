from __future__ import annotations

import dataclasses

import numpy as np
import pytest
import torch
from scipy.stats import multivariate_normal

from eaip_prob.data.trajectory import Trajectory
from eaip_prob.evidence import PositionEvidence
from eaip_prob.evidence.position import masked_deviation
from eaip_prob.observation import LinearObservation, SharedDesignObservation
from eaip_prob.primitives import DMP, Boundary, ProMP

T, D, J = 6, 2, 3


def draw(seed, *shape):
    return torch.randn(shape, generator=torch.Generator().manual_seed(seed), dtype=torch.float64)


def seconds(*batch):
    return 4.0 + (0.05 + draw(9, *batch, T).abs() / 5).cumsum(-1)


def phases(*batch):
    """J different clocks of irregular samples."""
    return ((0.02 + draw(1, *batch, J, T).abs() / 10).cumsum(-1), 0.5 + draw(2, *batch, J).abs())


def sensor(*batch):
    root = draw(3, *batch, T, D, D)
    return root @ root.mT + 0.1 * torch.eye(D, dtype=torch.float64)


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


PRIMITIVES = {
    "promp": ProMP(num_basis=7, limit=1.3),
    "dmp": DMP(num_basis=5, limit=1.3),
    "given": DMP(num_basis=5, limit=1.3, boundary="given"),
}


@pytest.mark.parametrize("name", PRIMITIVES)
@pytest.mark.parametrize("batch", [(), (2, 3)])
@pytest.mark.parametrize("noise", [None, "own", "between signals"])
def test_rows_of_a_decoded_motion_are_met_by_its_weights_and_by_no_others(name, batch, noise):
    primitive, (paths, duration) = PRIMITIVES[name], phases(*batch)
    start = Boundary(draw(4, *batch, D), draw(5, *batch, D)) if primitive.needs_boundary else None
    weights = 40.0 * draw(0, *batch, D * primitive.num_weights)
    covariance = None if noise is None else sensor(*batch)
    if noise == "own":
        covariance = torch.diag_embed(covariance.diagonal(dim1=-2, dim2=-1))
    for j in range(J):
        values = primitive.decode(weights, paths[..., j, :], duration[..., j], start)
        seen = Trajectory(seconds(), values, noise=covariance)
        got = PositionEvidence().observe(primitive, "arm", seen, paths, duration, torch.ones(D), start)
        rows = got.dense()
        error = rows.value - rows.offset - (rows.matrices["arm"] @ weights[..., None, :, None])[..., 0]
        assert error.shape == (*batch, J, D * T)
        assert error[..., j, :].abs().max() < 1e-9
        assert all(error[..., k, :].abs().max() > 1e-3 for k in range(J) if k != j)


@pytest.mark.parametrize("batch", [(), (2, 3)])
@pytest.mark.parametrize("kind", ["none", "own", "between signals"])
def test_noise_equals_a_slow_loop(batch, kind):
    primitive, (paths, duration) = PRIMITIVES["promp"], phases(*batch)
    covariance = sensor(*batch)
    if kind == "own":
        covariance = torch.diag_embed(covariance.diagonal(dim1=-2, dim2=-1))
    sigma = torch.tensor([0.3, 2.0], dtype=torch.float64)
    seen = Trajectory(seconds(*batch), draw(0, *batch, T, D), noise=None if kind == "none" else covariance)
    got = PositionEvidence().observe(primitive, "arm", seen, paths, duration, sigma)
    assert isinstance(got, LinearObservation if kind == "between signals" else SharedDesignObservation)
    rows = got.dense()
    noise = rows.noise if rows.correlated else torch.diag_embed(rows.noise)
    noise = noise.expand(*batch, J, D * T, D * T)
    for index in np.ndindex(*batch):
        expected = torch.zeros(D * T, D * T, dtype=torch.float64)
        for t in range(T):
            for d in range(D):
                for e in range(D):
                    add = 0.0 if kind == "none" else float(covariance[index][t, d, e])
                    expected[d * T + t, e * T + t] = add + (float(sigma[d]) ** 2 if d == e else 0.0)
        for j in range(J):
            assert torch.allclose(noise[index][j], expected, rtol=1e-12)


@pytest.mark.parametrize("between_signals", [False, True])
def test_unseen_samples_change_nothing(between_signals):
    primitive, (paths, duration) = PRIMITIVES["promp"], phases(2)
    covariance = sensor(2) if between_signals else None
    mask = torch.ones(2, T, D, dtype=torch.bool)
    mask[0, 3:], mask[1, 2, 1] = False, False
    values, sigma, weights = draw(0, 2, T, D), torch.tensor([0.3, 2.0], dtype=torch.float64), draw(8, D * 7)

    def density(trajectory, paths, duration):
        rows = PositionEvidence().observe(primitive, "arm", trajectory, paths, duration, sigma).dense()
        return log_density(rows, weights)

    whole = density(Trajectory(seconds(2), values, mask=mask, noise=covariance), paths, duration)
    spoilt = torch.where(mask, values, torch.nan)
    assert density(Trajectory(seconds(2), spoilt, mask=mask, noise=covariance), paths, duration) == whole
    noise = None if covariance is None else covariance[0, :3]
    short = Trajectory(seconds(2)[0, :3], values[0, :3], noise=noise)
    assert density(short, paths[0, :, :3], duration[0]) == pytest.approx(whole[:J], rel=1e-10)
    full = density(Trajectory(seconds(2), values, noise=covariance), paths, duration)
    assert all(abs(a - b) > 0.1 for a, b in zip(whole, full, strict=True))


def test_a_hidden_signal_leaves_only_the_rows_of_the_other():
    primitive, (paths, duration) = PRIMITIVES["promp"], phases()
    seen = Trajectory(seconds(), draw(0, T, D), names=["x", "y"]).hide(["y"])
    rows = PositionEvidence().observe(primitive, "arm", seen, paths, duration, torch.ones(D).double()).dense()
    assert rows.mask.expand(J, D * T)[1].tolist() == [True] * T + [False] * T
    assert rows.matrices["arm"][:, :T, :7].any() and not rows.matrices["arm"][:, :T, 7:].any()


def test_noise_may_differ_between_motions():
    primitive, (paths, duration) = PRIMITIVES["promp"], phases(4)
    sigma = 0.1 + draw(6, 4, D).abs()
    seen = Trajectory(seconds(), draw(0, 4, T, D))
    got = PositionEvidence().observe(primitive, "arm", seen, paths, duration, sigma).dense().noise
    assert torch.allclose(got.expand(4, J, D * T)[2, 1], sigma[2].square().repeat_interleave(T))


def test_scale_is_the_standard_deviation_of_what_was_seen():
    values, mask = 300.0 + 7.0 * draw(0, 5, T, D), draw(1, 5, T, D) > -0.3
    seen = Trajectory(seconds(), values, mask=mask)
    got = PositionEvidence().scale(PRIMITIVES["promp"], seen, phases(5)[0][:, 0])
    assert got.tolist() == pytest.approx([np.std(values[..., d][mask[..., d]].numpy()) for d in range(D)])
    scaled = dataclasses.replace(seen, values=values * 1000.0)
    assert torch.allclose(PositionEvidence().scale(PRIMITIVES["promp"], scaled, phases(5)[0][:, 0]), 1000.0 * got)


def test_a_signal_never_seen_has_no_deviation():
    mask = torch.tensor([True, False])[:, None].expand(2, T)
    got = masked_deviation(5.0 + draw(0, 3, 2, T), mask.expand(3, 2, T))
    assert got[0] > 0.1 and got[1] == 0.0

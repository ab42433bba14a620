from __future__ import annotations

import math

import pytest
import torch

from eaip_prob.primitives.basis import forcing_basis, normalised_gaussians, phase_basis


def grid(limit, num=41):
    return torch.linspace(0.0, limit, num, dtype=torch.float64)


@pytest.mark.parametrize(("num_basis", "limit", "overlap"), [(4, 1.0, 1.0), (13, 1.7, 0.8), (20, 1.2, 1.5)])
def test_phase_basis_equals_its_formula(num_basis, limit, overlap):
    got = phase_basis(grid(limit), num_basis, limit, overlap)
    spacing = limit / (num_basis - 3)
    for t, phase in enumerate(grid(limit).tolist()):
        raw = [math.exp(-0.5 * ((phase - spacing * (i - 1)) / (overlap * spacing)) ** 2) for i in range(num_basis)]
        assert got[t].tolist() == pytest.approx([value / sum(raw) for value in raw], rel=1e-12, abs=1e-300)


@pytest.mark.parametrize(("num_basis", "limit"), [(7, 1.0), (20, 1.6)])
def test_phase_derivative_equals_finite_differences_also_at_both_ends(num_basis, limit):
    phase, h = grid(limit)[1:-1], 1e-6
    numeric = (phase_basis(phase + h, num_basis, limit, 1.1) - phase_basis(phase - h, num_basis, limit, 1.1)) / (2 * h)
    assert torch.allclose(phase_basis(phase, num_basis, limit, 1.1, order=1), numeric, atol=1e-7)
    ends = grid(limit)[[0, -1]]
    inner = ends + torch.tensor([h, -h], dtype=torch.float64)
    one_sided = (phase_basis(inner, num_basis, limit, 1.1) - phase_basis(ends, num_basis, limit, 1.1)) / (inner - ends)[
        :, None
    ]
    assert torch.allclose(phase_basis(ends, num_basis, limit, 1.1, order=1), one_sided, atol=1e-3)


def test_outside_the_span_the_nearer_end_is_held_at_rest():
    outside, ends = torch.tensor([-0.2, 1.9], dtype=torch.float64), torch.tensor([0.0, 1.4], dtype=torch.float64)
    assert torch.equal(phase_basis(outside, 9, 1.4, 1.0), phase_basis(ends, 9, 1.4, 1.0))
    assert not phase_basis(outside, 9, 1.4, 1.0, order=1).any()
    assert phase_basis(ends, 9, 1.4, 1.0, order=1).any(-1).all()


@pytest.mark.parametrize(("num_basis", "limit", "alpha_x", "overlap"), [(2, 1.0, 3.0, 1.0), (12, 1.3, 4.6, 0.7)])
def test_forcing_basis_equals_its_formula_and_sums_to_x(num_basis, limit, alpha_x, overlap):
    got = forcing_basis(grid(limit), num_basis, limit, alpha_x, overlap)
    centres = [math.exp(-alpha_x * limit * i / (num_basis - 1)) for i in range(num_basis)]
    widths = [overlap * (centres[i] - centres[i + 1]) for i in range(num_basis - 1)]
    widths.append(widths[-1])
    for t, phase in enumerate(grid(limit).tolist()):
        x = math.exp(-alpha_x * phase)
        raw = [math.exp(-0.5 * ((x - c) / h) ** 2) for c, h in zip(centres, widths, strict=True)]
        assert got[t].tolist() == pytest.approx([x * value / sum(raw) for value in raw], rel=1e-9, abs=1e-300)
    assert torch.allclose(got.sum(-1), torch.exp(-alpha_x * grid(limit)), rtol=1e-14)


def test_far_from_all_centres_the_nearest_basis_wins():
    far = torch.tensor([-1e4, 1e4], dtype=torch.float64)
    basis = normalised_gaussians(far, torch.tensor([0.0, 1.0, 2.0]), torch.tensor([0.1, 0.1, 0.1]))
    assert basis.tolist() == [[1.0, 0.0, 0.0], [0.0, 0.0, 1.0]]


def test_batches_equal_the_loop():
    phase = torch.rand(2, 3, 7, generator=torch.Generator().manual_seed(0), dtype=torch.float64)
    for basis in (lambda p: phase_basis(p, 9, 1.1, 1.0), lambda p: forcing_basis(p, 9, 1.1, 3.0, 1.0)):
        whole = basis(phase)
        assert whole.shape == (2, 3, 7, 9)
        assert all(torch.equal(whole[i, j], basis(phase[i, j])) for i in range(2) for j in range(3))

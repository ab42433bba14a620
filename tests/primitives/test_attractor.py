from __future__ import annotations

import numpy as np
import pytest
import torch
from scipy.linalg import expm

from eaip_prob.primitives.attractor import AttractorParameters, attractor_response, free_response


def parameters(num_basis=6, limit=1.0, alpha_y=25.0, beta_y=6.25, alpha_x=3.0, overlap=1.0):
    return AttractorParameters(num_basis, limit, alpha_y, beta_y, alpha_x, overlap)


@pytest.mark.parametrize("limit", [1.0, 1.37, 2.5])
def test_start_columns_are_the_free_response(limit):
    phase = torch.linspace(0.0, limit, 33, dtype=torch.float64)
    got = attractor_response(parameters(limit=limit)).at(phase)[:, -2:]
    assert torch.allclose(got, free_response(phase, 25.0, 6.25), rtol=0, atol=1e-13)


@pytest.mark.parametrize(("alpha_y", "beta_y"), [(25.0, 6.25), (25.0, 3.0), (8.0, 20.0)])
def test_free_response_equals_scipys_exponential_however_damped(alpha_y, beta_y):
    system = np.array([[0.0, 1.0], [-alpha_y * beta_y, -alpha_y]])
    phase = torch.tensor([[0.0, 0.013], [0.4, 1.9]], dtype=torch.float64)
    expected = [[expm(system * s)[0] for s in row] for row in phase.tolist()]
    assert np.allclose(free_response(phase, alpha_y, beta_y).numpy(), expected, rtol=0, atol=1e-13)


def test_a_goal_alone_is_approached_as_one_minus_the_free_response():
    phase = torch.linspace(0.0, 1.2, 29, dtype=torch.float64)
    goal = attractor_response(parameters(limit=1.2)).at(phase)[:, -3]
    assert torch.allclose(goal, 1.0 - free_response(phase, 25.0, 6.25)[:, 0], rtol=0, atol=1e-12)


@pytest.mark.parametrize("limit", [1.0, 1.37, 0.9])
def test_derivative_equals_finite_differences_between_and_across_nodes(limit):
    response = attractor_response(parameters(limit=limit))
    phase, h = (
        torch.rand(64, generator=torch.Generator().manual_seed(0), dtype=torch.float64) * 0.99 * limit + 1e-5,
        1e-6,
    )
    numeric = (response.at(phase + h) - response.at(phase - h)) / (2 * h)
    assert torch.allclose(response.at(phase, order=1), numeric, rtol=0, atol=2e-8)


@pytest.mark.parametrize("limit", [1.0, 1.37, 1.0 / 3.0])
def test_outside_the_table_its_ends_are_held_at_rest_and_the_ends_themselves_move(limit):
    response = attractor_response(parameters(limit=limit))
    ends = torch.tensor([0.0, limit], dtype=torch.float64)
    outside = torch.tensor([-0.1, limit + 0.1], dtype=torch.float64)
    assert torch.equal(response.at(outside), response.at(ends))
    assert not response.at(outside, order=1).any()
    inner = response.at(torch.tensor([1e-9, limit - 1e-9], dtype=torch.float64), order=1)
    assert torch.allclose(response.at(ends, order=1), inner, rtol=0, atol=1e-6)
    assert response.at(ends, order=1).any(-1).all()


def test_phases_keep_their_shape():
    phase = torch.rand(2, 3, 5, generator=torch.Generator().manual_seed(1), dtype=torch.float64)
    response = attractor_response(parameters())
    assert response.at(phase).shape == (2, 3, 5, 9)
    assert torch.equal(response.at(phase)[1, 2], response.at(phase[1, 2]))

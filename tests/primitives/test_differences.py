from __future__ import annotations

import numpy as np
import pytest
import torch

from eaip_prob.errors import InputError
from eaip_prob.primitives.differences import advancing, difference_matrices, three_point_rules


def irregular(*shape, seed=0):
    steps = torch.rand(*shape, generator=torch.Generator().manual_seed(seed), dtype=torch.float64)
    return 0.7 + (0.05 + steps).cumsum(-1)


@pytest.mark.parametrize("shape", [(3,), (11,), (2, 3, 8)])
def test_parabolas_are_exact_on_irregular_grids_and_at_both_ends(shape):
    x = irregular(*shape)
    y = 3.0 - 5.0 * x + 1.7 * x**2
    first, second = difference_matrices(x)
    assert torch.allclose((first @ y[..., None])[..., 0], -5.0 + 3.4 * x, rtol=0, atol=1e-10)
    assert torch.allclose((second @ y[..., None])[..., 0], torch.full_like(x, 3.4), rtol=0, atol=1e-9)


def test_first_derivative_equals_numpys_gradient_on_any_grid():
    x = irregular(17)
    y = torch.sin(3 * x)
    first, _ = difference_matrices(x)
    expected = np.gradient(y.numpy(), x.numpy(), edge_order=2)
    assert np.allclose((first @ y).numpy(), expected, atol=1e-11)


def test_second_derivative_equals_second_differences_in_the_interior_of_a_regular_grid():
    x = torch.linspace(0.0, 2.7, 31, dtype=torch.float64)
    y = torch.exp(-x) * 40.0
    _, second = difference_matrices(x)
    expected = np.diff(y.numpy(), 2) / (2.7 / 30) ** 2
    assert np.allclose((second @ y).numpy()[1:-1], expected, rtol=1e-10)


def test_error_falls_with_the_square_of_the_step():
    def errors(num):
        x = torch.linspace(0.0, 0.7, num, dtype=torch.float64)
        first, second = difference_matrices(x)
        y = torch.sin(4 * x)
        return torch.stack([(first @ y - 4 * torch.cos(4 * x)), second @ y + 16 * y])[:, 1:-1].abs().amax(-1)

    ratio = errors(51) / errors(101)
    assert (ratio > 3.5).all() and (ratio < 4.5).all()


def test_a_row_uses_its_sample_and_the_neighbours_only():
    used, _, _ = three_point_rules(irregular(6))
    assert used.tolist() == [[0, 1, 2], [0, 1, 2], [1, 2, 3], [2, 3, 4], [3, 4, 5], [3, 4, 5]]


@pytest.mark.parametrize(
    ("points", "message"),
    [([0.0, 1.0], "at least 3 samples.*got 2"), ([0.0, 1.0, 1.0], "strictly increasing"), ([0.0, 2.0, 1.0], "rest")],
)
def test_bad_points_are_refused(points, message):
    with pytest.raises(InputError, match=message):
        difference_matrices(torch.tensor(points, dtype=torch.float64))


def test_resting_points_are_moved_on_without_changing_other_derivatives():
    points = torch.tensor([[0.0, 0.3, 0.3, 0.4, 0.9, 0.2], [0.0, 0.1, 0.3, 0.4, 0.5, 0.7]], dtype=torch.float64)
    moved, moves = advancing(points)
    assert moves.tolist() == [[True, True, False, True, True, False], [True] * 6]
    assert torch.allclose(moved.diff(dim=-1)[moves[:, 1:]], points.diff(dim=-1)[moves[:, 1:]], atol=1e-15)
    assert moved.diff(dim=-1)[~moves[:, 1:]].tolist() == pytest.approx([1.0, 1.0])
    assert torch.equal(moved[1], points[1])

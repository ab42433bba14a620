from __future__ import annotations

import math
import warnings

import numpy as np
import pytest
import torch
from scipy.linalg import sqrtm
from torch import Tensor

from eaip_prob.errors import NotPositiveDefiniteError, NumericalWarning
from eaip_prob.linalg import (
    flat_members,
    log_det,
    min_norm_solution,
    orthonormal_coordinates,
    psd_pseudo_solve,
    psd_root,
    psd_solve,
    safe_cholesky,
    symmetrised,
    trailing_rotation,
    triangular_solve,
    vector_matmul,
    whitened,
)

UNITS = torch.tensor([1e-3, 1.0, 1e3, 20.0, 1e-2], dtype=torch.float64)


def randn(*shape: int, seed: int = 0) -> Tensor:
    return torch.randn(*shape, generator=torch.Generator().manual_seed(seed), dtype=torch.float64)


def spd(*batch: int, n: int = 5, rank: int | None = None, seed: int = 0) -> Tensor:
    rows = randn(*batch, n, rank or 2 * n, seed=seed) * UNITS[:n, None]
    return rows @ rows.mT


@pytest.mark.parametrize("batch", [(), (2, 3)])
def test_factor_solve_and_determinant_match_numpy(batch: tuple[int, ...]) -> None:
    matrix, right = spd(*batch), randn(*batch, 5, 2, seed=1)
    factor = safe_cholesky(matrix)
    np.testing.assert_allclose(factor, np.linalg.cholesky(matrix.numpy()), rtol=1e-10)
    np.testing.assert_allclose(psd_solve(matrix, right), np.linalg.solve(matrix.numpy(), right.numpy()), rtol=1e-7)
    np.testing.assert_allclose(log_det(factor), np.linalg.slogdet(matrix.numpy())[1], rtol=1e-10)
    np.testing.assert_allclose(
        triangular_solve(factor, right), np.linalg.solve(factor.numpy(), right.numpy()), rtol=1e-8
    )


def test_large_batches_keep_their_determinant() -> None:
    rows = randn(4, 189, 400)
    matrix = rows @ rows.mT
    np.testing.assert_allclose(log_det(safe_cholesky(matrix)), np.linalg.slogdet(matrix.numpy())[1], rtol=1e-12)


def test_a_positive_definite_matrix_gets_no_jitter_beside_a_failing_one() -> None:
    good, singular = spd(), spd(rank=2, seed=3)
    singular[0, 0] -= 1e-13 * singular[0, 0]
    both = safe_cholesky(torch.stack([good, singular]))
    assert torch.equal(both[0], safe_cholesky(good))
    scale = singular.diagonal().sqrt()
    error = (both[1] @ both[1].T - singular) / scale[:, None] / scale
    assert 0 < float(error.abs().amax()) < 2e-9


def test_jitter_does_not_depend_on_units() -> None:
    ones = torch.ones(4, 4, dtype=torch.float64)
    ones[0, 0] -= 1e-13
    units = 2.0 ** torch.tensor([-20.0, 0.0, 10.0, 20.0], dtype=torch.float64)
    plain, scaled = safe_cholesky(ones), safe_cholesky(ones * units[:, None] * units)
    torch.testing.assert_close(scaled, plain * units[:, None], rtol=1e-14, atol=0.0)


@pytest.mark.parametrize(("dent", "amount"), [(3e-12, None), (3e-10, "1e-09"), (3e-8, "1e-07"), (3e-7, "1e-06")])
def test_only_notable_jitter_warns_and_names_its_amount(dent: float, amount: str | None) -> None:
    matrix = 7.0 * (torch.eye(3, dtype=torch.float64) - (1 + dent) / 3)
    if amount is None:
        with warnings.catch_warnings():
            warnings.simplefilter("error")
            safe_cholesky(matrix, "weights")
    else:
        with pytest.warns(NumericalWarning, match=f"Added {amount} of its diagonal to weights"):
            safe_cholesky(matrix, "weights")


def test_a_constant_signal_among_others_is_factorised() -> None:
    matrix = torch.diag(torch.tensor([4.0, 0.0, 9.0], dtype=torch.float64))
    factor = safe_cholesky(matrix)
    torch.testing.assert_close(factor @ factor.T, matrix, rtol=0, atol=1e-10)
    zero = safe_cholesky(torch.zeros(2, 2, dtype=torch.float64))
    assert float(zero.abs().amax()) <= 1.1e-6


@pytest.mark.parametrize("batch", [(), (2, 3)])
def test_an_indefinite_matrix_is_refused_with_its_eigenvalue(batch: tuple[int, ...]) -> None:
    matrix = torch.diag(torch.tensor([2.0, -0.5], dtype=torch.float64)).expand(*batch, 2, 2)
    with pytest.raises(NotPositiveDefiniteError, match=r"Expected joint to be positive semi-definite.*-0\.5"):
        safe_cholesky(matrix, "joint")
    with pytest.raises(NotPositiveDefiniteError, match="eigenvalue of"):
        psd_root(matrix)


@pytest.mark.parametrize("bad", [float("nan"), float("inf")])
@pytest.mark.parametrize("where", [(0, 0), (2, 1), (4, 4)])
@pytest.mark.parametrize("function", [safe_cholesky, psd_root])
def test_entries_that_are_not_finite_are_refused(function, where: tuple[int, int], bad: float) -> None:
    matrix = spd()
    matrix[where] = matrix[where[::-1]] = bad
    with pytest.raises(NotPositiveDefiniteError, match="finite"):
        function(matrix)


@pytest.mark.parametrize("batch", [(), (2, 3)])
@pytest.mark.parametrize("rank", [1, 3, 5])
def test_a_root_reproduces_singular_matrices_in_any_unit(batch: tuple[int, ...], rank: int) -> None:
    matrix = spd(*batch, rank=rank)
    root = psd_root(matrix)
    scale = matrix.diagonal(dim1=-2, dim2=-1).sqrt()
    error = (root @ root.mT - matrix) / scale[..., :, None] / scale[..., None, :]
    assert float(error.abs().amax()) < 1e-13
    # A factor that exists by luck of round-off may keep all columns; the eigen-decomposition keeps `rank`.
    assert root.shape[-1] in (rank, 5)


def test_roots_of_zero_and_of_round_off_below_zero() -> None:
    zero = torch.zeros(3, 3, dtype=torch.float64)
    assert torch.equal(psd_root(zero) @ psd_root(zero).mT, zero)
    near = torch.diag(torch.tensor([1.0, -1e-17, 2.0], dtype=torch.float64))
    root = psd_root(near)
    torch.testing.assert_close(root @ root.mT, near, rtol=0, atol=1e-15)


@pytest.mark.parametrize("batch", [(), (2, 3)])
@pytest.mark.parametrize("shared", [True, False])
def test_vectors_equal_a_loop(batch: tuple[int, ...], shared: bool) -> None:
    factor = safe_cholesky(spd() if shared else spd(*batch))
    vectors = randn(*batch, 5, seed=2)
    factors = factor.expand(*batch, 5, 5).reshape(-1, 5, 5).numpy()
    pairs = list(zip(factors, vectors.reshape(-1, 5).numpy(), strict=True))
    solved = np.stack([np.linalg.solve(f, v) for f, v in pairs])
    np.testing.assert_allclose(whitened(factor, vectors).reshape(-1, 5), solved, rtol=1e-9)
    product = np.stack([v @ f for f, v in pairs])
    np.testing.assert_allclose(vector_matmul(vectors, factor).reshape(-1, 5), product, rtol=1e-12)


@pytest.mark.parametrize("batch", [(), (2, 3)])
def test_a_rotation_leaves_only_the_last_columns(batch: tuple[int, ...]) -> None:
    rows = randn(*batch, 2, 5)
    rotation = trailing_rotation(rows)
    eye = torch.eye(5, dtype=torch.float64).expand(*batch, 5, 5)
    torch.testing.assert_close(rotation @ rotation.mT, eye, rtol=0, atol=1e-14)
    assert float((rows @ rotation)[..., :3].abs().amax()) < 1e-14


@pytest.mark.parametrize(("rows", "columns", "rank"), [(7, 3, 3), (3, 7, 3), (6, 6, 2), (4, 9, 1)])
def test_least_squares_match_lstsq(rows: int, columns: int, rank: int) -> None:
    design = 50.0 * randn(rows, rank) @ randn(rank, columns, seed=1)
    target = randn(rows, 2, seed=2)
    expected = np.linalg.lstsq(design.numpy(), target.numpy(), rcond=1e-12)[0]
    np.testing.assert_allclose(min_norm_solution(design, target), expected, rtol=1e-9, atol=1e-13)
    assert torch.equal(min_norm_solution(0 * design, target), torch.zeros(columns, 2, dtype=torch.float64))


def test_pseudo_solve_is_the_pseudo_inverse_in_standard_deviations() -> None:
    matrix, right = spd(rank=2), spd(rank=2)[:, :3]
    scale = matrix.diagonal().sqrt().numpy()
    correlation = matrix.numpy() / scale[:, None] / scale
    expected = np.linalg.pinv(correlation, rcond=1e-10) @ (right.numpy() / scale[:, None]) / scale[:, None]
    solution = psd_pseudo_solve(matrix, right)
    np.testing.assert_allclose(solution, expected, rtol=1e-7)
    np.testing.assert_allclose(matrix @ solution, right, rtol=1e-9)


def test_pseudo_solve_ignores_a_constant_feature() -> None:
    matrix = torch.diag(torch.tensor([4.0, 0.0], dtype=torch.float64))
    right = torch.tensor([[8.0], [0.0]], dtype=torch.float64)
    torch.testing.assert_close(psd_pseudo_solve(matrix, right), torch.tensor([[2.0], [0.0]], dtype=torch.float64))


def test_symmetrised_is_the_mean_with_the_transpose() -> None:
    matrix = randn(2, 3, 3)
    torch.testing.assert_close(symmetrised(matrix), (matrix + matrix.transpose(1, 2)) / 2)


@pytest.mark.parametrize("n", [1, 5])
def test_orthonormal_coordinates_make_the_gram_matrix_the_identity(n: int) -> None:
    gram = spd(n=n)
    forward, back = orthonormal_coordinates(gram)
    size = gram.diagonal().sqrt()
    np.testing.assert_allclose((forward.mT @ forward - gram) / size / size[:, None], np.zeros((n, n)), atol=1e-12)
    np.testing.assert_allclose(forward @ back, np.eye(n), atol=1e-12)
    np.testing.assert_allclose((back.mT @ gram @ back), np.eye(n), atol=1e-11)
    for w in randn(4, n, seed=1):
        assert float((forward @ w).square().sum()) == pytest.approx(float(w @ gram @ w), rel=1e-12)


def test_orthonormal_coordinates_are_the_symmetric_root_at_unit_diagonal() -> None:
    gram = spd()
    size = gram.diagonal().sqrt().numpy()
    expected = sqrtm(gram.numpy() / size / size[:, None]) * size
    np.testing.assert_allclose(orthonormal_coordinates(gram)[0], expected, rtol=1e-10, atol=1e-12)


def test_orthonormal_coordinates_of_weights_in_other_units_are_the_same() -> None:
    gram, units = spd(), 2.0 ** torch.tensor([-20.0, 0.0, 10.0, 20.0, 3.0], dtype=torch.float64)
    (forward, back), (other, inverse) = (orthonormal_coordinates(gram * u * u[:, None]) for u in (units**0, units))
    torch.testing.assert_close(other, forward * units, rtol=1e-12, atol=0.0)
    torch.testing.assert_close(inverse, back / units[:, None], rtol=1e-12, atol=0.0)


def test_orthonormal_coordinates_of_singular_gram_matrices_stay_an_inverse() -> None:
    gram = torch.zeros(6, 6, dtype=torch.float64)
    gram[:5, :5] = spd(rank=2)
    size = torch.cat([gram.diagonal()[:5].sqrt(), torch.ones(1, dtype=torch.float64)])
    forward, back = orthonormal_coordinates(gram)
    np.testing.assert_allclose(forward @ back, np.eye(6), atol=1e-9)
    # The floor of 1e-10 of the largest eigenvalue, at most 6, is all that is added.
    np.testing.assert_allclose((forward.mT @ forward - gram) / size / size[:, None], np.zeros((6, 6)), atol=6e-10)
    assert float((back * size[:, None]).abs().max()) < 1.01e5


@pytest.mark.parametrize("batch", [(), (1,), (2, 1), (3,), (2, 3)])
def test_members_of_a_batch_are_found_at_their_places(batch: tuple[int, ...]) -> None:
    array = randn(*batch, 4, 2)
    members, place = flat_members(array, 2, (2, 3))
    assert torch.equal(members[place].reshape(2, 3, 4, 2), array.expand(2, 3, 4, 2))
    assert len(members) == max(1, math.prod(batch))

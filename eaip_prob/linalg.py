"""The only module that factorises a matrix.

Cholesky only: torch's batched LU on the CPU is unreliable above about 150 rows with more than one thread
(`solve` and `inv` raise, `slogdet` is silently wrong), and weight covariances are larger than that.
Jitter here is for round-off alone; regularisation is a declared parameter of an estimator.
"""

from __future__ import annotations

import math
import os
import warnings
from collections.abc import Sequence

import numpy as np
import torch
from jaxtyping import Float, Int
from scipy.linalg import get_lapack_funcs
from torch import Tensor

from eaip_prob.errors import NotPositiveDefiniteError, NumericalWarning

_JITTERS = (1e-12, 1e-11, 1e-10, 1e-9, 1e-8, 1e-7, 1e-6)
_WARN_FROM = 1e-9
# numpy's BLAS reads these at its import and heeds no later setting; with threads, small products wait for busy cores.
_ONE_THREAD = (os.environ.get("OPENBLAS_NUM_THREADS") or os.environ.get("OMP_NUM_THREADS")) == "1"
_POTRF, _TRTRS = get_lapack_funcs(("potrf", "trtrs"), dtype=np.float64)


def symmetrised(matrix: Float[Tensor, "*batch n n"]) -> Float[Tensor, "*batch n n"]:
    """Mean of the matrix and its transpose."""
    return 0.5 * (matrix + matrix.mT)


def safe_cholesky(matrix: Float[Tensor, "*batch n n"], name: str = "covariance") -> Float[Tensor, "*batch n n"]:
    """Lower Cholesky factor; failing members of the batch get jitter relative to their diagonal.

    Jitter grows tenfold from 1e-12 to 1e-6 of each diagonal entry of a failing member, so that the result does not
    depend on the units of the rows. Rank-deficient covariances (fewer demonstrations than weights) are ordinary
    input and take the first steps silently; from 1e-9 on there is a `NumericalWarning`.

    Args:
        matrix: symmetric, positive semi-definite up to round-off.
        name: what the matrix is, for the message.

    Returns:
        lower triangular L with L L^T = matrix (+ jitter).

    Raises:
        NotPositiveDefiniteError: no factor even with the largest jitter, or entries that are not finite.

    Example:
        >>> safe_cholesky(torch.eye(2, dtype=torch.float64) * 4.0)
        tensor([[2., 0.],
                [0., 2.]], dtype=torch.float64)
    """
    factor, info = torch.linalg.cholesky_ex(matrix)
    if not bool(info.any()):
        # NaN or infinity anywhere in a row reaches that row's pivot.
        if not math.isfinite(float(factor.diagonal(dim1=-2, dim2=-1).sum())):
            raise NotPositiveDefiniteError(f"Expected finite entries in {name}, got NaN or infinity. Check the data.")
        return factor
    return _jittered_cholesky(matrix, info != 0, factor, name)


def _jittered_cholesky(matrix: Tensor, failed: Tensor, factor: Tensor, name: str) -> Tensor:
    if not bool(torch.isfinite(matrix).all()):
        raise NotPositiveDefiniteError(f"Expected finite entries in {name}, got NaN or infinity. Check the data.")
    scale = _diagonal_scale(matrix)
    for relative in _JITTERS:
        trial, info = torch.linalg.cholesky_ex(matrix + torch.diag_embed(relative * scale))
        solved = failed & (info == 0)
        factor = torch.where(solved[..., None, None], trial, factor)
        failed = failed & (info != 0)
        if not bool(failed.any()):
            if relative >= _WARN_FROM:
                warnings.warn(f"Added {relative:.0e} of its diagonal to {name}.", NumericalWarning, stacklevel=3)
            return factor
    least = float(torch.linalg.eigvalsh(symmetrised(matrix)).amin())
    raise NotPositiveDefiniteError(
        f"Expected {name} to be positive semi-definite, got a smallest eigenvalue of {least:.3g} at a mean "
        f"diagonal of {float(scale.mean()):.3g}. Use covariance=shrinkage or check the units of the blocks."
    )


def _diagonal_scale(matrix: Tensor) -> Tensor:
    """The diagonal; where it is zero (a constant signal has no scale of its own) its mean, or 1 if all of it is."""
    diagonal = matrix.diagonal(dim1=-2, dim2=-1)
    mean = diagonal.mean(-1, keepdim=True)
    return torch.where(diagonal > 0, diagonal, torch.where(mean > 0, mean, 1.0))


def psd_root(matrix: Float[Tensor, "*batch n n"]) -> Float[Tensor, "*batch n rank"]:
    """A root R with R R^T = matrix for a matrix that may be singular: no jitter enters.

    The lower Cholesky factor where it exists, else from the eigen-decomposition without the columns that are round-off.

    Raises:
        NotPositiveDefiniteError: an eigenvalue is negative beyond round-off, or entries are not finite.

    Example:
        >>> psd_root(torch.ones(3, 3, dtype=torch.float64)).shape
        torch.Size([3, 1])
    """
    factor, info = torch.linalg.cholesky_ex(matrix)
    if not bool(info.any()) and bool(torch.isfinite(factor).all()):
        return factor
    return _eigen_root(matrix)


def flat_members(
    array: Float[Tensor, "*batch values"], num_axes: int, shape: Sequence[int]
) -> tuple[Float[Tensor, "members values"], Int[Tensor, "all"]]:
    """(the members of a batch one after the other, which of them stands at each place of a larger batch); no copies.

    Args:
        array: with batch axes that broadcast to the shape.
        num_axes: at the end that are no batch axes.
        shape: of the larger batch.

    Example:
        >>> members, place = flat_members(torch.tensor([[[1.0], [2.0]]]), 1, (2, 2))
        >>> members[place].flatten().tolist()
        [1.0, 2.0, 1.0, 2.0]
    """
    batch = array.shape[: array.ndim - num_axes]
    places = torch.arange(math.prod(batch)).reshape(batch).expand(*shape).flatten()
    return array.reshape(-1, *array.shape[array.ndim - num_axes :]), places


def _eigen_root(matrix: Tensor) -> Tensor:
    if not bool(torch.isfinite(matrix).all()):
        raise NotPositiveDefiniteError("Expected finite entries in the covariance, got NaN or infinity.")
    # Unit diagonal first: blocks in metres and in pixels would otherwise drown each other's round-off.
    scale = _diagonal_scale(matrix).sqrt()
    values, vectors = torch.linalg.eigh(symmetrised(matrix / scale[..., :, None] / scale[..., None, :]))
    if bool((values < -1e-8 * values.amax(-1, keepdim=True).clamp_min(1.0)).any()):
        raise NotPositiveDefiniteError(
            f"Expected a positive semi-definite covariance, got an eigenvalue of {float(values.amin()):.3g} "
            f"in units of its diagonal."
        )
    round_off = matrix.shape[-1] * torch.finfo(matrix.dtype).eps * values.amax(-1, keepdim=True)
    used = (values > round_off).flatten(0, -2).any(0) if values.ndim > 1 else values > round_off
    used[-1] = True
    return scale[..., :, None] * (vectors * values.clamp_min(0.0).sqrt()[..., None, :])[..., used]


def psd_solve(
    matrix: Float[Tensor, "*batch n n"], right: Float[Tensor, "*batch n m"], name: str = "matrix"
) -> Float[Tensor, "*batch n m"]:
    """Solution of `matrix @ x = right` for a symmetric positive definite matrix, by its Cholesky factor."""
    return torch.cholesky_solve(right, safe_cholesky(matrix, name))


def log_det(factor: Float[Tensor, "*batch n n"]) -> Float[Tensor, "*batch"]:
    """Log determinant of L L^T from its lower triangular factor L."""
    return 2.0 * factor.diagonal(dim1=-2, dim2=-1).log().sum(-1)


def triangular_solve(
    factor: Float[Tensor, "*batch n n"], right: Float[Tensor, "*batch n m"]
) -> Float[Tensor, "*batch n m"]:
    """Solution of `factor @ x = right` for a lower triangular factor."""
    return torch.linalg.solve_triangular(factor, right, upper=False)


def whitened(factor: Float[Tensor, "*#batch n n"], vectors: Float[Tensor, "*#batch n"]) -> Float[Tensor, "*batch n"]:
    """L^-1 v for vectors, whose squared length is v^T (L L^T)^-1 v.

    One factor shared by a batch of vectors is used once, not copied per member.

    Example:
        >>> whitened(torch.tensor([[2.0]]), torch.tensor([[6.0], [8.0]]))
        tensor([[3.],
                [4.]])
    """
    if factor.ndim == 2:
        flat = vectors.reshape(-1, vectors.shape[-1])
        return triangular_solve(factor, flat.mT).mT.reshape(vectors.shape)
    return triangular_solve(factor, vectors[..., None])[..., 0]


def vector_matmul(
    vectors: Float[Tensor, "*#batch n"], matrix: Float[Tensor, "*#batch n m"]
) -> Float[Tensor, "*batch m"]:
    """v^T M for vectors; one matrix shared by a batch of vectors is one product."""
    return vectors @ matrix if matrix.ndim == 2 else (vectors[..., None, :] @ matrix)[..., 0, :]


def trailing_rotation(rows: Float[Tensor, "*batch rows columns"]) -> Float[Tensor, "*batch columns columns"]:
    """An orthogonal matrix Q for which only the last columns of `rows @ Q`, as many as there are rows, are not zero."""
    return torch.linalg.qr(rows.mT, mode="complete").Q.flip(-1)


def single_arrays(*tensors: tuple[Tensor, int]) -> tuple[list[np.ndarray], int] | None:
    """(views of tensors without their batch axes, the largest number of these); None unless there is one member.

    For one matrix of a hundred rows numpy and LAPACK on one thread (OMP_NUM_THREADS=1) take half of torch's time. What
    requires a gradient, has a batch axis of another size than 1, is not float64 or not on the CPU stays with torch.

    Args:
        tensors: each with the number of its trailing axes that are no batch.

    Example:
        >>> single_arrays((torch.zeros(2, 3, dtype=torch.float64), 1)) is None
        True
    """
    if not _ONE_THREAD:
        return None
    arrays, most = [], 0
    for tensor, num_event in tensors:
        if tensor.requires_grad or tensor.dtype != torch.float64 or not tensor.is_cpu:
            return None
        array, num_batch = tensor.numpy(), tensor.ndim - num_event
        if num_batch:
            if array.shape[:num_batch].count(1) < num_batch:
                return None
            array, most = array.reshape(array.shape[num_batch:]), max(most, num_batch)
        arrays.append(array)
    return arrays, most


def with_batch(array: np.ndarray, num_batch: int) -> Tensor:
    """The array as a tensor that shares its memory, behind batch axes of size 1.

    Example:
        >>> with_batch(np.zeros(3), 2).shape
        torch.Size([1, 1, 3])
    """
    return torch.from_numpy(array.reshape((1,) * num_batch + array.shape))


def lapack_cholesky(matrix: np.ndarray) -> tuple[np.ndarray, float] | None:
    """(lower factor, its log determinant), or None where there is no finite one.

    The factor takes the place of the matrix, transposed; its upper triangle is not set to zero.

    Example:
        >>> lapack_cholesky(np.eye(2) * 4.0)[0].diagonal().tolist(), lapack_cholesky(-np.eye(2))
        ([2.0, 2.0], None)
    """
    factor, info = _POTRF(matrix.T, lower=1, clean=0, overwrite_a=1)
    log_determinant = 2.0 * float(np.log(factor.diagonal()).sum()) if info == 0 else math.nan
    return (factor, log_determinant) if math.isfinite(log_determinant) else None


def lapack_triangular_solve(factor: np.ndarray, right: np.ndarray) -> np.ndarray:
    """Solution of `factor @ x = right` for a lower factor, whose upper triangle is not read.

    Example:
        >>> lapack_triangular_solve(np.array([[2.0, 9.0], [0.0, 1.0]]), np.array([4.0, 3.0]))
        array([2., 3.])
    """
    return _TRTRS(factor, right, lower=1)[0]


def min_norm_solution(
    design: Float[Tensor, "rows columns"], target: Float[Tensor, "rows outputs"]
) -> Float[Tensor, "columns outputs"]:
    """Least-squares solution of smallest norm of `design @ x = target`, by singular values.

    Singular values under max(shape) times machine precision of the largest count as zero.
    """
    left, values, right = torch.linalg.svd(design, full_matrices=False)
    tolerance = max(design.shape) * torch.finfo(design.dtype).eps * values.amax()
    inverse = torch.where(values > tolerance, 1.0 / values.clamp_min(torch.finfo(design.dtype).tiny), 0.0)
    return right.mT @ (inverse[:, None] * (left.mT @ target))


def psd_pseudo_solve(matrix: Float[Tensor, "n n"], right: Float[Tensor, "n m"]) -> Float[Tensor, "n m"]:
    """Solution of `matrix @ x = right`, shortest in standard deviations, for a covariance that may be singular.

    Eigenvalues of the correlation matrix under 1e-10 count as zero, so that units do not matter.
    """
    scale = _diagonal_scale(matrix).sqrt()
    values, vectors = torch.linalg.eigh(symmetrised(matrix / scale[:, None] / scale))
    inverse = torch.where(values > 1e-10, 1.0 / values.clamp_min(1e-10), 0.0)
    return vectors @ (inverse[:, None] * (vectors.mT @ (right / scale[:, None]))) / scale[:, None]


def collapsed(tensor: Tensor, num_event: int) -> Tensor:
    """The tensor without batch axes along which it repeats itself, so that what follows is computed once.

    Args:
        tensor: (*batch, *event).
        num_event: trailing axes that are no batch.

    Returns:
        of the same number of axes; a batch axis without variation has size 1.

    Example:
        >>> collapsed(torch.ones(4, 3, 2), 1).shape
        torch.Size([1, 1, 2])
    """
    for axis in range(tensor.ndim - num_event):
        first = tensor.narrow(axis, 0, min(1, tensor.shape[axis]))
        if tensor.shape[axis] > 1 and bool((tensor == first).all()):
            tensor = first
    return tensor


def orthonormal_coordinates(
    gram: Float[Tensor, "n n"],
) -> tuple[Float[Tensor, "n n"], Float[Tensor, "n n"]]:
    """(R, R^-1) with R^T R = gram: coordinates R w in which w^T gram w is a plain sum of squares.

    R is the symmetric root after scaling to a unit diagonal, which keeps each coordinate as close as can be to its own
    weight (Loewdin) whatever the weights' units. Directions under 1e-10 of the largest count as 1e-10.

    Example:
        >>> forward, back = orthonormal_coordinates(torch.tensor([[4.0, 0.0], [0.0, 1.0]], dtype=torch.float64))
        >>> forward.diagonal().tolist()
        [2.0, 1.0]
    """
    diagonal = gram.diagonal()
    scale = torch.where(diagonal > 0, diagonal, 1.0).sqrt()
    values, vectors = torch.linalg.eigh(symmetrised(gram / scale[:, None] / scale))
    roots = values.clamp_min(1e-10 * float(values.amax())).sqrt()
    return (vectors * roots) @ vectors.mT * scale, (vectors / roots) @ vectors.mT / scale[:, None]

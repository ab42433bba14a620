"""The algebra of conditioning a Gaussian in root form, on plain tensors.

With a root of the prior covariance, Sigma = L L^T (L may be singular or have fewer columns than rows: duplicates, fewer
demonstrations than weights), evidence enters in one of two forms::

    information   W = I + sum_i L_i^T P_i L_i,   mean' = mean + L W^-1 sum_i L_i^T b_i,   Sigma' = L W^-1 L^T
    rows          S = G G^T + R,  G = A L,  K = L G^T S^-1,   mean' = mean + K r,
                  Sigma' = (L - K G)(L - K G)^T + K R K^T

L_i are the rows of the weights that observation i sees. The size of W does not grow with the length of an observation,
but it loses as many digits as the evidence is stronger than the prior; rows are exact also without any noise. Both
covariances are positive semi-definite by construction.

Letters: K weights seen, Z' weights kept, C columns of the root, M rows, G diagonal blocks of a precision.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor

from eaip_prob.linalg import (
    lapack_cholesky,
    lapack_triangular_solve,
    log_det,
    safe_cholesky,
    single_arrays,
    symmetrised,
    trailing_rotation,
    triangular_solve,
    vector_matmul,
    whitened,
    with_batch,
)

LOG_2PI = math.log(2.0 * math.pi)
# Evidence this much stronger than the prior costs the information form 10 of its 16 digits.
_STRONGEST_INFORMATION = 1e10
# Predicted variances below this share of their terms are round-off: the row is known already.
_KNOWN = 1e-20


@dataclass(frozen=True, eq=False)
class Information:
    """What an observation says about K weights, as a log likelihood around a reference m.

        log p(y | theta) = log_scale + shift^T d - d^T precision d / 2,   d = theta - m

    Args:
        precision: (*batch, G, K/G, K/G), the diagonal blocks of A^T R^-1 A; the others are zero.
        shift: (*batch, K), A^T R^-1 (y - offset - A m).
        log_scale: (*batch,), log density of y at theta = m, in nats.
    """

    precision: Float[Tensor, "*#batch blocks size size"]
    shift: Float[Tensor, "*#batch weights"]
    log_scale: Float[Tensor, "*#batch"]

    def pulled(self, root: Float[Tensor, "*#batch weights columns"]) -> tuple[Tensor, Tensor] | None:
        """(L^T P L, L^T b) for these weights' rows of a root; None where P is so strong that digits would be lost."""
        single = single_arrays((self.precision, 3), (self.shift, 1), (root, 2))
        if single is not None:
            return _pulled_alone(single[1], *single[0])
        size = self.precision.shape[-1]
        blocks = root.reshape(*root.shape[:-2], root.shape[-2] // size, size, root.shape[-1])
        inner = root.mT @ (self.precision @ blocks).flatten(-3, -2)
        if not float(inner.diagonal(dim1=-2, dim2=-1).amax()) <= _STRONGEST_INFORMATION:
            return None
        return inner, vector_matmul(self.shift, root)


def _pulled_alone(
    num_batch: int, precision: np.ndarray, shift: np.ndarray, root: np.ndarray
) -> tuple[Tensor, Tensor] | None:
    """`Information.pulled` of one member."""
    scaled = (precision @ root.reshape(-1, precision.shape[-1], root.shape[-1])).reshape(root.shape)
    inner = _symmetric_product(root, scaled)
    if not inner.diagonal().max() <= _STRONGEST_INFORMATION:
        return None
    return with_batch(inner, num_batch), with_batch(shift @ root, num_batch)


def _symmetric_product(left: np.ndarray, right: np.ndarray) -> np.ndarray:
    """left^T right where that is known to be symmetric: three quarters of the product, the rest mirrored."""
    size = right.shape[-1]
    half, result = size // 2, np.empty((size, size))
    np.matmul(left.T, right[:, :half], out=result[:, :half])
    np.matmul(left.T[half:], right[:, half:], out=result[half:, half:])
    result[:half, half:] = result[half:, :half].T
    return result


def white_terms(design: Tensor, residual: Tensor, weight: Tensor) -> tuple[Tensor, Tensor, Tensor]:
    """(A^T R^-1 A, A^T R^-1 r, r^T R^-1 r) for R = diag(1 / weight)."""
    scaled = residual * weight
    precision = (design * weight[..., None]).mT @ design
    return precision, (scaled[..., None, :] @ design)[..., 0, :], (scaled * residual).sum(-1)


def white_information_alone(
    num_batch: int, design: np.ndarray, value: np.ndarray, offset: np.ndarray, noise: np.ndarray, mean: np.ndarray
) -> Information | None:
    """Information of T samples of D signals that were all seen, for one member; None where one is without noise.

    Args:
        num_batch: number of batch axes of the result, each of size 1.
        design: (T, B).
        value: (D, T).
        offset: (D, T), or 1 for an axis.
        noise: (D, T) variances, or 1 for an axis.
        mean: (D B,), the reference of the weights.
    """
    if not noise.min() > 0:
        return None
    weight, residual = 1.0 / noise, value - offset - mean.reshape(-1, design.shape[-1]) @ design.T
    scaled = residual * weight
    if noise.shape[-1] == 1:
        precision = (design.T @ design) * weight[..., None]
    else:
        precision = (design * weight[..., None]).mT @ design
    log_noise = np.log(noise).sum() * (residual.size // noise.size)
    log_scale = np.array(-0.5 * (np.vdot(scaled, residual) + log_noise + residual.size * LOG_2PI))
    shift = (scaled @ design).reshape(-1)
    return Information(with_batch(precision, num_batch), with_batch(shift, num_batch), with_batch(log_scale, num_batch))


def correlated_terms(design: Tensor, residual: Tensor, noise: Tensor) -> tuple[Tensor, Tensor, Tensor, Tensor]:
    """The same for a covariance R, and its log determinant."""
    factor = safe_cholesky(noise, "observation noise")
    design, white = triangular_solve(factor, design), triangular_solve(factor, residual[..., None])
    return design.mT @ design, (design.mT @ white)[..., 0], white.square().sum((-2, -1)), log_det(factor)


@dataclass(frozen=True, eq=False)
class SplitRoot:
    """A root of the prior with its observed weights first: what every update of the same blocks shares.

    The columns are rotated so that the kept weights use only the last ones, and the solves for them stay small.

    Args:
        seen: (*batch, K, C), the rows of the observed weights.
        kept: (*batch, Z', C'), the last C' columns of the rows of the weights that the posterior keeps.
        unexplained: (*batch, Z', Z') covariance of the kept weights given all of the observed ones, or None if zero.
        eye: (C, C), the identity of W.
    """

    seen: Float[Tensor, "*batch seen columns"]
    kept: Float[Tensor, "*batch kept last"]
    unexplained: Float[Tensor, "*batch kept kept"] | None
    eye: Float[Tensor, "columns columns"]

    @classmethod
    def of(cls, root: Float[Tensor, "*batch weights columns"], num_seen: int, kept: Tensor) -> SplitRoot:
        """Splits a root whose first `num_seen` rows are observed; `kept` holds positions of rows."""
        front, unexplained = root, None
        if root.shape[-1] > num_seen and not bool(root[..., :num_seen, num_seen:].any()):
            front, behind = root[..., :num_seen], root[..., kept, num_seen:]
            unexplained = behind @ behind.mT
        seen, used = front[..., :num_seen, :], front[..., kept, :]
        if used.shape[-2] < used.shape[-1]:
            rotation = trailing_rotation(used)
            seen, used = seen @ rotation, (used @ rotation)[..., -used.shape[-2] :]
        eye = torch.eye(seen.shape[-1], dtype=root.dtype)
        return cls(seen.contiguous(), used.contiguous(), unexplained, eye)

    @cached_property
    def single(self) -> tuple[list[np.ndarray], int] | None:
        """([eye, kept, unexplained if there is any], number of batch axes) for one member; None for a batch."""
        rest = [] if self.unexplained is None else [(self.unexplained, 2)]
        return single_arrays((self.eye, 2), (self.kept, 2), *rest)


def update_by_information(split: SplitRoot, pulled: Sequence[tuple[Tensor, Tensor]]) -> tuple[Tensor, Tensor, Tensor]:
    """(shift of the kept mean, their covariance, log evidence beside the observations' log scales)."""
    inner, pull = pulled[0]
    for more_inner, more_pull in pulled[1:]:
        inner, pull = inner + more_inner, pull + more_pull
    alone = _update_alone(split, inner, pull)
    if alone is not None:
        return alone
    factor = safe_cholesky(split.eye + inner, "posterior precision")
    white = whitened(factor, pull)
    num = split.kept.shape[-1]
    half = triangular_solve(factor[..., -num:, -num:], split.kept.mT)
    covariance = half.mT @ half
    if split.unexplained is not None:
        covariance = covariance + split.unexplained
    log_evidence = 0.5 * (white.square().sum(-1) - log_det(factor))
    return vector_matmul(white[..., -num:], half), covariance, log_evidence


def _update_alone(split: SplitRoot, inner: Tensor, pull: Tensor) -> tuple[Tensor, Tensor, Tensor] | None:
    """The same update for one member; None for a batch, or where the precision has no Cholesky factor as it is."""
    single = single_arrays((inner, 2), (pull, 1))
    if single is None or split.single is None:
        return None
    (information, pulled), (eye, kept, *unexplained) = single[0], split.single[0]
    factored = lapack_cholesky(information + eye)
    if factored is None:
        return None
    factor, log_determinant = factored
    white, num = lapack_triangular_solve(factor, pulled), kept.shape[-1]
    half = lapack_triangular_solve(factor[-num:, -num:], kept.T)
    covariance = half.T @ half
    for part in unexplained:
        covariance += part
    gained = np.array(0.5 * (white @ white - log_determinant))
    num_batch = max(single[1], split.single[1])
    return with_batch(white[-num:] @ half, num_batch), with_batch(covariance, num_batch), with_batch(gained, num_batch)


def update_by_rows(
    root: Float[Tensor, "*#batch weights columns"],
    seen: slice | Tensor,
    matrix: Float[Tensor, "*#batch rows seen"],
    residual: Float[Tensor, "*#batch rows"],
    noise: Float[Tensor, "*#batch rows rows"],
) -> tuple[Tensor, Tensor, Tensor]:
    """(shift of the mean, covariance, log density of the residual), for noise that may be zero or singular.

    `seen` are the positions of the weights that `matrix` reads.
    """
    variance = root.square().sum(-1)
    # A row that the prior knows already has a variance of pure round-off, which must not steer the others.
    floor = _KNOWN * (matrix.square() @ variance[..., seen, None])[..., 0]
    noise = noise + torch.diag_embed(floor)
    rows = matrix @ root[..., seen, :]
    factor = safe_cholesky(symmetrised(rows @ rows.mT + noise), "innovation covariance")
    white = whitened(factor, residual)
    log_density = -0.5 * (white.square().sum(-1) + log_det(factor) + residual.shape[-1] * LOG_2PI)
    gain = torch.cholesky_solve(rows @ root.mT, factor).mT
    reduced = root - gain @ rows
    covariance = symmetrised(reduced @ reduced.mT + gain @ noise @ gain.mT)
    return (gain @ residual[..., None])[..., 0], covariance, log_density

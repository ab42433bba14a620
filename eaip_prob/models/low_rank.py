"""Factor analysis: few common causes and a variance of its own for every weight.

With w the weights of the movements, e the features of the scene and N demonstrations,

    S_ww = B S_ee B^T + L L^T + diag(psi),    B = S_we S_ee^-1

e is regressed on directly, as by `ShrinkageCovariance`. What it leaves, in standard deviations, has k common factors:
L and psi by maximum likelihood with EM (Rubin and Thayer 1982), in matrices of N x Z and k x k only::

    G = (I + L^T psi^-1 L)^-1,   F = X psi^-1 L G                      (expected factors of the N rows of X)
    L <- X^T F (N G + F^T F)^-1,   psi <- max(psi_min, diag(X^T X - X^T F L^T) / N)

Letters: Z weights, k factors.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import torch
from jaxtyping import Float
from torch import Tensor

from eaip_prob.checks import check_fraction
from eaip_prob.errors import InputError
from eaip_prob.linalg import log_det, psd_pseudo_solve, psd_solve, safe_cholesky
from eaip_prob.models.covariance import AbstractCovariance, explained_by, sample_covariance

RANKS = (1, 2, 4, 8, 16)
DEFAULT_RANK = 4
_CONSTANT = 1e-20  # variance over mean square of a weight that does not vary


@dataclass(frozen=True)
class LowRankCovariance(AbstractCovariance):
    """Common factors of the weights beside the features, and a variance of each weight's own; unit-equivariant.

    Args:
        rank: k, number of factors, capped below the number of demonstrations; None offers 1, 2, 4, 8 and 16 as
            candidates, of which an `InteractionPredictor` chooses by held-out prediction, and means 4 by itself.
        least_share: of each weight's variance beside the features that no factor explains. A maximum of the likelihood
            at none of it (a Heywood case) is common with few demonstrations, and would be certain of what it predicts.
        tolerance: EM ends when the log likelihood grows by less, in nats per demonstration.
        max_rounds: or after so many rounds.

    Raises:
        InputError: numbers out of range.

    Example:
        >>> draw = torch.Generator().manual_seed(0)
        >>> factor = torch.randn(50, 1, generator=draw, dtype=torch.float64)
        >>> rows = factor + 0.5 * torch.randn(50, 3, generator=draw, dtype=torch.float64)
        >>> none = torch.tensor([], dtype=torch.long)
        >>> LowRankCovariance(rank=1).estimate(rows, [], none, none).shape
        torch.Size([3, 3])
    """

    rank: int | None = None
    least_share: float = 0.001
    tolerance: float = 1e-4
    max_rounds: int = 500

    def __post_init__(self) -> None:
        check_fraction("least_share", self.least_share)
        if self.rank is not None and self.rank < 1:
            raise InputError(f"Expected a rank of at least 1 or None, got {self.rank}.")
        if not (self.least_share > 0 and self.tolerance > 0 and self.max_rounds > 0):
            raise InputError(
                f"Expected least_share, tolerance and max_rounds above 0, got {self.least_share}, {self.tolerance} "
                f"and {self.max_rounds}."
            )

    def candidates(self) -> tuple[AbstractCovariance, ...]:
        """Five ranks, unless one was given."""
        if self.rank is not None:
            return (self,)
        return tuple(LowRankCovariance(rank, self.least_share, self.tolerance, self.max_rounds) for rank in RANKS)

    def estimate(
        self,
        weights: Float[Tensor, "demonstrations weights"],
        folds: Sequence[Tensor],
        target: Tensor,
        features: Tensor,
    ) -> Float[Tensor, "weights weights"]:
        """See `AbstractCovariance.estimate`; held-out choices are left to `candidates`."""
        covariance = sample_covariance(weights)
        rest = weights - weights.mean(0)
        if len(features):
            given = rest[:, features]
            rest = rest - given @ psd_pseudo_solve(covariance[features[:, None], features], covariance[features])
        variance, size = rest.square().mean(0), weights.square().mean(0)
        free = variance > _CONSTANT * size
        free[features] = False
        index = free.nonzero()[:, 0]
        result = explained_by(covariance, features)
        if len(index) == 0:
            return result
        scale = variance[index].sqrt()
        rank = min(DEFAULT_RANK if self.rank is None else self.rank, len(weights) - 1, len(index))
        loading, own = factor_analysis(rest[:, index] / scale, rank, self.least_share, self.tolerance, self.max_rounds)
        loading, own = loading * scale[:, None], own * scale.square()
        result[index[:, None], index] += loading @ loading.mT + torch.diag(own)
        return result


def factor_analysis(
    rows: Float[Tensor, "demonstrations weights"],
    rank: int,
    least_share: float = 0.001,
    tolerance: float = 1e-4,
    max_rounds: int = 500,
) -> tuple[Float[Tensor, "weights rank"], Float[Tensor, "weights"]]:
    """(loadings L, own variances psi) of the highest likelihood, by EM from the principal axes.

    Args:
        rows: (N, Z), centred, every column of mean square 1.
        rank: number of factors.
        least_share: least psi.
        tolerance: least growth of the log likelihood in a round, nats per row.
        max_rounds: most rounds.

    Example:
        >>> rows = torch.tensor([[1.0, 1.0], [-1.0, -1.0], [1.0, 1.0], [-1.0, -1.0]], dtype=torch.float64)
        >>> loading, own = factor_analysis(rows, rank=1)
        >>> own
        tensor([0.0010, 0.0010], dtype=torch.float64)
    """
    loading, own = _principal(rows, rank, least_share)
    before = -math.inf
    for _ in range(max_rounds):
        scaled, inner = loading / own[:, None], torch.eye(rank, dtype=rows.dtype)
        factor = safe_cholesky(inner + loading.mT @ scaled, "the precision of the factors")
        spread = torch.cholesky_solve(inner, factor)
        pulled = rows @ scaled
        now = _log_likelihood(rows, own, factor, pulled)
        if now - before < tolerance:
            break
        before = now
        expected = pulled @ spread
        cross = rows.mT @ expected
        loading = psd_solve(len(rows) * spread + expected.mT @ expected, cross.mT, "the factors' second moment").mT
        own = (rows.square().mean(0) - (cross * loading).sum(-1) / len(rows)).clamp_min(least_share)
    return loading, own


def _principal(rows: Tensor, rank: int, least_share: float) -> tuple[Tensor, Tensor]:
    """Loadings on the principal axes, what is left as own variance: the start of EM."""
    _, values, axes = torch.linalg.svd(rows, full_matrices=False)
    variances = values.square() / len(rows)
    left = (variances.sum() - variances[:rank].sum()) / max(1, rows.shape[-1] - rank)
    loading = axes[:rank].mT * (variances[:rank] - left).clamp_min(least_share * variances[0]).sqrt()
    return loading, (rows.square().mean(0) - loading.square().sum(-1)).clamp_min(least_share)


def _log_likelihood(rows: Tensor, own: Tensor, factor: Tensor, pulled: Tensor) -> float:
    """Mean log density of the rows, nats, from the Cholesky factor of I + L^T psi^-1 L and X psi^-1 L."""
    inside = torch.cholesky_solve(pulled.mT, factor).mT * pulled
    squares = (rows.square() / own).sum() - inside.sum()
    constant = own.log().sum() + log_det(factor) + rows.shape[-1] * math.log(2.0 * math.pi)
    return float(-0.5 * (squares / len(rows) + constant))

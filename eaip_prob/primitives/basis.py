"""Normalised Gaussian bases, in phase (ProMP) and in the decaying phase x of the canonical system (DMP).

Letters: s phase, c centre, h width, x = exp(-alpha_x s).
"""

from __future__ import annotations

from functools import lru_cache

import torch
from jaxtyping import Float
from torch import Tensor


def normalised_gaussians(
    points: Float[Tensor, "*batch"], centres: Float[Tensor, "basis"], widths: Float[Tensor, "basis"]
) -> Float[Tensor, "*batch basis"]:
    """psi_i / sum_j psi_j with psi_i = exp(-(p - c_i)^2 / (2 h_i^2)); far from all centres the nearest one wins.

    Args:
        points: where to evaluate.
        centres: c.
        widths: h, in the units of the points.
    """
    return torch.softmax(((points.unsqueeze(-1) - centres) / widths).square() * -0.5, dim=-1)


def phase_basis(
    phase: Float[Tensor, "*batch"], num_basis: int, limit: float, overlap: float, order: int = 0
) -> Float[Tensor, "*batch basis"]:
    """Bases (order 0) or derivatives by phase (order 1), centred evenly from one spacing before 0 to one after `limit`.

    Without the outer two, normalised bases are flat at both ends: a motion that starts or ends at speed would be
    represented ten times worse.

    Args:
        phase: dimensionless; values outside [0, limit] are read at the nearer end, with derivative zero.
        num_basis: at least 4.
        limit: last phase that the bases span.
        overlap: width in units of the spacing of the centres.
        order: 0 or 1.
    """
    inside = phase.clamp(0.0, limit)
    centres, widths = _even_grid(num_basis, limit, overlap)
    basis = normalised_gaussians(inside, centres, widths)
    if order == 0:
        return basis
    slope = (centres - inside[..., None]) / widths.square()
    derivative = basis * (slope - (basis * slope).sum(-1, keepdim=True))
    return torch.where((phase == inside)[..., None], derivative, 0.0)


@lru_cache(maxsize=32)
def _even_grid(num_basis: int, limit: float, overlap: float) -> tuple[Tensor, Tensor]:
    """(centres, widths) of `phase_basis`, which a control loop asks for at every step."""
    spacing = limit / (num_basis - 3)
    centres = spacing * torch.arange(-1, num_basis - 1, dtype=torch.float64)
    return centres, centres.new_full((num_basis,), overlap * spacing)


def forcing_basis(
    phase: Float[Tensor, "*batch"], num_basis: int, limit: float, alpha_x: float, overlap: float
) -> Float[Tensor, "*batch basis"]:
    """phi(x) of Eq. 2: Gaussians in x = exp(-alpha_x s), normalised, times x; centres evenly in phase.

    Args:
        phase: dimensionless, within [0, limit].
        num_basis: at least 2.
        limit: last phase that the bases span.
        alpha_x: decay of the canonical system.
        overlap: width in units of the distance to the next centre.
    """
    decay = torch.exp(-alpha_x * phase)
    centres = torch.exp(-alpha_x * torch.linspace(0.0, limit, num_basis, dtype=torch.float64))
    gaps = -centres.diff()
    widths = overlap * torch.cat([gaps, gaps[-1:]])
    return normalised_gaussians(decay, centres, widths) * decay[..., None]

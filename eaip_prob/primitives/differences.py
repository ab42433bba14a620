"""Derivatives of sampled signals by parabolas through three samples, so that noise can be propagated through them."""

from __future__ import annotations

import torch
from jaxtyping import Bool, Float, Int
from torch import Tensor

from eaip_prob.errors import InputError


def three_point_rules(
    points: Float[Tensor, "*batch time"],
) -> tuple[Int[Tensor, "time 3"], Float[Tensor, "*batch time 3"], Float[Tensor, "*batch time 3"]]:
    """(samples used, their coefficients in the first derivative, in the second) at each sample.

    The parabola goes through each sample and its neighbours; at both ends through the three samples next to them.

    Args:
        points: strictly increasing abscissae, at least three.

    Raises:
        InputError: fewer than three points, or points that do not increase.
    """
    num = points.shape[-1]
    if num < 3:
        raise InputError(f"Expected at least 3 samples to differentiate twice, got {num}. Use position evidence.")
    if bool((points.diff(dim=-1) <= 0).any()):
        raise InputError("Expected strictly increasing phases to differentiate over. A clock at rest has no forces.")
    centre = torch.arange(num).clamp(1, num - 2)
    used = torch.stack([centre - 1, centre, centre + 1], -1)
    a, b, c = (points[..., used[:, k]] for k in range(3))
    ab, ac, bc = a - b, a - c, b - c
    denominators = torch.stack([ab * ac, -ab * bc, ac * bc], -1)
    first = torch.stack([2 * points - b - c, 2 * points - a - c, 2 * points - a - b], -1) / denominators
    return used, first, 2.0 / denominators


def difference_matrices(
    points: Float[Tensor, "*batch time"],
) -> tuple[Float[Tensor, "*batch time time"], Float[Tensor, "*batch time time"]]:
    """(first, second) derivative as (T, T) matrices; exact for parabolas on any grid.

    Args:
        points: strictly increasing abscissae, at least three.

    Raises:
        InputError: fewer than three points, or points that do not increase.

    Example:
        >>> first, second = difference_matrices(torch.tensor([0.0, 1.0, 3.0], dtype=torch.float64))
        >>> (second @ torch.tensor([0.0, 1.0, 9.0], dtype=torch.float64)).tolist()
        [2.0, 2.0, 2.0]
    """
    used, first, second = three_point_rules(points)
    return matrix_from_rules(used, first), matrix_from_rules(used, second)


def matrix_from_rules(
    used: Int[Tensor, "time 3"], coefficients: Float[Tensor, "*batch time 3"]
) -> Float[Tensor, "*batch time time"]:
    """The matrix whose rows hold the coefficients at the samples used."""
    matrix = coefficients.new_zeros(*coefficients.shape[:-1], coefficients.shape[-2])
    return matrix.scatter_(-1, used.expand(coefficients.shape), coefficients)


def advancing(points: Float[Tensor, "*batch time"]) -> tuple[Float[Tensor, "*batch time"], Bool[Tensor, "*batch time"]]:
    """(points with a step of 1 wherever they rest, True where a point lies above the one before).

    Derivatives depend on steps only, so those that use no resting point are unchanged.

    Example:
        >>> points, moves = advancing(torch.tensor([0.0, 0.5, 1.0, 1.0, 1.0]))
        >>> points.tolist(), moves.tolist()
        ([0.0, 0.5, 1.0, 2.0, 3.0], [True, True, True, False, False])
    """
    step = points.diff(dim=-1)
    moves = torch.nn.functional.pad(step > 0, (1, 0), value=True)
    if bool(moves.all()):
        return points, moves
    shift = torch.where(step > 0, 0.0, 1.0 - step).cumsum(-1)
    return points + torch.nn.functional.pad(shift, (1, 0)), moves

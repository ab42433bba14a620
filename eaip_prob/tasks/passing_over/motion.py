"""Two ingredients of a human point-to-point motion: a minimum-jerk path through via-points, and tremor.

Minimum jerk (Flash and Hogan, J. Neurosci. 1985): of all motions that rest at both ends and are at given points at
given times, people choose the one with the least integral of squared jerk. It is a spline of quintics whose
velocities and accelerations at the via-points are free; since the integral is quadratic in them, they solve one
small symmetric system per motion.

Notation: K knots (start, K - 2 via-points, end), D signals, T samples, s in [0, 1] the share of a segment passed.
"""

from __future__ import annotations

import torch
from jaxtyping import Float
from torch import Tensor

from eaip_prob.checks import check_finite, check_positive, check_shape
from eaip_prob.errors import InputError
from eaip_prob.linalg import psd_solve

# Rows: position, velocity, acceleration at s = 0, then at s = 1; columns: coefficients of s^0 ... s^5.
_HERMITE = torch.tensor(
    [
        [1.0, 0.0, 0.0, -10.0, 15.0, -6.0],
        [0.0, 1.0, 0.0, -6.0, 8.0, -3.0],
        [0.0, 0.0, 0.5, -1.5, 1.5, -0.5],
        [0.0, 0.0, 0.0, 10.0, -15.0, 6.0],
        [0.0, 0.0, 0.0, -4.0, 7.0, -3.0],
        [0.0, 0.0, 0.0, 0.5, -1.0, 0.5],
    ],
    dtype=torch.float64,
)
_TREMOR_SPACING = 0.25


def minimum_jerk_states(
    points: Float[Tensor, "*batch knots signals"], durations: Float[Tensor, "*batch segments"]
) -> Float[Tensor, "*batch knots 3 signals"]:
    """Position, velocity and acceleration at the knots of the motion with the least squared jerk.

    The motion rests at both ends (no velocity, no acceleration) and is at `points[..., k, :]` after the first k
    durations. With x the free velocities and accelerations and p the points, the integral of squared jerk is
    x^T A x + 2 x^T B p + const, so x = -A^{-1} B p.

    Args:
        points: start, via-points, end; at least two.
        durations: seconds from knot to knot, one fewer than knots, above zero.

    Returns:
        the states; axis 3 is position, velocity (per second), acceleration (per second squared).

    Raises:
        ShapeError: the number of durations does not fit the number of points.
        InputError: a duration that is not above zero, or entries that are not finite.

    Example:
        >>> points = torch.tensor([[0.0], [1.0], [2.0]], dtype=torch.float64)
        >>> states = minimum_jerk_states(points, torch.tensor([0.5, 0.5], dtype=torch.float64))
        >>> states[1, :2, 0]
        tensor([1.0000, 3.7500], dtype=torch.float64)
    """
    num_knots = points.shape[-2]
    check_shape("durations", durations, [num_knots - 1])
    check_finite("points", points)
    check_finite("durations", durations)
    if num_knots < 2 or bool((durations <= 0).any()):
        raise InputError(f"Expected at least two points and durations above zero, got {num_knots} and {durations}.")
    cost = _squared_jerk(durations)
    positions = torch.arange(0, 3 * num_knots, 3)
    free = torch.tensor([i for i in range(3, 3 * num_knots - 3) if i % 3], dtype=torch.long)
    coupling = cost[..., free, :][..., positions]
    solution = -psd_solve(cost[..., free, :][..., free], coupling @ points, "minimum-jerk cost")
    states = points.new_zeros(*solution.shape[:-2], num_knots, 3, points.shape[-1])
    states[..., 0, :] = points
    states[..., 1:-1, 1:, :] = solution.unflatten(-2, (num_knots - 2, 2))
    return states


def _squared_jerk(durations: Tensor) -> Tensor:
    """Quadratic form (*batch, 3K, 3K) of the integral of squared jerk in the knots' states."""
    third = _HERMITE[:, 3:] * torch.tensor([6.0, 24.0, 60.0], dtype=torch.float64)
    powers = torch.arange(3)
    moments = 1.0 / (powers[:, None] + powers + 1.0).to(torch.float64)
    scale = _state_scale(durations)
    segment = third @ moments @ third.T * scale[..., :, None] * scale[..., None, :] / durations[..., None, None] ** 5
    num_segments = durations.shape[-1]
    cost = durations.new_zeros(*durations.shape[:-1], 3 * num_segments + 3, 3 * num_segments + 3)
    for number in range(num_segments):
        rows = slice(3 * number, 3 * number + 6)
        cost[..., rows, rows] += segment[..., number, :, :]
    return cost


def _state_scale(durations: Tensor) -> Tensor:
    """Factors (..., 6) that turn derivatives by time into derivatives by s."""
    one = torch.ones_like(durations)
    return torch.stack([one, durations, durations**2] * 2, -1)


def quintic_positions(
    states: Float[Tensor, "*batch knots 3 signals"],
    durations: Float[Tensor, "*batch segments"],
    time: Float[Tensor, "*#batch samples"],
) -> Float[Tensor, "*batch samples signals"]:
    """Positions at the given times of the quintic spline with the given knot states; the end is held.

    Args:
        states: position, velocity, acceleration at each knot, as `minimum_jerk_states` returns them.
        durations: seconds from knot to knot.
        time: seconds since the start, from zero on.

    Example:
        >>> durations = torch.tensor([2.0], dtype=torch.float64)
        >>> states = minimum_jerk_states(torch.tensor([[0.0], [10.0]], dtype=torch.float64), durations)
        >>> quintic_positions(states, durations, torch.tensor([0.0, 1.0, 2.0, 9.0], dtype=torch.float64))[:, 0]
        tensor([ 0.,  5., 10., 10.], dtype=torch.float64)
    """
    batch, num_samples = durations.shape[:-1], time.shape[-1]
    knots = torch.nn.functional.pad(durations.cumsum(-1), (1, 0))
    time = torch.minimum(time.expand(*batch, num_samples), knots[..., -1:]).contiguous()
    segment = torch.searchsorted(knots[..., 1:-1].contiguous(), time, right=True)
    lengths = durations.gather(-1, segment)
    share = (time - knots.gather(-1, segment)) / lengths
    powers = share[..., None] ** torch.arange(6)
    basis = powers @ _HERMITE.T * _state_scale(lengths)
    ends = torch.cat([states[..., :-1, :, :], states[..., 1:, :, :]], -2)
    index = segment[..., None, None].expand(*segment.shape, *ends.shape[-2:])
    return torch.einsum("...tk,...tkd->...td", basis, ends.gather(-3, index))


def tremor(
    num: int, time: Float[Tensor, " samples"], rms: float, band: tuple[float, float], generator: torch.Generator
) -> Float[Tensor, "{num} samples 2"]:
    """Band-limited Gaussian tremor of two independent axes, stationary, with the given expected rms per axis.

    A sum of sinusoids 0.25 Hz apart (it repeats after 4 s) with normal amplitudes of variance rms^2 / number.

    Args:
        num: motions.
        time: seconds.
        rms: root mean square of each axis, in the unit of the motion; zero for none.
        band: lowest and highest frequency, Hz.
        generator: source of randomness.

    Raises:
        InputError: a band that is empty or not above zero, or a negative rms.

    Example:
        >>> time = torch.arange(400, dtype=torch.float64) / 100.0
        >>> shake = tremor(50, time, 2.0, (8.0, 12.0), torch.Generator().manual_seed(0))
        >>> 1.8 < float(shake.square().mean().sqrt()) < 2.2
        True
    """
    low, high = check_positive("tremor band", band[0]), band[1]
    if high < low or rms < 0:
        raise InputError(f"Expected a tremor band (low, high) in Hz and an rms of at least zero, got {band} and {rms}.")
    frequencies = torch.arange(low, high + 1e-9, _TREMOR_SPACING, dtype=torch.float64)
    angle = 2.0 * torch.pi * time[:, None] * frequencies
    waves = torch.cat([angle.cos(), angle.sin()], -1)
    amplitudes = torch.randn(num, waves.shape[-1], 2, generator=generator, dtype=torch.float64)
    return waves @ amplitudes * (rms / len(frequencies) ** 0.5)

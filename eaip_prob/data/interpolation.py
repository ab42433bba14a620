"""Lines between observed samples, per signal, and the covariance of what is read from them.

Interpolation is linear, per signal, between observed samples only: at time t between the observed samples l and r
of a signal, `y(t) = (1 - w) y_l + w y_r` with `w = (t - t_l) / (t_r - t_l)`. Errors of the sensor are taken as
independent between samples, so the covariance of two signals is the sum over the samples that both use,
`cov(y_a, y_b) = sum_i w_ai w_bi R_i[a, b]`. New samples between the same two old ones share their errors, which
the noise of a single sample cannot express: a finer grid adds no information.
"""

from __future__ import annotations

from typing import NamedTuple

import torch
from jaxtyping import Bool, Float, Int
from torch import Tensor

from eaip_prob.data.trajectory import Trajectory


class Segments(NamedTuple):
    """From each sample up to the next one, per signal: the line between the observed samples around."""

    left: Int[Tensor, "*batch time signals"]
    right: Int[Tensor, "*batch time signals"]
    start: Float[Tensor, "*batch time signals"]
    span: Float[Tensor, "*batch time signals"]
    value: Float[Tensor, "*batch time signals"]
    slope: Float[Tensor, "*batch time signals"]
    # Latest time at which the line may be read: its right end, its left end where the gap is too long, or never.
    valid_until: Float[Tensor, "*batch time signals"]


class Readings(NamedTuple):
    """What the lines say at new times."""

    values: Float[Tensor, "*batch new signals"]
    mask: Bool[Tensor, "*batch new signals"]
    noise: Float[Tensor, "*batch new signals signals"] | None


def segments(trajectory: Trajectory, gap: Float[Tensor, "*#batch"], snap: Float[Tensor, "*#batch"]) -> Segments:
    """Lines of every signal; observed samples further apart than `gap` (seconds, within `snap`) are not joined."""
    mask, num_samples = trajectory.mask, trajectory.num_samples
    index = torch.arange(num_samples, device=mask.device)[:, None]
    left = torch.where(mask, index, -1).cummax(-2).values
    later = torch.where(mask, index, num_samples).flip(-2).cummin(-2).values.flip(-2)
    right = torch.nn.functional.pad(later[..., 1:, :], (0, 0, 0, 1), value=num_samples)
    known, has_right = left >= 0, right < num_samples
    left, right = left.clamp_min(0), right.clamp_max(num_samples - 1)
    times = trajectory.time[..., None].expand(mask.shape)
    start, end = times.gather(-2, left), times.gather(-2, right)
    bridged = known & has_right & (end - start <= (gap + snap)[..., None, None])
    span = torch.where(bridged, end - start, torch.inf)
    value = trajectory.values.gather(-2, left)
    slope = torch.where(bridged, (trajectory.values.gather(-2, right) - value) / span, 0.0)
    valid_until = torch.where(bridged, end, torch.where(known, start + snap[..., None, None], -torch.inf))
    return Segments(left, right, start, span, value, slope, valid_until)


def read(
    lines: Segments, at: Int[Tensor, "*batch new"], time: Float[Tensor, "*#batch new"], noise: Tensor | None
) -> Readings:
    """Values, mask and noise at `time`, of which `at` is the last sample at or before (-1: none)."""
    index = at.clamp_min(0)
    start, value, slope, valid_until = (
        _rows(table, index) for table in (lines.start, lines.value, lines.slope, lines.valid_until)
    )
    since = time[..., None] - start
    mask = (at[..., None] >= 0) & (time[..., None] <= valid_until)
    values = torch.addcmul(value, slope, since)
    if noise is None:
        return Readings(values, mask, None)
    later = torch.where(mask, since / _rows(lines.span, index), 0.0).clamp(0.0, 1.0)
    parts = ((_rows(lines.left, index), 1.0 - later), (_rows(lines.right, index), later))
    return Readings(values, mask, combined_noise(noise.expand(*at.shape[:-1], *noise.shape[-3:]), parts))


def _rows(table: Tensor, index: Tensor) -> Float[Tensor, "*batch new columns"]:
    """Row `index[..., m]` of each batch member's table (*#batch, T, C)."""
    batch, (num_rows, size) = index.shape[:-1], table.shape[-2:]
    flat = table.expand(*batch, num_rows, size).reshape(-1, size)
    first = torch.arange(0, len(flat), num_rows, device=index.device).reshape(*batch, 1)
    return flat.index_select(0, (index + first).flatten()).reshape(*index.shape, size)


def combined_noise(
    noise: Float[Tensor, "*batch time signals signals"], parts: tuple[tuple[Tensor, Tensor], ...]
) -> Float[Tensor, "*batch new signals signals"]:
    """Covariance of weighted sums of samples.

    Args:
        noise: covariance of each sample.
        parts: per term of the sum, which sample each signal takes, (*batch, M, D), and its weight, (*batch, M, D).
    """
    total = noise.new_zeros(())
    for index, weight in parts:
        source = noise.gather(-3, index[..., None].expand(*index.shape, index.shape[-1]))
        for other, other_weight in parts:
            shared = index[..., :, None] == other[..., None, :]
            total = total + torch.where(shared, weight[..., :, None] * other_weight[..., None, :] * source, 0.0)
    return total

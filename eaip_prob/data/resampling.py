"""Trajectories at other times: interpolation that never reads a missing sample, and motions held after their end.

The interpolation itself, and what becomes of the noise, is in `interpolation`.
"""

from __future__ import annotations

import math

import torch
from jaxtyping import Float, Int
from torch import Tensor

from eaip_prob.checks import as_float64, check_finite, check_positive
from eaip_prob.data.interpolation import combined_noise, read, segments
from eaip_prob.data.trajectory import Trajectory
from eaip_prob.errors import InputError, ShapeError

_GAP_STEPS = 3.0
# Times closer than this share of a step are one: linspace and k / rate miss recorded times by round-off.
_SNAP_STEPS = 1e-6


def resample(trajectory: Trajectory, time: Float[Tensor, "*#batch new"], max_gap: float | None = None) -> Trajectory:
    """The trajectory at other times, interpolated linearly per signal between observed samples.

    A new sample is unseen outside the observed span of its signal, and where the two observed samples around it
    are further apart than `max_gap`. At the time of an observed sample it is that sample.

    Args:
        trajectory: any batch.
        time: (*batch, M) or (M,), seconds, strictly increasing. A single trajectory may be given a batch of times.
        max_gap: longest gap that is bridged, seconds; `math.inf` bridges all. Default: three median steps of each
            motion, so that drop-outs of up to two samples are filled and longer ones stay unseen.

    Returns:
        (*batch, M, D) at `time`; a shared (M,) stays unbatched.

    Raises:
        InputError: time that is not finite or not increasing, or a gap that is not above zero.
        ShapeError: batch axes of time that do not fit the trajectory's.

    Example:
        >>> lift = Trajectory(time=[0.0, 2.0, 4.0], values=[[0.0], [6.0], [7.0]])
        >>> resample(lift, [1.0, 3.0, 5.0]).values[:, 0]
        tensor([3.0000, 6.5000, 0.0000], dtype=torch.float64)
    """
    time = as_float64("time", time)
    if time.ndim == 0:
        raise ShapeError("Expected time with shape (*batch, M), got a single number. Use [number].")
    check_finite("time", time)
    batch = _common_batch(trajectory, time)
    step = _median_step(trajectory)
    gap = _GAP_STEPS * step if max_gap is None else torch.full_like(step, _checked_gap(max_gap))
    snap = _SNAP_STEPS * step
    at = _last_sample(trajectory.time, time, snap, batch)
    values, mask, noise = read(segments(trajectory, gap, snap), at, time, trajectory.noise)
    return Trajectory(time, values, trajectory.names, mask, noise)


def _checked_gap(max_gap: float) -> float:
    if math.isnan(max_gap) or max_gap <= 0:
        raise InputError(f"Expected max_gap above zero (seconds; math.inf bridges all gaps), got {max_gap}.")
    return float(max_gap)


def _common_batch(trajectory: Trajectory, time: Tensor) -> torch.Size:
    own, new = trajectory.batch_shape, time.shape[:-1]
    try:
        batch = torch.broadcast_shapes(own, new)
    except RuntimeError:
        batch = None
    if batch is None or (own and batch != own):
        raise ShapeError(f"Expected time with batch axes that fit {tuple(own)}, got shape {tuple(time.shape)}.")
    return batch


def _median_step(trajectory: Trajectory) -> Float[Tensor, "*#batch"]:
    """Median time between samples; 1 s where there is one sample only and nothing to interpolate."""
    if trajectory.num_samples == 1:
        return torch.ones_like(trajectory.time[..., 0])
    return trajectory.time.diff(dim=-1).median(-1).values


def _last_sample(own: Tensor, time: Tensor, snap: Tensor, batch: torch.Size) -> Int[Tensor, "*batch new"]:
    """Index of the last sample, seen or not, at or before each new time; -1 before the first."""
    if own.ndim > 1:
        own, time = own.expand(*batch, own.shape[-1]), time.expand(*batch, time.shape[-1])
    at = torch.searchsorted(own.contiguous(), (time + snap[..., None]).contiguous(), right=True) - 1
    return at.expand(*batch, time.shape[-1])


def time_normalised(trajectory: Trajectory, num_samples: int) -> Trajectory:
    """`num_samples` equally spaced samples from each motion's first sample to its last one seen.

    `time` keeps real seconds: motions of different durations get different steps. Gaps are bridged as `resample`
    does by default.

    Args:
        trajectory: any batch, padded ones included.
        num_samples: at least 2.

    Returns:
        (*batch, num_samples, D); time is unbatched where it was and all motions end together.

    Raises:
        InputError: too few samples, or a motion in which nothing was seen after its first sample.

    Example:
        >>> lift = Trajectory(time=[0.0, 2.0, 4.0], values=[[0.0], [6.0], [7.0]])
        >>> time_normalised(lift, 5).time
        tensor([0., 1., 2., 3., 4.], dtype=torch.float64)
    """
    if num_samples < 2:
        raise InputError(f"Expected num_samples of at least 2, got {num_samples}.")
    end = trajectory.end
    start = trajectory.time[..., 0]
    if bool((end <= start).any()):
        at = tuple(int(i) for i in (end <= start).nonzero()[0])
        raise InputError(f"Expected motions seen after their first sample, got none in batch member {at}. Drop it.")
    if start.ndim == 0 and bool((end == end.flatten()[0]).all()):
        end = end.flatten()[0]
    share = torch.linspace(0.0, 1.0, num_samples, dtype=torch.float64, device=start.device)
    # lerp meets both ends exactly; start + duration * share may pass the last sample by round-off.
    return resample(trajectory, torch.lerp(start.expand(end.shape)[..., None], end[..., None], share))


def resampled_at_rate(trajectory: Trajectory, rate: float) -> Trajectory:
    """Samples every 1 / rate seconds from each motion's first sample up to its last one seen.

    Motions of a batch that end early are padded with unseen samples. Gaps are bridged as `resample` does by default.

    Args:
        trajectory: any batch, padded ones included.
        rate: samples per second.

    Raises:
        InputError: a rate that is not above zero.

    Example:
        >>> lift = Trajectory(time=[0.0, 2.0, 4.0], values=[[0.0], [6.0], [7.0]])
        >>> resampled_at_rate(lift, 0.5).time
        tensor([0., 2., 4.], dtype=torch.float64)
    """
    check_positive("rate", rate)
    steps = int(torch.floor(trajectory.duration.amax() * rate + _SNAP_STEPS))
    start = trajectory.time[..., :1]
    return resample(trajectory, start + torch.arange(steps + 1, dtype=torch.float64, device=start.device) / rate)


def held(trajectory: Trajectory, until: float | Float[Tensor, "*#batch"]) -> Trajectory:
    """The same motions, at rest after their end: the last seen value of each signal up to the time `until`.

    Samples behind a motion's last seen one (the padding of a batch) get the held values and count as seen; samples
    at each motion's median step are appended until every motion reaches its `until`. What was missed before the end
    stays missing, and so does a signal that was never seen. Held noise is that of the samples held.

    Args:
        trajectory: any batch, padded ones included.
        until: seconds, one number or one per motion; motions that already go on for longer are not cut.

    Raises:
        InputError: `until` is not finite, or there is one sample only, which has no step.
        ShapeError: `until` has other batch axes than the trajectory.

    Example:
        >>> lift = Trajectory(time=[0.0, 0.5], values=[[0.0], [6.0]])
        >>> held(lift, until=1.5).values[:, 0]
        tensor([0., 6., 6., 6.], dtype=torch.float64)
    """
    until = as_float64("until", until)
    check_finite("until", until)
    _check_member_shape(until, trajectory.batch_shape)
    time = _extended_time(trajectory, until)
    added = time.shape[-1] - trajectory.num_samples
    index = torch.arange(time.shape[-1], device=time.device)[:, None]
    mask = torch.nn.functional.pad(trajectory.mask, (0, 0, 0, added))
    last = torch.where(mask, index, -1).amax(-2, keepdim=True)
    behind = (index > last.amax(-1, keepdim=True)) & (last >= 0)
    source = torch.where(behind, last, index).clamp(0, trajectory.num_samples - 1)
    whole = trajectory.values.new_ones(source.shape)
    noise = None if trajectory.noise is None else combined_noise(trajectory.noise, ((source, whole),))
    return Trajectory(time, trajectory.values.gather(-2, source), trajectory.names, mask | behind, noise)


def _check_member_shape(until: Tensor, batch: torch.Size) -> None:
    if until.ndim > len(batch) or any(a not in (1, b) for a, b in zip(until.shape[::-1], batch[::-1], strict=False)):
        raise ShapeError(f"Expected until as one number or with batch axes {tuple(batch)}, got {tuple(until.shape)}.")


def _extended_time(trajectory: Trajectory, until: Tensor) -> Tensor:
    time, step = trajectory.time, _median_step(trajectory)
    missing = torch.ceil((until - time[..., -1]) / step - _SNAP_STEPS).amax()
    added = max(int(missing), 0)
    if added and trajectory.num_samples == 1:
        raise InputError("Expected at least two samples to know the step at which a motion goes on, got one.")
    steps = torch.arange(1, added + 1, dtype=torch.float64, device=time.device)
    return torch.cat([time, time[..., -1:] + step[..., None] * steps], dim=-1)

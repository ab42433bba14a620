"""Samples that arrive in parts, late ones included, as one trajectory."""

from __future__ import annotations

import torch

from eaip_prob.data.trajectory import Trajectory
from eaip_prob.errors import InputError


def merged(first: Trajectory, second: Trajectory) -> Trajectory:
    """All samples of two single trajectories of the same signals, in the order of time.

    Of a signal that both have seen at the same time, the second counts.

    Raises:
        InputError: other names, a batch, or noise given for one only.

    Example:
        >>> early, late = Trajectory([0.0, 0.2], [[1.0], [3.0]]), Trajectory([0.1], [[2.0]])
        >>> merged(early, late).values[:, 0].tolist()
        [1.0, 2.0, 3.0]
    """
    if first.names != second.names or first.batch_shape or second.batch_shape:
        raise InputError(
            f"Expected single trajectories of the signals {first.names}, got {second.names} with batches "
            f"{tuple(first.batch_shape)} and {tuple(second.batch_shape)}."
        )
    if (first.noise is None) != (second.noise is None):
        raise InputError("Expected noise for all samples or for none; some arrived with it and some without.")
    if bool(second.time[0] > first.time[-1]):
        return _appended(first, second)
    time, place = torch.unique(torch.cat([first.time, second.time]), return_inverse=True)
    values = first.values.new_zeros(len(time), first.num_signals)
    mask = torch.zeros_like(values, dtype=torch.bool)
    noise = None if first.noise is None else values.new_zeros(*values.shape, first.num_signals)
    for part, at in ((first, place[: first.num_samples]), (second, place[first.num_samples :])):
        values[at] = torch.where(part.mask, part.values, values[at])
        mask[at] |= part.mask
        if noise is not None and part.noise is not None:
            rows, columns = part.mask[..., :, None], part.mask[..., None, :]
            noise[at] = torch.where(rows & columns, part.noise, torch.where(rows | columns, 0.0, noise[at]))
    return Trajectory(time, values, first.names, mask, noise)


def _appended(first: Trajectory, second: Trajectory) -> Trajectory:
    parts = [first, second]
    time, values, mask = (torch.cat([getattr(part, name) for part in parts]) for name in ("time", "values", "mask"))
    noise = None if first.noise is None else torch.cat([part.noise for part in parts if part.noise is not None])
    return Trajectory.of_checked(time, values, first.names, mask, noise)

"""Trajectories: sampled signals with their time, a mask of what was seen, and the sensor's noise."""

from __future__ import annotations

import dataclasses
import numbers
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import torch
from jaxtyping import Bool, Float
from torch import Tensor

from eaip_prob.checks import as_bool, as_float64, check_finite, check_names, check_shape, check_type
from eaip_prob.errors import InputError, ShapeError

_ADVICE = "Make one with Trajectory(time, values, names)."


@dataclass(frozen=True, eq=False)
class Trajectory:
    """Signals of one agent over time; leading batch axes hold several motions side by side.

    Missing samples are `mask = False`; their stored value is 0 and is never read. NaN is accepted in `values`
    only where the mask is False.

    Args:
        time: (*batch, T) or (T,), seconds, strictly increasing.
        values: (*batch, T, D), in the signals' own units.
        names: D names; default `("0", "1", ...)`.
        mask: (*batch, T, D), True where a sample was seen; default everything.
        noise: (*batch, T, D, D) or (T, D, D), covariance of the sensor per sample, or None where it is unknown.

    Raises:
        ShapeError: axes do not match.
        InputError: NaN or infinity where the mask is True, or time that does not increase.

    Example:
        >>> reach = Trajectory(time=[0.0, 0.1, 0.2], values=[[0.0], [0.5], [1.0]], names=["x"])
        >>> reach.first(2).values.shape
        torch.Size([2, 1])
    """

    time: Float[Tensor, "*#batch time"]
    values: Float[Tensor, "*batch time signals"]
    names: tuple[str, ...] = ()
    mask: Bool[Tensor, "*batch time signals"] = None  # pyright: ignore[reportAssignmentType]  # filled below
    noise: Float[Tensor, "*#batch time signals signals"] | None = None

    def __post_init__(self) -> None:
        time, values = as_float64("time", self.time), as_float64("values", self.values)
        if values.ndim < 2:
            raise ShapeError(
                f"Expected values with shape (*batch, T, D), got {tuple(values.shape)}. "
                "A single signal needs its own axis: values[:, None]."
            )
        num_samples, num_signals = values.shape[-2:]
        if num_samples == 0 or num_signals == 0:
            raise ShapeError(
                f"Expected at least one sample and one signal, got values with shape {tuple(values.shape)}."
            )
        check_shape("time", time, [num_samples])
        _check_batch("time", time.shape[:-1], values.shape[:-2])
        check_finite("time", time, advice="Leave out samples whose time is unknown.")
        if bool((time.diff(dim=-1) <= 0).any()):
            at = tuple(int(i) for i in (time.diff(dim=-1) <= 0).nonzero()[0])
            raise InputError(
                f"Expected strictly increasing time, got a step of {float(time.diff(dim=-1)[at]):.3g} s "
                f"after sample {at}. Sort the samples and leave out repeated ones."
            )
        mask = torch.ones_like(values, dtype=torch.bool) if self.mask is None else as_bool("mask", self.mask)
        if mask.shape != values.shape:
            raise ShapeError(f"Expected mask with the shape of values, {tuple(values.shape)}, got {tuple(mask.shape)}.")
        check_finite("values", values, where=mask)
        names = self.names or tuple(str(i) for i in range(num_signals))
        fields: dict[str, Any] = {
            "time": time,
            "values": torch.where(mask, values, 0.0),
            "mask": mask,
            "names": check_names("names", names, num_signals),
        }
        if self.noise is not None:
            fields["noise"] = self._checked_noise(values.shape)
        for key, value in fields.items():
            object.__setattr__(self, key, value)

    def _checked_noise(self, shape: torch.Size) -> Tensor:
        noise = as_float64("noise", self.noise)
        check_shape("noise", noise, [*shape[-2:], shape[-1]])
        _check_batch("noise", noise.shape[:-3], shape[:-2])
        noise = noise.expand(*shape, shape[-1])
        check_finite("noise", noise, advice="Give the sensor's covariance, or noise=None.")
        if bool((noise.diagonal(dim1=-2, dim2=-1) < 0).any()):
            raise InputError("Expected noise as covariances (units squared), got a negative variance.")
        return noise

    @classmethod
    def of_checked(
        cls, time: Tensor, values: Tensor, names: tuple[str, ...], mask: Tensor, noise: Tensor | None
    ) -> Trajectory:
        """A trajectory put together from parts of others, whose checks were theirs: for loops that run all the time."""
        made = object.__new__(cls)
        parts = {"time": time, "values": values, "names": names, "mask": mask, "noise": noise}
        for key, part in parts.items():
            object.__setattr__(made, key, part)
        return made

    @property
    def batch_shape(self) -> torch.Size:
        """Leading axes; empty for a single motion."""
        return self.values.shape[:-2]

    @property
    def num_samples(self) -> int:
        """T, padded samples included."""
        return self.values.shape[-2]

    @property
    def num_signals(self) -> int:
        """D."""
        return self.values.shape[-1]

    @property
    def seen(self) -> Bool[Tensor, "*batch time"]:
        """Samples at which any signal was seen."""
        return self.mask.any(-1)

    @property
    def end(self) -> Float[Tensor, "*batch"]:
        """Time of the last sample at which any signal was seen (the first sample where none was), seconds."""
        time = self.time.expand(self.seen.shape)
        return torch.where(self.seen, time, time[..., :1]).amax(-1)

    @property
    def duration(self) -> Float[Tensor, "*batch"]:
        """Time from the first sample to the last one seen, seconds."""
        return self.end - self.time[..., 0]

    def first(self, num_samples: int) -> Trajectory:
        """The first samples, as somebody watching would have seen them so far."""
        return self._at_samples(slice(None, self._checked_count(num_samples)))

    def last(self, num_samples: int) -> Trajectory:
        """The last samples, as they arrive one after another."""
        return self._at_samples(slice(self.num_samples - self._checked_count(num_samples), None))

    def _checked_count(self, num_samples: int) -> int:
        if not (isinstance(num_samples, numbers.Integral) and 1 <= num_samples <= self.num_samples):
            raise InputError(
                f"Expected num_samples from 1 to {self.num_samples}, got {num_samples!r}. Give a whole number."
            )
        return num_samples

    def _at_samples(self, index: slice) -> Trajectory:
        noise = None if self.noise is None else self.noise[..., index, :, :]
        return Trajectory(
            self.time[..., index], self.values[..., index, :], self.names, self.mask[..., index, :], noise
        )

    def select(self, names: Sequence[str]) -> Trajectory:
        """Only the named signals, in the order given."""
        index = self._indices(names)
        noise = None if self.noise is None else self.noise[..., index, :][..., index]
        return Trajectory(self.time, self.values[..., index], tuple(names), self.mask[..., index], noise)

    def hide(self, names: Sequence[str]) -> Trajectory:
        """The same trajectory with the named signals marked as not seen."""
        mask = self.mask.clone()
        mask[..., self._indices(names)] = False
        return dataclasses.replace(self, mask=mask)

    def _indices(self, names: Sequence[str]) -> list[int]:
        unknown = [name for name in names if name not in self.names]
        if unknown:
            raise InputError(f"Expected signals among {self.names}, got {tuple(unknown)}.")
        return [self.names.index(name) for name in names]

    def members(self, places: Sequence[int]) -> Trajectory:
        """Some motions of a batch (N, T, D), as they would be stacked: no longer than the longest of them.

        A time vector that all motions share stays shared.
        """
        index = torch.as_tensor(places, dtype=torch.long)
        noise = None if self.noise is None else self.noise[index]
        time = self.time if self.time.ndim == 1 else self.time[index]
        part = Trajectory(time, self.values[index], self.names, self.mask[index], noise)
        return part.first(int((part.seen.any(0).nonzero()[-1] if bool(part.mask.any()) else torch.zeros(1))[0]) + 1)

    def __getitem__(self, index: Any) -> Trajectory:
        """One or several motions of a batch."""
        if not self.batch_shape:
            raise InputError("Expected a batch of trajectories to index; this one is single. Use first() or select().")
        time = self.time.expand(self.values.shape[:-1])[index]
        noise = None if self.noise is None else self.noise[index]
        return Trajectory(time, self.values[index], self.names, self.mask[index], noise)


def _check_batch(name: str, came: torch.Size, batch: torch.Size) -> None:
    if len(came) > len(batch) or any(a not in (1, b) for a, b in zip(came[::-1], batch[::-1], strict=False)):
        raise ShapeError(f"Expected {name} with the batch axes of values, {tuple(batch)}, got {tuple(came)}.")


def stack(trajectories: Sequence[Trajectory]) -> Trajectory:
    """One batch (N, T, D) from N single trajectories; shorter ones are padded with unseen samples.

    Padded time goes on at each motion's own median step, so that it stays strictly increasing. Where all
    motions share one time vector the result keeps it unbatched, (T,), which keeps later designs shared.

    Args:
        trajectories: N single ones, values (T_n, D), with the same signals; T is the largest T_n.

    Raises:
        InputError: no trajectory, names that differ, or noise given for some only.

    Example:
        >>> short = Trajectory(time=[0.0, 0.1], values=[[1.0], [2.0]])
        >>> long = Trajectory(time=[0.0, 0.1, 0.2], values=[[1.0], [2.0], [3.0]])
        >>> motions = stack([short, long])
        >>> tuple(motions.values.shape), motions.seen.sum(-1).tolist()
        ((2, 3, 1), [2, 3])
    """
    if not isinstance(trajectories, Sequence):
        raise InputError(f"Expected a Trajectory or a sequence of them, got {type(trajectories).__name__}. {_ADVICE}")
    if not trajectories:
        raise InputError("Expected at least one trajectory to stack, got none.")
    for trajectory in trajectories:
        check_type("every member of the sequence", trajectory, Trajectory, _ADVICE)
    names = trajectories[0].names
    for trajectory in trajectories:
        if trajectory.names != names or trajectory.batch_shape:
            raise InputError(
                f"Expected single trajectories with signals {names}, got {trajectory.names} "
                f"with batch {tuple(trajectory.batch_shape)}."
            )
    if len({trajectory.noise is None for trajectory in trajectories}) > 1:
        raise InputError("Expected noise for all trajectories or for none; some have it and some do not.")
    longest = max(trajectories, key=lambda trajectory: trajectory.num_samples)
    padded = [_padded(trajectory, longest.num_samples) for trajectory in trajectories]
    time = torch.stack([trajectory.time for trajectory in padded])
    if all(_is_prefix(trajectory.time, longest.time) for trajectory in trajectories):
        time = longest.time
    noise = None if padded[0].noise is None else torch.stack([t.noise for t in padded if t.noise is not None])
    return Trajectory(
        time, torch.stack([t.values for t in padded]), names, torch.stack([t.mask for t in padded]), noise
    )


def _is_prefix(time: Tensor, longest: Tensor) -> bool:
    return bool(torch.allclose(time, longest[: len(time)], rtol=0.0, atol=1e-9))


def _padded(trajectory: Trajectory, length: int) -> Trajectory:
    missing = length - trajectory.num_samples
    if missing == 0:
        return trajectory
    step = trajectory.time.diff().median() if trajectory.num_samples > 1 else trajectory.time.new_tensor(1.0)
    time = torch.cat([trajectory.time, trajectory.time[-1] + step * torch.arange(1, missing + 1, dtype=torch.float64)])
    values = torch.nn.functional.pad(trajectory.values, (0, 0, 0, missing))
    mask = torch.nn.functional.pad(trajectory.mask, (0, 0, 0, missing))
    noise = trajectory.noise
    if noise is not None:
        noise = torch.cat([noise, noise[-1:].expand(missing, -1, -1)])
    return Trajectory(time, values, trajectory.names, mask, noise)

"""Which motions are left out together, and how much of each is seen."""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass

from jaxtyping import Float
from torch import Tensor

from eaip_prob.data.demonstrations import DemonstrationSet
from eaip_prob.data.trajectory import Trajectory
from eaip_prob.errors import InputError


@dataclass(frozen=True, eq=False)
class Fold:
    """What is fitted, and what is predicted: no group is in both.

    Args:
        training: demonstrations to fit to.
        test: demonstrations to predict.
        places: where those of `test` stand among all demonstrations.
    """

    training: DemonstrationSet
    test: DemonstrationSet
    places: tuple[int, ...]


def consecutive_folds(demonstrations: DemonstrationSet, num_folds: int) -> list[Fold]:
    """Disjoint folds; each leaves out groups that follow one another in sorted order, as evenly as they divide.

    Args:
        demonstrations: of at least two groups.
        num_folds: from 2 to the number of groups.

    Raises:
        InputError: another number of folds.

    Example:
        >>> from eaip_prob.data import Demonstration
        >>> still = Trajectory(time=[0.0, 1.0], values=[[0.0], [0.0]])
        >>> people = DemonstrationSet([Demonstration(still)] * 4, ["dan", "ann", "ben", "ann"])
        >>> [fold.places for fold in consecutive_folds(people, 2)]
        [(1, 2, 3), (0,)]
    """
    labels = sorted(set(demonstrations.groups))
    if not 2 <= num_folds <= len(labels):
        raise InputError(f"Expected num_folds from 2 to the {len(labels)} groups, got {num_folds}.")
    ends = [round(i * len(labels) / num_folds) for i in range(num_folds + 1)]
    folds = []
    for first, last in zip(ends[:-1], ends[1:], strict=True):
        out = set(labels[first:last])
        places = tuple(i for i, group in enumerate(demonstrations.groups) if group in out)
        folds.append(Fold(*demonstrations.split(labels[first:last]), places))
    return folds


def beginning(motions: Trajectory, percent: float) -> tuple[Trajectory, Float[Tensor, "*batch"]]:
    """The beginnings of complete motions, and when each was cut (seconds on the motions' clock).

    Args:
        motions: (*batch, T, D), padded with unseen samples.
        percent: of each motion's own duration that is seen; more than 0, less than 100.

    Returns:
        (beginnings with later samples masked, as many samples as the longest of them has; (*batch,) time of the cut).

    Raises:
        InputError: another percentage.

    Example:
        >>> reach = Trajectory(time=[0.0, 1.0, 2.0, 3.0, 4.0], values=[[0.0]] * 5)
        >>> seen, cut = beginning(reach, 50)
        >>> seen.num_samples, float(cut)
        (3, 2.0)
    """
    if not 0 < percent < 100:
        raise InputError(f"Expected a percentage above 0 and below 100, got {percent}.")
    cut = motions.time[..., 0] + 0.01 * percent * motions.duration
    inside = motions.time <= cut[..., None]
    longest = int(inside.reshape(-1, motions.num_samples).any(0).sum())
    return dataclasses.replace(motions, mask=motions.mask & inside[..., None]).first(longest), cut

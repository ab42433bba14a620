"""Passing over a rectangle with a mouse cursor: rectangles, demonstrations, and what counts as success."""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
import torch

from eaip_prob.checks import check_positive
from eaip_prob.data.demonstrations import Demonstration, DemonstrationSet
from eaip_prob.data.environment import EnvironmentFeatures
from eaip_prob.data.trajectory import Trajectory
from eaip_prob.errors import InputError
from eaip_prob.tasks.passing_over.person import PAPER_SIZES, CursorPerson, Intention
from eaip_prob.tasks.passing_over.success import passed

FEATURES = ("width", "height")
PARTS = ("train", "test", "novel")
_ATTEMPTS = 50


@dataclass(frozen=True)
class PassingOver:
    """The simulated task of Sec. 4.1, with a model of a person in place of the paper's recordings.

    Pixels, x to the right and y up; a rectangle stands on y = 0 centred at x = 0. A motion starts on the left,
    passes over the rectangle and ends on the right.

    Args:
        sizes: (width, height) of the rectangles that are demonstrated, px; default the paper's nine.
        novel_sizes: (width, height) of rectangles that nobody demonstrates, px; default the four of 50 and 400 px.
        bound: how far a path may rise above the top and still count as neat, px.
        rate: samples per second.
        person: who moves.

    Raises:
        InputError: sizes that are not pairs above zero, or a rectangle that reaches to where motions start or end.

    Example:
        >>> task = PassingOver(sizes=[(215, 125)], novel_sizes=[(400, 50)], bound=200.0)
        >>> demonstrations = task.demonstrations(10, seed=0)
        >>> demonstrations, demonstrations.groups[0]
        (DemonstrationSet(10 of ('human',), 1 groups), '215x125')
    """

    sizes: Sequence[tuple[float, float]] = PAPER_SIZES
    novel_sizes: Sequence[tuple[float, float]] = tuple(itertools.product((50.0, 400.0), (50.0, 400.0)))
    bound: float = 160.0
    rate: float = 100.0
    person: CursorPerson = field(default_factory=CursorPerson)

    def __post_init__(self) -> None:
        check_positive("bound", self.bound)
        check_positive("rate", self.rate)
        for name in ("sizes", "novel_sizes"):
            object.__setattr__(self, name, _pairs(name, getattr(self, name)))
        for width, height in (*self.sizes, *self.novel_sizes):
            self.person.check_fits(width, height)

    def demonstrations(self, num_per_rectangle: int, seed: int, part: str = "train") -> DemonstrationSet:
        """Motions over every rectangle of one part, each rectangle a group; all of them succeed.

        Every part and every rectangle draws from its own stream of the seed, so that train, test and novel never
        share a motion and more motions of one rectangle do not change those of another.

        Args:
            num_per_rectangle: at least one.
            seed: not negative.
            part: `train` and `test` use `sizes`, `novel` uses `novel_sizes`.

        Raises:
            InputError: no motion asked for, a negative seed, or another part.
        """
        if part not in PARTS:
            raise InputError(f"Expected part to be one of {PARTS}, got {part!r}.")
        if seed < 0:
            raise InputError(f"Expected a seed of at least zero, got {seed}.")
        made: list[Demonstration] = []
        groups: list[str] = []
        for number, (width, height) in enumerate(self.novel_sizes if part == "novel" else self.sizes):
            motions = self.motions(width, height, num_per_rectangle, _stream(seed, PARTS.index(part), number))
            features = EnvironmentFeatures(FEATURES, torch.tensor([width, height], dtype=torch.float64))
            made += [Demonstration(human=_alone(motions, i), environment=features) for i in range(num_per_rectangle)]
            groups += [f"{width:g}x{height:g}"] * num_per_rectangle
        return DemonstrationSet(made, groups)

    def motions(self, width: float, height: float, num: int, generator: torch.Generator) -> Trajectory:
        """`num` successful motions over one rectangle as a batch (num, T, 2), padded with unseen samples.

        A motion that fails is planned again with the same start, end and tempo, so that these stay independent of
        the rectangle.

        Args:
            width: px.
            height: px.
            num: at least one.
            generator: source of randomness; a fixed seed gives identical motions.

        Raises:
            InputError: a size that does not fit, no motion asked for, or a motion that fails at every attempt.

        Example:
            >>> task = PassingOver(sizes=[(215, 125)], novel_sizes=[], bound=200.0)
            >>> task.motions(215.0, 125.0, 500, torch.Generator().manual_seed(0)).batch_shape
            torch.Size([500])
        """
        self.person.check_fits(width, height)
        if num < 1:
            raise InputError(f"Expected at least one motion for a rectangle, got {num}.")
        intention = self.person.intend(num, self.rate, generator)
        motions = self.person.move(intention, width, height, self.rate, generator)
        values = motions.values.clone()
        failed = self._failed(motions, width, height)
        for _ in range(_ATTEMPTS):
            if not len(failed):
                return Trajectory(motions.time, values, motions.names, motions.mask)
            again, retry = self._again(intention, failed, width, height, generator)
            values[failed, : again.num_samples] = again.values
            failed = failed[retry]
        raise InputError(
            f"Expected motions over a rectangle of {width:g} x {height:g} px to succeed within {_ATTEMPTS} attempts, "
            f"got {len(failed)} of {num} that never did. Raise bound or the person's clearance."
        )

    def _again(
        self, intention: Intention, failed: torch.Tensor, width: float, height: float, generator: torch.Generator
    ) -> tuple[Trajectory, torch.Tensor]:
        motions = self.person.move(intention[failed], width, height, self.rate, generator)
        return motions, self._failed(motions, width, height)

    def _failed(self, motions: Trajectory, width: float, height: float) -> torch.Tensor:
        return (~passed(motions.values, width, height, self.bound, motions.seen)).nonzero()[:, 0]


def _pairs(name: str, sizes: Sequence[Sequence[float]]) -> tuple[tuple[float, float], ...]:
    pairs = tuple(tuple(float(length) for length in size) for size in sizes)
    if any(len(pair) != 2 for pair in pairs) or len(set(pairs)) != len(pairs):
        raise InputError(f"Expected {name} as different pairs (width, height) in px, got {pairs}.")
    return tuple((pair[0], pair[1]) for pair in pairs)


def _stream(seed: int, part: int, rectangle: int) -> torch.Generator:
    sequence = np.random.SeedSequence(seed, spawn_key=(part, rectangle))
    return torch.Generator().manual_seed(int(sequence.generate_state(1, np.uint64)[0] >> 1))


def _alone(motions: Trajectory, number: int) -> Trajectory:
    motion = motions[number]
    return motion.first(int(motion.seen.sum()))

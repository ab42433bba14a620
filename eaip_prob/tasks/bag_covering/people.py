"""Who covers objects beside the robot: how tall, how fast, how carefully, and how each of them likes to move.

Training partners are of middle stature and tempo, test partners shorter, taller, slower or faster than any of them, so
that a result is one for people whom the robot has not met.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from eaip_prob.errors import InputError

TRAINING, TEST = "training", "test"
_STATURE = {TRAINING: ((1.62, 1.80),), TEST: ((1.52, 1.60), (1.82, 1.92))}  # m
_TEMPO = {TRAINING: ((0.90, 1.12),), TEST: ((0.80, 0.88), (1.14, 1.24))}  # durations, as a share of the usual


@dataclass(frozen=True)
class Partner:
    """A person's body and habits, the same in all trials of this person.

    Args:
        name: of the person's record, such as "training 3".
        stature: m.
        tempo: duration of the person's motions over the usual one.
        clearance: by which the person carries the bag over an object, m.
        gap: between the object's side and where the person sets the bag down, m.
        lift: by which the person lifts the bag higher (or, negative, less high) than others at first, m.
        arch: by which the way over the object is rounder than the shortest one, m.
        tremor: standard deviation of the hands' trembling, m.

    Raises:
        InputError: a stature or tempo not above zero.

    Example:
        >>> partner = Partner.drawn("test", 0, np.random.default_rng(0))
        >>> partner.name, 1.5 < partner.stature < 2.0
        ('test 0', True)
    """

    name: str = "usual"
    stature: float = 1.72
    tempo: float = 1.0
    clearance: float = 0.16
    gap: float = 0.20
    lift: float = 0.0
    arch: float = 0.03
    tremor: float = 0.0015

    def __post_init__(self) -> None:
        if not (self.stature > 0 and self.tempo > 0):
            raise InputError(f"Expected stature and tempo above zero, got {self.stature} and {self.tempo}.")

    @classmethod
    def drawn(cls, population: str, number: int, generator: np.random.Generator) -> Partner:
        """A person of a population.

        Args:
            population: "training" or "test".
            number: of the person in it; test partners alternate between short and tall, slow and fast.
            generator: of the person.

        Raises:
            InputError: another population.
        """
        if population not in _STATURE:
            raise InputError(f"Expected a population of {tuple(_STATURE)}, got {population!r}.")
        statures, tempos = _STATURE[population], _TEMPO[population]
        return cls(
            name=f"{population} {number}",
            stature=float(generator.uniform(*statures[number % len(statures)])),
            tempo=float(generator.uniform(*tempos[number // len(statures) % len(tempos)])),
            clearance=float(generator.normal(0.16, 0.015)),
            gap=float(generator.normal(0.20, 0.015)),
            lift=float(generator.normal(0.0, 0.03)),
            arch=float(generator.uniform(0.0, 0.06)),
            tremor=float(generator.uniform(0.001, 0.002)),
        )

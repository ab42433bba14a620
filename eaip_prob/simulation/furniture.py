"""Things to cover: furniture of given dimensions, standing on the floor at the origin with its front towards +x.

Lengths are in metres, colours RGB from 0 to 1. The thin parts (rungs, legs, boards) are modelled, since they are
what depth cameras lose. Dimensions of the objects used in studies are fixed in `conf/object/`.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass, fields

import numpy as np

from eaip_prob.errors import InputError
from eaip_prob.simulation.meshes import Color, Mesh, box, joined, tube


class AbstractObject(ABC):
    """Something that stands on the floor: a subclass makes its mesh, and scenes, labels and covers follow from it."""

    @abstractmethod
    def mesh(self) -> Mesh:
        """The object at the origin, lowest at z = 0, front towards +x, m."""


def check_lengths(owner: object) -> None:
    """Refuses numbers of an object that are not above zero.

    Args:
        owner: a dataclass.

    Raises:
        InputError: names the first such argument.
    """
    for field in fields(owner):  # pyright: ignore[reportArgumentType]
        value = getattr(owner, field.name)
        if isinstance(value, int | float) and not value > 0:
            raise InputError(f"Expected {field.name} of {type(owner).__name__} above zero, got {value}.")


@dataclass(frozen=True)
class Stepladder(AbstractObject):
    """Two frames that lean on each other: flat steps in the front frame, rungs in the back one.

    Args:
        width: outside, at the floor, m.
        depth: between the feet of both frames, m.
        height: of the top, m.
        num_steps: in the front frame, the top not counted.
        rail: diameter of the rails, m.
        color: of the rails.
        step_color: of the steps.

    Raises:
        InputError: a dimension not above zero.

    Example:
        >>> ladder = Stepladder(0.5, 0.7, 1.1, 3, 0.03, (0.8, 0.8, 0.8), (0.2, 0.2, 0.2))
        >>> float(ladder.mesh().extent()[1, 2].round(3))
        1.1
    """

    width: float
    depth: float
    height: float
    num_steps: int
    rail: float
    color: Color
    step_color: Color

    def __post_init__(self) -> None:
        check_lengths(self)

    def mesh(self) -> Mesh:
        """The ladder, opened."""
        top, tread = 0.72 * self.width, 0.08
        parts = [box((0.22, top, 0.03), self.step_color).at(z=self.height - 0.015)]
        for side in (-1.0, 1.0):
            for front in (-1.0, 1.0):
                foot = (front * self.depth / 2, side * (self.width - self.rail) / 2, self.rail / 4)
                parts.append(tube(foot, (front * 0.07, side * top / 2, self.height - 0.02), self.rail / 2, self.color))
        for level in (np.arange(self.num_steps) + 1.0) / (self.num_steps + 1.0):
            x = level * 0.07 + (1 - level) * self.depth / 2
            half = (level * top + (1 - level) * self.width) / 2
            parts.append(box((tread, 2 * half, 0.025), self.step_color).at(x, 0.0, level * self.height))
            parts.append(tube((-x, -half, level * self.height), (-x, half, level * self.height), 0.01, self.color))
        return joined(parts)


@dataclass(frozen=True)
class FoldingTable(AbstractObject):
    """A thin top on two pairs of crossed tubes.

    Args:
        width: of the top, m.
        depth: of the top, m.
        height: m.
        thickness: of the top, m.
        leg: diameter of the tubes, m.
        color: of the top.
        leg_color: of the tubes.

    Raises:
        InputError: a dimension not above zero.

    Example:
        >>> table = FoldingTable(0.9, 0.5, 0.7, 0.03, 0.025, (0.9, 0.9, 0.9), (0.3, 0.3, 0.3))
        >>> table.mesh().extent()[1].round(3).tolist()
        [0.25, 0.45, 0.7]
    """

    width: float
    depth: float
    height: float
    thickness: float
    leg: float
    color: Color
    leg_color: Color

    def __post_init__(self) -> None:
        check_lengths(self)

    def mesh(self) -> Mesh:
        """The table, unfolded."""
        under, x = self.height - self.thickness, self.depth / 2 - 0.05
        parts = [box((self.depth, self.width, self.thickness), self.color).at(z=self.height - self.thickness / 2)]
        for side in (-1.0, 1.0):
            y, inner = side * (self.width / 2 - 0.08), side * (self.width / 2 - 0.08 - self.leg)
            parts.append(tube((-x, y, self.leg / 2), (x, y, under), self.leg / 2, self.leg_color))
            parts.append(tube((x, inner, self.leg / 2), (-x, inner, under), self.leg / 2, self.leg_color))
        for front in (-1.0, 1.0):
            ends = [(front * x, side * (self.width / 2 - 0.08), self.leg / 2) for side in (-1.0, 1.0)]
            parts.append(tube(ends[0], ends[1], self.leg / 2, self.leg_color, rounded=True))
        return joined(parts)


@dataclass(frozen=True)
class OfficeChair(AbstractObject):
    """A swivel chair: five feet on castors, a column, a seat, a back and two arm rests.

    Args:
        width: of the seat, m.
        depth: of the seat, m.
        seat_height: top of the seat, m.
        height: top of the back, m.
        foot_radius: from the column to the castors, m.
        color: of seat and back.
        frame_color: of the rest.

    Raises:
        InputError: a dimension not above zero.

    Example:
        >>> chair = OfficeChair(0.5, 0.48, 0.47, 0.95, 0.3, (0.2, 0.25, 0.5), (0.1, 0.1, 0.1))
        >>> float(chair.mesh().extent()[1, 2].round(3))
        0.95
    """

    width: float
    depth: float
    seat_height: float
    height: float
    foot_radius: float
    color: Color
    frame_color: Color

    def __post_init__(self) -> None:
        check_lengths(self)

    def mesh(self) -> Mesh:
        """The chair, at its working height."""
        cushion, dark = 0.08, self.frame_color
        back_height = 0.72 * (self.height - self.seat_height)
        parts = [
            box((self.depth, self.width, cushion), self.color).at(z=self.seat_height - cushion / 2),
            box((0.06, 0.9 * self.width, back_height), self.color).at(
                -self.depth / 2 + 0.01, 0.0, self.height - back_height / 2
            ),
            tube((0.0, 0.0, 0.1), (0.0, 0.0, self.seat_height - cushion), 0.03, dark),
            tube(
                (-0.1, 0, self.seat_height - 0.1),
                (-self.depth / 2 - 0.03, 0, self.seat_height - 0.04),
                0.025,
                dark,
                True,
            ),
            tube(
                (-self.depth / 2 - 0.03, 0, self.seat_height - 0.04),
                (-self.depth / 2 - 0.03, 0, self.height - 0.1),
                0.02,
                dark,
                True,
            ),
        ]
        for angle in 2.0 * np.pi * np.arange(5) / 5.0:
            x, y = self.foot_radius * np.cos(angle), self.foot_radius * np.sin(angle)
            parts.append(tube((0.0, 0.0, 0.12), (x, y, 0.075), 0.02, dark, rounded=True))
            parts.append(tube((x, y - 0.02, 0.03), (x, y + 0.02, 0.03), 0.03, dark))
        for side in (-1.0, 1.0):
            y, top = side * (self.width / 2 + 0.03), self.seat_height + 0.2
            parts.append(tube((0.0, side * self.width / 2, self.seat_height - 0.05), (0.0, y, top), 0.014, dark, True))
            parts.append(box((0.26, 0.06, 0.03), dark).at(0.0, y, top + 0.01))
        return joined(parts)


@dataclass(frozen=True)
class Bookshelf(AbstractObject):
    """Two sides, a back and boards, open to the front.

    Args:
        width: m.
        depth: m.
        height: m.
        num_boards: shelves between floor and top.
        board: thickness of all boards, m.
        color: of the boards.
        back_color: of the back.

    Raises:
        InputError: a dimension not above zero.

    Example:
        >>> shelf = Bookshelf(0.4, 0.3, 0.9, 2, 0.018, (0.4, 0.25, 0.15), (0.3, 0.2, 0.1))
        >>> shelf.mesh().extent()[1].round(3).tolist()
        [0.15, 0.2, 0.9]
    """

    width: float
    depth: float
    height: float
    num_boards: int
    board: float
    color: Color
    back_color: Color

    def __post_init__(self) -> None:
        check_lengths(self)

    def mesh(self) -> Mesh:
        """The shelf, empty."""
        inside = self.width - 2 * self.board
        back = box((0.006, inside, self.height), self.back_color).at(-self.depth / 2 + 0.003, 0.0, self.height / 2)
        sides = [
            box((self.depth, self.board, self.height), self.color).at(
                0.0, side * (self.width - self.board) / 2, self.height / 2
            )
            for side in (-1.0, 1.0)
        ]
        levels = np.linspace(0.05, self.height - self.board / 2, self.num_boards + 2)
        boards = [box((self.depth, inside, self.board), self.color).at(z=float(level)) for level in levels]
        return joined([back, *sides, *boards])

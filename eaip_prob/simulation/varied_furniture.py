"""Instances of four classes of furniture that differ in size, proportions and parts, for training detectors.

Each class varies one piece of furniture of the demonstrations, and borrows from the others what does not make it one
of its class, so that a class does not hang on one kind of foot: a chair is a seat with a back above it, a table a board
with nothing above it, and either stands on the star foot of the office chair, the crossed legs of the folding table or
poles like those of the stepladder; backs may be rungs, and tables have a shelf's board between their legs. One rule
holds for all lengths: a factor for the whole, a factor for each axis, and a range for each part; `Draw` takes them from
inside their ranges, or from the bands around them for instances unlike those that were trained on.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace

import numpy as np

from eaip_prob.errors import InputError
from eaip_prob.simulation.furniture import AbstractObject
from eaip_prob.simulation.meshes import Color, Mesh, box, cylinder, joined, tube
from eaip_prob.simulation.varied_draw import Draw
from eaip_prob.simulation.varied_supports import crossed_legs, poles, rungs, star_foot

_NEAR = (0.92, 1.09)  # the same of one that is repainted
_CHAIR_LEGS, _CHAIR_SHARES = ("star", "crossed", "poles"), (0.5, 0.15, 0.35)
_RUNGS = 0.35  # share of chairs whose back is of rungs between two poles


@dataclass(frozen=True, eq=False)
class VariedObject(AbstractObject):
    """A piece of furniture that was drawn, kept as its mesh.

    Args:
        label: its class.
        shape: at the origin, lowest at z = 0, front towards +x.

    Example:
        >>> VariedObject("table", box((1.0, 1.0, 1.0), (1, 1, 1)).at(z=0.5)).mesh().extent()[:, 2].tolist()
        [0.0, 1.0]
    """

    label: str
    shape: Mesh

    def mesh(self) -> Mesh:
        """The mesh as it was drawn."""
        return self.shape


def varied(label: str, draw: Draw) -> VariedObject:
    """An instance of a class.

    Args:
        label: chair, stepladder, table or bookshelf.
        draw: its lengths, parts and colours.

    Raises:
        InputError: another class.

    Example:
        >>> piece = varied("stepladder", Draw(np.random.default_rng(3)))
        >>> bool(0.6 < piece.mesh().extent()[1, 2] < 2.0)
        True
    """
    if label not in _MAKERS:
        raise InputError(f"Expected a class among {sorted(_MAKERS)}, got {label!r}.")
    return VariedObject(label, _MAKERS[label](draw))


def repainted(thing: AbstractObject, label: str, draw: Draw) -> VariedObject:
    """A piece of furniture in other colours, one for each of its own, and a little longer or shorter along each axis.

    Args:
        thing: the piece.
        label: its class.
        draw: colours and lengths.

    Example:
        >>> piece = VariedObject("table", box((1.0, 1.0, 1.0), (1, 1, 1)).at(z=0.5))
        >>> other = repainted(piece, "table", Draw(np.random.default_rng(0))).mesh()
        >>> bool(0.9 < other.extent()[1, 2] < 1.1), len(np.unique(other.color, axis=0))
        (True, 1)
    """
    mesh, first = thing.mesh(), draw.color()
    color = np.array(mesh.color)
    for number, own in enumerate(np.unique(mesh.color, axis=0)):
        color[(mesh.color == own).all(-1)] = draw.color(like=first) if number else first
    factors = np.array([draw.length(*_NEAR) for _ in range(3)])
    return VariedObject(label, replace(mesh, vertices=mesh.vertices * factors, color=color))


def _chair(draw: Draw) -> Mesh:
    width, depth, seat_height, back = draw.axes(0.48, 0.46, 0.46, 0.46)
    color = draw.color()
    dark = draw.color(like=color)
    thickness = draw.length(0.035, 0.1)
    under = seat_height - thickness
    if draw.chance(0.25):
        seat = cylinder(width / 2, thickness, color, 20).at(z=under)
    else:
        seat = box((depth, width, thickness), color).at(z=seat_height - thickness / 2)
    legs = draw.generator.choice(_CHAIR_LEGS, p=_CHAIR_SHARES)
    if legs == "star":
        standing = star_foot(draw, under, dark)
    else:
        standing = (crossed_legs if legs == "crossed" else poles)(draw, (depth, width), under, dark)
    rise = rungs if draw.chance(_RUNGS) else _back
    parts = [seat, *standing, *rise(draw, width, depth, seat_height, back, color, dark)]
    if draw.chance(0.45):
        parts += _arm_rests(draw, width, seat_height, dark)
    return joined(parts)


def _back(draw: Draw, width: float, depth: float, seat: float, rise: float, color: Color, dark: Color) -> list[Mesh]:
    thick, across = draw.length(0.025, 0.07), width * draw.length(0.7, 1.1)
    tall, lean = rise * draw.length(0.45, 0.95), draw.length(0.02, 0.2)
    x = -depth / 2
    panels = [box((thick, across, tall), color).at(z=rise - tall / 2)]
    if draw.chance(0.2):  # with a head rest
        panels = [
            box((thick, across, 0.6 * tall), color).at(z=rise - 0.7 * tall),
            box((thick, 0.6 * across, 0.25 * tall), color).at(z=rise - 0.125 * tall),
        ]
    spine = tube((-thick / 2, 0.0, -0.06), (-thick / 2, 0.0, rise - 0.15 * tall), draw.length(0.012, 0.03), dark, True)
    T = np.eye(4)
    T[:3, :3] = [[np.cos(lean), 0.0, -np.sin(lean)], [0.0, 1.0, 0.0], [np.sin(lean), 0.0, np.cos(lean)]]
    T[:3, 3] = (x, 0.0, seat)
    support = tube((0.0, 0.0, seat - 0.05), (x, 0.0, seat - 0.05), 0.02, dark, True)
    return [support, *(part.moved(T) for part in [*panels, spine])]


def _arm_rests(draw: Draw, width: float, seat: float, color: Color) -> list[Mesh]:
    rise, length, parts = draw.length(0.14, 0.26), draw.length(0.18, 0.34), []
    for side in (-1.0, 1.0):
        y = side * (width / 2 + 0.03)
        parts.append(tube((0.0, side * width / 2, seat - 0.05), (0.0, y, seat + rise), 0.014, color, True))
        parts.append(box((length, draw.length(0.04, 0.08), 0.03), color).at(0.0, y, seat + rise))
    return parts


def _table(draw: Draw) -> Mesh:
    width, depth, height = draw.axes(0.80, 0.50, 0.70)
    color = draw.color()
    other, thickness = draw.color(like=color), draw.length(0.015, 0.05)
    under = height - thickness
    parts = [box((depth, width, thickness), color).at(z=height - thickness / 2)]
    kind = draw.generator.random()
    if kind < 0.15:
        return joined([*parts, *star_foot(draw, under, other)])
    if draw.chance(0.3):  # a board between the legs, as in a shelf
        board = box((0.85 * depth, 0.85 * width, draw.length(0.012, 0.03)), draw.color(like=color))
        parts.append(board.at(z=under * draw.generator.uniform(0.2, 0.5)))
    legs = crossed_legs if kind < 0.6 else poles
    return joined([*parts, *legs(draw, (depth, width), under, other)])


def _stepladder(draw: Draw) -> Mesh:
    width, depth, height = draw.axes(0.46, 0.72, 1.02)
    color = draw.color()
    tread_color, rail = draw.color(like=color), draw.length(0.02, 0.05)
    top, tread, platform = width * draw.length(0.6, 0.95), draw.length(0.06, 0.13), draw.length(0.14, 0.3)
    apex, steps, rungs = platform * 0.35, draw.count(2, 4), draw.chance(0.7)
    parts = [box((platform, top, 0.03), tread_color).at(z=height - 0.015)]
    for side in (-1.0, 1.0):
        for front in (-1.0, 1.0):
            foot = (front * depth / 2, side * (width - rail) / 2, rail / 4)
            parts.append(tube(foot, (front * apex, side * top / 2, height - 0.02), rail / 2, color))
    for number, level in enumerate((np.arange(steps) + 1.0) / (steps + 1.0)):
        x, half = level * apex + (1 - level) * depth / 2, (level * top + (1 - level) * width) / 2
        parts.append(box((tread, 2 * half, draw.length(0.02, 0.04)), tread_color).at(x, 0.0, level * height))
        if rungs or number == 0:
            parts.append(tube((-x, -half, level * height), (-x, half, level * height), rail / 3, color))
    return joined(parts)


def _bookshelf(draw: Draw) -> Mesh:
    width, depth, height = draw.axes(0.60, 0.29, 0.90)
    board, color = draw.length(0.014, 0.03), draw.color()
    inside, lowest = width - 2 * board, draw.length(0.02, 0.09)
    parts = [box((depth, board, height), color).at(0.0, side * (width - board) / 2, height / 2) for side in (-1.0, 1.0)]
    if draw.chance(0.75):
        back = box((0.006, inside, height), draw.color(like=color))
        parts.append(back.at(-depth / 2 + 0.003, 0.0, height / 2))
    levels = np.linspace(lowest, height - board / 2, draw.count(1, 4) + 2)
    parts += [box((depth, inside, board), color).at(z=float(level)) for level in levels]
    if draw.chance(0.3):
        for level, above in zip(levels[:-1], levels[1:], strict=True):
            parts += _books(draw, inside, depth, float(level) + board / 2, float(above - level) - board)
    return joined(parts)


def _books(draw: Draw, inside: float, depth: float, floor: float, room: float) -> list[Mesh]:
    parts, y = [], -inside / 2 + 0.01
    while draw.chance(0.85) and y < inside / 2 - 0.08:
        thick, tall = draw.generator.uniform(0.02, 0.06), room * draw.generator.uniform(0.5, 0.9)
        parts.append(box((0.6 * depth, thick, tall), draw.color()).at(-0.1 * depth, y + thick / 2, floor + tall / 2))
        y += thick + 0.003
    return parts


_MAKERS: Mapping[str, Callable[[Draw], Mesh]] = {
    "chair": _chair,
    "stepladder": _stepladder,
    "table": _table,
    "bookshelf": _bookshelf,
}

"""Stepladders and bookshelves that are drawn: boards between splayed rails, or between closed sides."""

from __future__ import annotations

import numpy as np

from eaip_prob.simulation.meshes import Color, Mesh, box, joined, tube
from eaip_prob.simulation.varied_draw import Draw

_REARS, _TOPS = ("bare", "rungs", "treads"), ("platform", "tread", "hoop", "bar", "deep")
_SHELF_BACKS, _SHELF_INSIDES = ("closed", "open"), ("boards", "books", "divider", "plinth", "uneven")


def stepladder(draw: Draw) -> Mesh:
    """Two pairs of rails that meet above, with treads on one of them or both.

    Args:
        draw: its lengths, parts and colours.

    Example:
        >>> bool(0.4 < stepladder(Draw(np.random.default_rng(0))).extent()[1, 2] < 2.0)
        True
    """
    width, height, rail = draw.length(0.3, 0.62), draw.length(0.5, 1.45), draw.length(0.018, 0.055)
    depth, top, color = height * draw.length(0.45, 0.85), width * draw.length(0.55, 1.0), draw.color()
    tread_color, rear = draw.color(like=color), draw.choice(_REARS)
    kind = draw.matching(_REARS.index(rear), _TOPS)
    platform = {"bar": 0.03, "tread": 0.09, "deep": draw.length(0.25, 0.4)}.get(kind, draw.length(0.12, 0.25))
    apex, parts = platform * 0.35, [box((platform, top, draw.length(0.02, 0.05)), tread_color).at(z=height - 0.015)]
    for side in (-1.0, 1.0):
        for front in (-1.0, 1.0):
            foot = (front * depth / 2, side * (width - rail) / 2, rail / 4)
            parts.append(tube(foot, (front * apex, side * top / 2, height - 0.02), rail / 2, color))
    tread, thick, steps = draw.length(0.05, 0.15), draw.length(0.015, 0.045), draw.count(2, 6)
    for level in (np.arange(steps) + 1.0) / (steps + 1.0):
        x, half = level * apex + (1 - level) * depth / 2, (level * top + (1 - level) * width) / 2
        parts.append(box((tread, 2 * half, thick), tread_color).at(x, 0.0, level * height))
        if rear == "treads":
            parts.append(box((tread, 2 * half, thick), tread_color).at(-x, 0.0, level * height))
        elif rear == "rungs":
            parts.append(tube((-x, -half, level * height), (-x, half, level * height), rail / 3, color))
    return joined([*parts, *(_hoop(draw, top, apex, height, rail, color) if kind == "hoop" else [])])


def _hoop(draw: Draw, top: float, x: float, height: float, rail: float, color: Color) -> list[Mesh]:
    """A handle above the platform, over its rear edge."""
    high = height + draw.length(0.15, 0.5)
    posts = [tube((-x, s * top / 2, height), (-x, s * top / 2, high), rail / 2, color) for s in (-1.0, 1.0)]
    return [*posts, tube((-x, -top / 2, high), (-x, top / 2, high), rail / 2, color, True)]


def bookshelf(draw: Draw) -> Mesh:
    """Two closed sides with boards between them.

    Args:
        draw: its lengths, parts and colours.

    Example:
        >>> bool(0.4 < bookshelf(Draw(np.random.default_rng(0))).extent()[1, 2] < 1.5)
        True
    """
    width, depth, height = draw.length(0.26, 1.1), draw.length(0.18, 0.45), draw.length(0.42, 1.4)
    board, color, behind = draw.length(0.012, 0.035), draw.color(), draw.choice(_SHELF_BACKS)
    kind, inside = draw.matching(_SHELF_BACKS.index(behind), _SHELF_INSIDES), width - 2 * board
    parts = [box((depth, board, height), color).at(0.0, side * (width - board) / 2, height / 2) for side in (-1.0, 1.0)]
    if behind == "closed":
        parts.append(box((0.006, inside, height), draw.color(like=color)).at(0.003 - depth / 2, 0.0, height / 2))
    lowest = draw.length(0.015, 0.09)
    levels = np.linspace(lowest, height - board / 2, draw.count(1, 5) + 2)
    if kind == "uneven":
        levels[1:-1] += np.diff(levels)[0] * draw.generator.uniform(-0.35, 0.35, len(levels) - 2)
    parts += [box((depth, inside, board), color).at(z=float(level)) for level in levels]
    if kind == "plinth":
        parts.append(box((0.9 * depth, inside, lowest), color).at(z=lowest / 2))
    elif kind == "divider":
        y = inside * draw.generator.uniform(-0.2, 0.2)
        parts.append(box((depth, board, height - lowest), color).at(0.0, y, (height + lowest) / 2))
    elif kind == "books":
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

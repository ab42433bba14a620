"""Backs of chairs, of several kinds: what makes a plate on any support a chair.

Each is made upright above the middle of the seat, and then leans and moves to the seat's rear edge. Lengths in metres.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping

import numpy as np

from eaip_prob.simulation.meshes import Color, Mesh, box, tube
from eaip_prob.simulation.varied_draw import Draw

_BELOW = 0.03  # m, of the posts below the top of the seat


def back(kind: str, draw: Draw, seat: tuple[float, float, float], color: Color, dark: Color) -> list[Mesh]:
    """A back that rises above a seat.

    Args:
        kind: of `BACKS`.
        draw: its lengths.
        seat: its lengths along x and y, and the height of its top.
        color: of what fills the back.
        dark: of its posts.

    Example:
        >>> parts = back("rungs", Draw(np.random.default_rng(0)), (0.45, 0.45, 0.45), (1, 1, 1), (0, 0, 0))
        >>> bool(max(float(part.extent()[1, 2]) for part in parts) > 0.6)
        True
    """
    depth, width, height = seat
    rise, lean = draw.length(0.22, 0.62), draw.generator.uniform(0.0, 0.35)
    T = np.eye(4)
    T[:3, :3] = [[np.cos(lean), 0.0, -np.sin(lean)], [0.0, 1.0, 0.0], [np.sin(lean), 0.0, np.cos(lean)]]
    T[:3, 3] = (0.015 - depth / 2, 0.0, height)
    return [part.moved(T) for part in _MAKERS[kind](draw, width * draw.length(0.7, 1.08), rise, color, dark)]


def _posts(draw: Draw, wide: float, rise: float, dark: Color) -> tuple[list[Mesh], float, float]:
    """(two posts, half their distance, their radius)."""
    thick = draw.length(0.008, 0.025)
    half = wide / 2 - thick
    posts = [tube((0.0, side * half, -_BELOW), (0.0, side * half, rise), thick, dark) for side in (-1.0, 1.0)]
    return posts, half, thick


def _panel(draw: Draw, wide: float, rise: float, color: Color, dark: Color) -> list[Mesh]:
    tall = rise * draw.length(0.4, 1.05)
    parts = [box((draw.length(0.015, 0.08), wide, tall), color).at(z=rise - tall / 2)]
    return parts if tall > rise else parts + _posts(draw, wide * draw.length(0.5, 0.95), rise, dark)[0]


def _spine(draw: Draw, wide: float, rise: float, color: Color, dark: Color) -> list[Mesh]:
    thick, tall = draw.length(0.025, 0.07), rise * draw.length(0.45, 0.95)
    panels = [box((thick, wide, tall), color).at(z=rise - tall / 2)]
    if draw.chance(0.25):  # with a head rest
        panels = [
            box((thick, wide, 0.6 * tall), color).at(z=rise - 0.7 * tall),
            box((thick, 0.6 * wide, 0.25 * tall), color).at(z=rise - 0.125 * tall),
        ]
    radius = draw.length(0.012, 0.03)
    return [*panels, tube((-thick / 2, 0.0, -2 * _BELOW), (-thick / 2, 0.0, rise - 0.15 * tall), radius, dark, True)]


def _rungs(draw: Draw, wide: float, rise: float, color: Color, dark: Color) -> list[Mesh]:
    posts, half, thick = _posts(draw, wide, rise, dark)
    high, flat = draw.length(0.015, 0.09), draw.chance(0.5)
    for level in np.linspace(draw.generator.uniform(0.15, 0.7) * rise, rise - high / 2, draw.count(1, 5)):
        if flat:
            posts.append(box((0.015, 2 * half, high), color).at(z=float(level)))
        else:
            posts.append(tube((0.0, -half, float(level)), (0.0, half, float(level)), thick * 0.8, color))
    return posts


def _slats(draw: Draw, wide: float, rise: float, color: Color, dark: Color) -> list[Mesh]:
    posts, half, _ = _posts(draw, wide, rise, dark)
    low, rail = draw.generator.uniform(0.0, 0.35) * rise, draw.length(0.02, 0.08)
    for level in (low, rise - rail / 2):
        posts.append(box((0.02, 2 * half, rail), color).at(z=level))
    slat = draw.length(0.008, 0.05)
    for y in np.linspace(-half, half, draw.count(1, 7) + 2)[1:-1]:
        posts.append(box((0.012, slat, rise - low), color).at(0.0, float(y), (low + rise) / 2))
    return posts


def _frame(draw: Draw, wide: float, rise: float, color: Color, dark: Color) -> list[Mesh]:
    """Posts with a rail at the top, and braces that cross between them or nothing."""
    posts, half, thick = _posts(draw, wide, rise, dark)
    posts.append(tube((0.0, -half, rise), (0.0, half, rise), thick, dark, True))
    if draw.chance(0.6):
        low = draw.generator.uniform(0.0, 0.4) * rise
        posts += [tube((0.0, -s * half, low), (0.0, s * half, rise), thick * 0.7, color) for s in (-1.0, 1.0)]
    return posts


_MAKERS: Mapping[str, Callable[[Draw, float, float, Color, Color], list[Mesh]]] = {
    "frame": _frame,
    "panel": _panel,
    "rungs": _rungs,
    "slats": _slats,
    "spine": _spine,
}
BACKS = tuple(_MAKERS)

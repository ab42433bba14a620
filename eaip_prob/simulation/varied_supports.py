"""What a plate stands on: the same supports for the seats of chairs and the plates of tables.

Everything stands on the floor at z = 0, front towards +x, lengths in metres.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping

import numpy as np

from eaip_prob.simulation.meshes import Color, Mesh, box, cylinder, tube
from eaip_prob.simulation.varied_draw import Draw


def support(kind: str, draw: Draw, top: tuple[float, float], height: float, color: Color) -> list[Mesh]:
    """What carries a plate.

    Args:
        kind: of `SUPPORTS`.
        draw: its lengths.
        top: lengths along x and y of what it carries.
        height: of its underside.
        color: of all.

    Example:
        >>> parts = support("star", Draw(np.random.default_rng(0)), (0.4, 0.5), 0.4, (0, 0, 0))
        >>> max(float(part.extent()[1, 2]) for part in parts)
        0.4
    """
    return _MAKERS[kind](draw, top, height, color)


def _star(draw: Draw, top: tuple[float, float], height: float, color: Color) -> list[Mesh]:
    """A column on arms with castors or without, as of a swivel chair."""
    parts = [tube((0.0, 0.0, 0.05), (0.0, 0.0, height), draw.length(0.018, 0.045), color)]
    number, radius, thick = draw.count(4, 6), draw.length(0.2, 0.36), draw.length(0.012, 0.03)
    castor = draw.length(0.018, 0.035) if draw.chance(0.75) else thick
    hub, turn = draw.length(0.06, 0.14), draw.generator.uniform(0.0, 2.0 * np.pi)
    for angle in turn + 2.0 * np.pi * np.arange(number) / number:
        x, y = radius * np.cos(angle), radius * np.sin(angle)
        parts.append(tube((0.0, 0.0, hub + thick), (x, y, 2 * castor), thick, color, rounded=True))
        parts.append(tube((x, y - castor, castor), (x, y + castor, castor), castor, color))
    return parts


def _crossed(draw: Draw, top: tuple[float, float], height: float, color: Color) -> list[Mesh]:
    """Two pairs of legs that cross, along one side or the other, as of a folding table."""
    leg, legs = draw.length(0.016, 0.045), []
    turned = draw.chance(0.4)  # the legs cross along y
    along, aside = (top[1], top[0]) if turned else top
    low, high = 0.47 * along * draw.length(0.6, 1.0), 0.47 * along * draw.length(0.5, 1.0)
    outer = 0.5 * aside * draw.length(0.6, 0.98) - leg / 2
    for side in (-1.0, 1.0):
        for front, y in ((1.0, side * outer), (-1.0, side * (outer - leg))):
            legs.append(tube((-front * low, y, leg / 2), (front * high, y, height), leg / 2, color))
    for x in (-low, low):
        if draw.chance(0.75):
            legs.append(tube((x, -outer, leg / 2), (x, outer, leg / 2), leg / 2, color, rounded=True))
    return [_quarter_turn(part) if turned else part for part in legs]


def _upright(draw: Draw, top: tuple[float, float], height: float, color: Color) -> list[Mesh]:
    return _poles(draw, top, height, color, 0.0)


def _splayed(draw: Draw, top: tuple[float, float], height: float, color: Color) -> list[Mesh]:
    return _poles(draw, top, height, color, draw.length(0.04, 0.25) * height)


def _poles(draw: Draw, top: tuple[float, float], height: float, color: Color, lean: float) -> list[Mesh]:
    """Four poles, round or square, whose feet stand further out by the lean, sometimes with rungs."""
    thick, inside, round_ = draw.length(0.018, 0.07), draw.length(0.7, 1.0), draw.chance(0.5)
    x, y = (0.5 * inside * side - thick / 2 for side in top)
    corners = [(sx, sy) for sx in (-1.0, 1.0) for sy in (-1.0, 1.0)]
    feet = [(sx * (x + lean), sy * (y + lean), thick / 4 if lean else 0.0) for sx, sy in corners]
    heads = [(sx * x, sy * y, height) for sx, sy in corners]
    if lean or round_:
        parts = [tube(foot, head, thick / 2, color) for foot, head in zip(feet, heads, strict=True)]
    else:
        parts = [box((thick, thick, height), color).at(u, v, height / 2) for u, v, _ in feet]
    for pairs in ([(0, 1), (2, 3)], [(0, 2), (1, 3)]):
        if draw.chance(0.25):
            share = draw.generator.uniform(0.12, 0.6)
            at = [(1 - share) * np.array(foot) + share * np.array(head) for foot, head in zip(feet, heads, strict=True)]
            parts += [tube(at[i], at[j], thick / 3, color) for i, j in pairs]
    return parts


def _panels(draw: Draw, top: tuple[float, float], height: float, color: Color) -> list[Mesh]:
    """Two upright boards, along one side or the other, as the sides of a shelf; sometimes joined by a third."""
    turned = draw.chance(0.4)
    along, aside = (top[1], top[0]) if turned else top
    thick, deep = draw.length(0.015, 0.04), along * draw.length(0.6, 1.0)
    outer = 0.5 * aside * draw.length(0.7, 1.0) - thick / 2
    parts = [box((deep, thick, height), color).at(0.0, side * outer, height / 2) for side in (-1.0, 1.0)]
    if draw.chance(0.5):
        tall = height * draw.length(0.15, 0.6)
        parts.append(box((thick, 2 * outer, tall), color).at(0.0, 0.0, height - tall / 2))
    return [_quarter_turn(part) if turned else part for part in parts]


def _pedestal(draw: Draw, top: tuple[float, float], height: float, color: Color) -> list[Mesh]:
    """One column on a disc or on two crossed feet."""
    reach, foot = 0.5 * min(top) * draw.length(0.6, 1.1), draw.length(0.015, 0.05)
    column = tube((0.0, 0.0, foot / 2), (0.0, 0.0, height), draw.length(0.02, 0.08), color)
    if draw.chance(0.5):
        return [column, cylinder(reach, foot, color, 20)]
    wide = draw.length(0.03, 0.08)
    return [column, *(box((a, b, foot), color).at(z=foot / 2) for a, b in ((2 * reach, wide), (wide, 2 * reach)))]


def _quarter_turn(mesh: Mesh) -> Mesh:
    T = np.eye(4)
    T[:2, :2] = [[0.0, -1.0], [1.0, 0.0]]
    return mesh.moved(T)


_MAKERS: Mapping[str, Callable[[Draw, tuple[float, float], float, Color], list[Mesh]]] = {
    "crossed": _crossed,
    "panels": _panels,
    "pedestal": _pedestal,
    "splayed": _splayed,
    "star": _star,
    "upright": _upright,
}
SUPPORTS = tuple(_MAKERS)

"""What furniture stands on, and backs of rungs: parts of the demonstrated pieces that any chair or table may have.

Everything stands on the floor at z = 0, front towards +x, lengths in metres.
"""

from __future__ import annotations

import numpy as np

from eaip_prob.simulation.meshes import Color, Mesh, tube
from eaip_prob.simulation.varied_draw import Draw


def star_foot(draw: Draw, height: float, color: Color) -> list[Mesh]:
    """A column on arms with castors or without, as of a swivel chair.

    Args:
        draw: number and lengths of the arms.
        height: of the column's top.
        color: of all.

    Example:
        >>> parts = star_foot(Draw(np.random.default_rng(0)), 0.4, (0, 0, 0))
        >>> max(float(part.extent()[1, 2]) for part in parts)
        0.4
    """
    parts = [tube((0.0, 0.0, 0.05), (0.0, 0.0, height), draw.length(0.018, 0.045), color)]
    number, radius, thick = draw.count(4, 6), draw.length(0.2, 0.36), draw.length(0.012, 0.03)
    castor = draw.length(0.018, 0.035) if draw.chance(0.75) else thick
    hub, turn = draw.length(0.06, 0.14), draw.generator.uniform(0.0, 2.0 * np.pi)
    for angle in turn + 2.0 * np.pi * np.arange(number) / number:
        x, y = radius * np.cos(angle), radius * np.sin(angle)
        parts.append(tube((0.0, 0.0, hub + thick), (x, y, 2 * castor), thick, color, rounded=True))
        parts.append(tube((x, y - castor, castor), (x, y + castor, castor), castor, color))
    return parts


def crossed_legs(draw: Draw, top: tuple[float, float], height: float, color: Color) -> list[Mesh]:
    """Two pairs of legs that cross, along one side or the other, as of a folding table.

    Args:
        draw: how far they reach, how thick they are, and along which side they cross.
        top: lengths along x and y of what they carry.
        height: of its underside.
        color: of all.

    Example:
        >>> len(crossed_legs(Draw(np.random.default_rng(0)), (0.5, 0.8), 0.7, (0, 0, 0))) >= 4
        True
    """
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


def poles(draw: Draw, top: tuple[float, float], height: float, color: Color) -> list[Mesh]:
    """Four poles that lean outwards a little or stand upright, sometimes with rungs, as of a stepladder.

    Args:
        draw: how much they lean, how thick they are, and their rungs.
        top: lengths along x and y of what they carry.
        height: of its underside.
        color: of all.

    Example:
        >>> len(poles(Draw(np.random.default_rng(0)), (0.5, 0.8), 0.7, (0, 0, 0))) >= 4
        True
    """
    thick, inside = draw.length(0.018, 0.055), draw.length(0.75, 0.98)
    lean = draw.generator.uniform(0.0, 0.12) * height if draw.chance(0.5) else 0.0
    x, y = (0.5 * inside * side - thick / 2 for side in top)
    corners = [(sx, sy) for sx in (-1.0, 1.0) for sy in (-1.0, 1.0)]
    feet = [(sx * (x + lean), sy * (y + lean), thick / 4) for sx, sy in corners]
    heads = [(sx * x, sy * y, height) for sx, sy in corners]
    parts = [tube(foot, head, thick / 2, color) for foot, head in zip(feet, heads, strict=True)]
    if draw.chance(0.35):
        level = draw.generator.uniform(0.15, 0.6)
        at = [
            tuple((1 - level) * np.array(foot) + level * np.array(head)) for foot, head in zip(feet, heads, strict=True)
        ]
        pairs = [(0, 1), (2, 3)] if draw.chance(0.5) else [(0, 2), (1, 3)]
        parts += [tube(at[i], at[j], thick / 3, color) for i, j in pairs]
    return parts


def rungs(draw: Draw, width: float, depth: float, seat: float, rise: float, color: Color, dark: Color) -> list[Mesh]:
    """The back of a chair: rungs across or upright between two poles, leaning back.

    Args:
        draw: how many there are, how thick they are, and how far they lean.
        width: of the seat.
        depth: of the seat.
        seat: its height.
        rise: of the back above the seat.
        color: of the rungs.
        dark: of the poles.

    Example:
        >>> parts = rungs(Draw(np.random.default_rng(0)), 0.45, 0.45, 0.45, 0.4, (1, 1, 1), (0, 0, 0))
        >>> round(max(float(part.extent()[1, 2]) for part in parts), 1)
        0.9
    """
    thick, lean = draw.length(0.015, 0.04), draw.generator.uniform(0.0, 0.25) * rise
    half, x, parts = 0.5 * width * draw.length(0.8, 1.0) - thick / 2, -depth / 2 + thick / 2, []
    low, high = draw.generator.uniform(0.05, 0.4) * rise, rise
    for side in (-1.0, 1.0):
        parts.append(tube((x, side * half, seat - 0.03), (x - lean, side * half, seat + rise), thick / 2, dark))
    number = draw.count(2, 5)
    if draw.chance(0.6):
        for level in np.linspace(low, high - thick, number):
            at = x - lean * level / rise
            parts.append(tube((at, -half, seat + level), (at, half, seat + level), draw.length(0.008, 0.03), color))
        return parts
    for level in (low, high - thick):
        at = x - lean * level / rise
        parts.append(tube((at, -half, seat + level), (at, half, seat + level), thick / 2, color))
    for y in np.linspace(-half, half, number + 2)[1:-1]:
        foot, head = (x - lean * low / rise, y, seat + low), (x - lean * (high - thick) / rise, y, seat + high - thick)
        parts.append(tube(foot, head, draw.length(0.006, 0.015), color))
    return parts


def _quarter_turn(mesh: Mesh) -> Mesh:
    T = np.eye(4)
    T[:2, :2] = [[0.0, -1.0], [1.0, 0.0]]
    return mesh.moved(T)

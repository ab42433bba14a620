"""Chairs and tables that are drawn: plates on any support, with a back above or nothing.

A chair and a table that share a draw have the same plate and legs, so that nothing but the back tells which is which.
"""

from __future__ import annotations

from dataclasses import dataclass

from eaip_prob.simulation.meshes import Color, Mesh, box, cylinder, joined, tube
from eaip_prob.simulation.varied_backs import BACKS, back
from eaip_prob.simulation.varied_draw import Draw
from eaip_prob.simulation.varied_supports import SUPPORTS, support

# Depth, width and height, m.
_SEAT = ((0.33, 0.6), (0.33, 0.62), (0.3, 0.72))
_PLATE = ((0.3, 0.8), (0.36, 1.25), (0.33, 0.85))
_UNDER_PLATES = ("plain", "board", "apron", "drawer", "leaves")


@dataclass(frozen=True, eq=False)
class _Stand:
    """A plate on a support."""

    size: tuple[float, float, float]
    under: float
    kind: int
    color: Color
    dark: Color
    parts: list[Mesh]


def _stand(draw: Draw, ranges: tuple[tuple[float, float], ...]) -> _Stand:
    depth, width, height = (draw.length(*limits) for limits in ranges)
    color, thickness = draw.color(), draw.length(0.012, 0.09)
    dark, under = draw.color(like=color), height - thickness
    if draw.chance(0.25):  # round
        width = depth
        plate = cylinder(depth / 2, thickness, color, 24).at(z=under)
    else:
        plate = box((depth, width, thickness), color).at(z=under + thickness / 2)
    kind, inner = draw.choice(SUPPORTS), (0.75 if len(plate.vertices) > 8 else 1.0)
    legs = support(kind, draw, (inner * depth, inner * width), under, dark)
    return _Stand((depth, width, height), under, SUPPORTS.index(kind), color, dark, [plate, *legs])


def chair(draw: Draw, shared: Draw | None = None) -> Mesh:
    """A plate on any support with a back above it.

    Args:
        draw: its lengths, parts and colours.
        shared: the same of its plate and support only.

    Example:
        >>> import numpy as np
        >>> bool(chair(Draw(np.random.default_rng(0))).extent()[1, 2] > 0.5)
        True
    """
    stand = _stand(shared or draw, _SEAT)
    color = draw.color(like=stand.color)
    parts = [*stand.parts, *back(draw.matching(stand.kind, BACKS), draw, stand.size, color, stand.dark)]
    if draw.chance(0.3):
        parts += _arm_rests(draw, *stand.size[1:], stand.dark)
    return joined(parts)


def _arm_rests(draw: Draw, width: float, seat: float, color: Color) -> list[Mesh]:
    rise, length, parts = draw.length(0.14, 0.26), draw.length(0.18, 0.34), []
    for side in (-1.0, 1.0):
        y = side * (width / 2 + 0.03)
        parts.append(tube((0.0, side * width / 2, seat - 0.05), (0.0, y, seat + rise), 0.014, color, True))
        parts.append(box((length, draw.length(0.04, 0.08), 0.03), color).at(0.0, y, seat + rise))
    return parts


def table(draw: Draw, shared: Draw | None = None) -> Mesh:
    """A plate on any support with nothing above it.

    Args:
        draw: its lengths, parts and colours.
        shared: the same of its plate and support only, which then are of the size of a chair's.

    Example:
        >>> import numpy as np
        >>> bool(0.3 < table(Draw(np.random.default_rng(0))).extent()[1, 2] < 0.9)
        True
    """
    stand = _stand(draw, _PLATE) if shared is None else _stand(shared, _SEAT)
    (depth, width, _), under, color = stand.size, stand.under, draw.color(like=stand.color)
    kind, parts = draw.matching(stand.kind, _UNDER_PLATES), list(stand.parts)
    if kind == "board":  # between the legs, as in a shelf
        level = under * draw.generator.uniform(0.15, 0.6)
        parts.append(box((0.8 * depth, 0.8 * width, draw.length(0.012, 0.03)), color).at(z=level))
    elif kind in ("apron", "drawer"):
        tall = draw.length(0.04, 0.1) if kind == "apron" else under * draw.length(0.2, 0.4)
        parts.append(box((0.85 * depth, 0.85 * width, tall), color).at(z=under - tall / 2))
    elif kind == "leaves":  # that hang down at both ends
        tall = under * draw.length(0.2, 0.5)
        parts += [box((0.7 * depth, 0.015, tall), color).at(0.0, s * width / 2, under - tall / 2) for s in (-1.0, 1.0)]
    return joined(parts)

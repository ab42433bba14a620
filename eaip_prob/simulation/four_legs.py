"""Furniture on four straight legs: a table, with or without a lower shelf, and a chair."""

from __future__ import annotations

from dataclasses import dataclass

from eaip_prob.simulation.furniture import AbstractObject, check_lengths
from eaip_prob.simulation.meshes import Color, Mesh, box, joined


@dataclass(frozen=True)
class Table(AbstractObject):
    """A board on four square legs with a rail beneath it.

    Args:
        width: m.
        depth: m.
        height: m.
        thickness: of the board, m.
        leg: edge of a leg, m.
        color: of the board.
        leg_color: of legs and rails.
        shelf_height: of a second board between the legs, m; none if None.

    Raises:
        InputError: a dimension not above zero.

    Example:
        >>> Table(0.9, 0.6, 0.7, 0.03, 0.05, (0.8, 0.6, 0.4), (0.7, 0.5, 0.3)).mesh().extent()[1].round(3).tolist()
        [0.3, 0.45, 0.7]
    """

    width: float
    depth: float
    height: float
    thickness: float
    leg: float
    color: Color
    leg_color: Color
    shelf_height: float | None = None

    def __post_init__(self) -> None:
        check_lengths(self)

    def mesh(self) -> Mesh:
        """The table."""
        under = self.height - self.thickness
        parts = [box((self.depth, self.width, self.thickness), self.color).at(z=self.height - self.thickness / 2)]
        parts += legs(self.depth - 0.02, self.width - 0.02, under, self.leg, self.leg_color)
        rail = 0.06
        for side in (-1.0, 1.0):
            x, y = side * (self.depth - 0.02 - self.leg) / 2, side * (self.width - 0.02 - self.leg) / 2
            parts.append(box((self.depth - 0.05, 0.018, rail), self.leg_color).at(0.0, y, under - rail / 2))
            parts.append(box((0.018, self.width - 0.05, rail), self.leg_color).at(x, 0.0, under - rail / 2))
        if self.shelf_height is not None:
            parts.append(box((self.depth - 0.04, self.width - 0.04, 0.018), self.color).at(z=self.shelf_height))
        return joined(parts)


@dataclass(frozen=True)
class Chair(AbstractObject):
    """Four straight legs, a seat, and a back of slats.

    Args:
        width: m.
        depth: m.
        seat_height: top of the seat, m.
        height: top of the back, m.
        leg: edge of a leg, m.
        num_slats: of the back.
        color: of the seat.
        frame_color: of the rest.

    Raises:
        InputError: a dimension not above zero.

    Example:
        >>> chair = Chair(0.42, 0.42, 0.45, 0.85, 0.035, 3, (0.6, 0.4, 0.2), (0.5, 0.3, 0.2))
        >>> chair.mesh().extent()[1].round(3).tolist()
        [0.21, 0.21, 0.85]
    """

    width: float
    depth: float
    seat_height: float
    height: float
    leg: float
    num_slats: int
    color: Color
    frame_color: Color

    def __post_init__(self) -> None:
        check_lengths(self)

    def mesh(self) -> Mesh:
        """The chair."""
        seat, x = 0.03, -(self.depth - self.leg) / 2
        parts = [box((self.depth, self.width, seat), self.color).at(z=self.seat_height - seat / 2)]
        parts += legs(self.depth, self.width, self.seat_height - seat, self.leg, self.frame_color)
        rise = self.height - self.seat_height
        for side in (-1.0, 1.0):
            post = box((self.leg, self.leg, rise), self.frame_color)
            parts.append(post.at(x, side * (self.width - self.leg) / 2, self.seat_height + rise / 2))
        for slat in range(self.num_slats):
            z = self.height - 0.03 - slat * 0.7 * rise / self.num_slats
            parts.append(box((0.015, self.width - self.leg, 0.055), self.frame_color).at(x, 0.0, z))
        return joined(parts)


def legs(depth: float, width: float, height: float, leg: float, color: Color) -> list[Mesh]:
    """Four square legs whose outsides span depth by width.

    Args:
        depth: m.
        width: m.
        height: m.
        leg: edge of a leg, m.
        color: RGB from 0 to 1.
    """
    return [
        box((leg, leg, height), color).at(front * (depth - leg) / 2, side * (width - leg) / 2, height / 2)
        for front in (-1.0, 1.0)
        for side in (-1.0, 1.0)
    ]

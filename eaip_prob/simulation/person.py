"""A standing person whose gloved hands are where they are told to be; the arms follow."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from eaip_prob.errors import InputError, ShapeError
from eaip_prob.simulation.furniture import check_lengths
from eaip_prob.simulation.meshes import Color, Mesh, box, ellipsoid, joined, tube

_REACH = 0.999  # share of the arm's length at which it counts as straight


@dataclass(frozen=True)
class Person:
    """A person who faces the robot, in green gloves.

    Proportions are shares of the stature after Drillis and Contini (1966): shoulder 0.818, hip 0.53, upper arm 0.186,
    forearm to the middle of the hand 0.20, shoulders 0.129 to each side.

    Args:
        stature: m.
        glove_radii: (3,) of a glove's ellipsoid, along x, y, z, m; three equal ones are a sphere.
        glove_color: RGB from 0 to 1.
        shirt_color: RGB from 0 to 1.
        trouser_color: RGB from 0 to 1.
        skin_color: RGB from 0 to 1.

    Raises:
        InputError: lengths not above zero.

    Example:
        >>> person = Person()
        >>> meshes = person.meshes(np.array([[1.2, -0.2, 0.1], [1.2, 0.2, 0.1]]), (1.75, 0.0, -0.93))
        >>> sorted(meshes), meshes["left_glove"].vertices.mean(0).round(2).tolist()
        (['left_glove', 'person', 'right_glove'], [1.2, -0.2, 0.1])
    """

    stature: float = 1.72
    glove_radii: Sequence[float] = (0.048, 0.048, 0.048)
    glove_color: Color = (0.10, 0.62, 0.20)
    shirt_color: Color = (0.62, 0.30, 0.28)
    trouser_color: Color = (0.20, 0.23, 0.33)
    skin_color: Color = (0.85, 0.66, 0.54)

    def __post_init__(self) -> None:
        check_lengths(self)
        if len(self.glove_radii) != 3 or min(self.glove_radii) <= 0:
            raise InputError(f"Expected three glove_radii above zero, got {list(self.glove_radii)}.")

    def meshes(self, hands: Float[np.ndarray, "hands 3"], feet: Sequence[float]) -> dict[str, Mesh]:
        """`person`, `left_glove` and `right_glove` in the world.

        The person faces -x, so the left hand is the one at lower y, and leans towards hands that are out of reach.

        Args:
            hands: (2, 3), centres of the left and the right glove, m.
            feet: (3,), on the floor between both feet, m.

        Raises:
            ShapeError: hands of another shape.
        """
        hands = np.asarray(hands, float)
        if hands.shape != (2, 3):
            raise ShapeError(f"Expected hands with shape (2, 3), left then right, got {hands.shape}.")
        floor = np.asarray(feet, float)
        shoulders = self._shoulders(hands, floor)
        parts = self._body(shoulders.mean(0), floor)
        for shoulder, hand, side in zip(shoulders, hands, (-1.0, 1.0), strict=True):
            parts += self._arm(shoulder, hand, side)
        glove = ellipsoid(self.glove_radii, self.glove_color)
        return {"person": joined(parts), "left_glove": glove.at(*hands[0]), "right_glove": glove.at(*hands[1])}

    @property
    def _links(self) -> tuple[float, float]:
        return 0.186 * self.stature, 0.20 * self.stature

    def _shoulders(self, hands: np.ndarray, feet: np.ndarray) -> np.ndarray:
        rest = feet + np.array([[0.0, side * 0.129 * self.stature, 0.818 * self.stature] for side in (-1.0, 1.0)])
        reach = _REACH * sum(self._links)
        shoulders = rest
        for _ in range(20):  # each step brings the farther hand into reach; two steps do unless both pull apart
            to_hand = hands - shoulders
            distance = np.linalg.norm(to_hand, axis=1)
            farthest = int(np.argmax(distance))
            if distance[farthest] <= reach:
                break
            shoulders = shoulders + to_hand[farthest] * (1.0 - reach / distance[farthest])
        return shoulders

    def _body(self, neck: np.ndarray, feet: np.ndarray) -> list[Mesh]:
        s = self.stature
        lean = neck - (feet + [0.0, 0.0, 0.818 * s])
        hip = feet + [0.0, 0.0, 0.53 * s] + 0.3 * lean * [1.0, 1.0, 0.0]
        head = neck + [-0.02, 0.0, 0.115 * s]
        parts = [
            ellipsoid((0.095, 0.075, 0.12), self.skin_color).at(*head),
            tube(neck, head, 0.05, self.skin_color),
            _trunk(hip - [0.0, 0.0, 0.04], neck + [0.0, 0.0, 0.01], 0.098 * s, 0.118 * s, self.shirt_color),
        ]
        for side in (-1.0, 1.0):
            ankle = feet + [0.0, side * 0.09, 0.07]
            parts.append(tube(hip + [0.0, side * 0.085, -0.02], ankle, 0.07, self.trouser_color, rounded=True))
            parts.append(box((0.26, 0.09, 0.07), (0.1, 0.1, 0.1)).at(*(ankle + [-0.05, 0.0, -0.034])))
        return parts

    def _arm(self, shoulder: np.ndarray, hand: np.ndarray, side: float) -> list[Mesh]:
        elbow = bent(shoulder, hand, *self._links, towards=np.array([0.3, side, -1.0]))
        wrist = hand + (elbow - hand) * (0.75 * min(self.glove_radii) / np.linalg.norm(elbow - hand))
        return [
            tube(shoulder, elbow, 0.048, self.shirt_color, rounded=True),
            tube(elbow, wrist, 0.036, self.shirt_color, rounded=False),
        ]


def bent(
    start: Float[np.ndarray, "3"],
    end: Float[np.ndarray, "3"],
    first: float,
    second: float,
    towards: Float[np.ndarray, "3"],
) -> Float[np.ndarray, "3"]:
    """The joint between two links from `start` to `end`, bent to one side; between both where they do not reach.

    Args:
        start: (3,), m.
        end: (3,), m.
        first: length of the link at the start, m.
        second: length of the link at the end, m.
        towards: (3,), direction to which the joint points.

    Example:
        >>> bent(np.zeros(3), np.array([1.0, 0.0, 0.0]), 0.5, 0.5, np.array([0.0, 0.0, -1.0])).tolist()
        [0.5, 0.0, 0.0]
    """
    along = end - start
    distance = float(np.linalg.norm(along))
    along = along / distance if distance > 0 else np.array([1.0, 0.0, 0.0])
    share = (first**2 - second**2 + distance**2) / (2.0 * max(distance, 1e-9))
    share = float(np.clip(share, -first, first))
    aside = towards - along * (towards @ along)
    return start + along * share + aside / np.linalg.norm(aside) * np.sqrt(max(first**2 - share**2, 0.0))


def _trunk(hip: np.ndarray, neck: np.ndarray, half_hip: float, half_shoulder: float, color: Color) -> Mesh:
    """Flat from front to back, wider at the shoulders."""
    middle = (hip + neck) / 2.0
    across = np.array([0.0, 1.0, 0.0])
    parts = [
        tube(hip - across * half_hip * 0.5, hip + across * half_hip * 0.5, 0.09, color, rounded=True),
        tube(
            neck - across * half_shoulder - [0, 0, 0.04],
            neck + across * half_shoulder - [0, 0, 0.04],
            0.055,
            color,
            rounded=True,
        ),
    ]
    for y in np.linspace(-1.0, 1.0, 5):
        low, high = hip + across * y * half_hip * 0.55, neck + across * y * half_shoulder * 0.85 - [0, 0, 0.03]
        parts.append(tube(low, high, 0.085 if abs(y) < 1 else 0.07, color, rounded=True))
    return joined([*parts, ellipsoid((0.1, half_hip, 0.15), color).at(*middle)])

"""What stands where in one trial: the object, its place and turn, and what is known of its outline.

World frame: the robot's base, x towards the partner, y to the robot's left, z up, m. The floor is at z = -0.93.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float

from eaip_prob.detection import CLASSES
from eaip_prob.errors import InputError
from eaip_prob.simulation import AbstractObject, Mesh, Workspace

MIDDLE = (0.95, 0.0)  # x and y around which objects are put, m
SPREAD = (0.08, 0.05)  # largest shift from there, m
TURN, TURNED = -0.9, 0.5  # the front towards Kinect 3, and the largest turn from that, rad
LIMITS = ((0.33, 1.57), (-0.66, 0.66), (-0.95, 0.18))  # m, x, y, z; over what lies within, the bag can be carried


@dataclass(frozen=True)
class Site:
    """An object in its place.

    Args:
        name: of the object.
        label: its class.
        room: the workspace with the object where it stands.

    Raises:
        InputError: a class that is none of the task, or an object that reaches out of the part of the workspace over
            which the bag can be carried.

    Example:
        >>> from eaip_prob.simulation import Bookshelf
        >>> shelf = Bookshelf(0.4, 0.3, 0.9, 2, 0.018, (0.4, 0.25, 0.15), (0.3, 0.2, 0.1))
        >>> site = Site("shelf", "bookshelf", Workspace(shelf))
        >>> site.low.round(2).tolist(), site.high.round(2).tolist()
        ([0.8, -0.2, -0.93], [1.1, 0.2, -0.03])
    """

    name: str
    label: str
    room: Workspace

    def __post_init__(self) -> None:
        if self.label not in CLASSES:
            raise InputError(f"Expected one of the classes {CLASSES} as label of {self.name!r}, got {self.label!r}.")
        low, high = np.array(LIMITS).T
        if (self.low < low).any() or (self.high > high).any():
            raise InputError(
                f"Expected {self.name!r} within {[list(pair) for pair in LIMITS]} m (x, y, z), over which the bag can "
                f"be carried, got {self.low.round(2).tolist()} to {self.high.round(2).tolist()}. Move or turn it."
            )

    @property
    def mesh(self) -> Mesh:
        """The object in the world."""
        return self.room.placed

    @property
    def low(self) -> Float[np.ndarray, "3"]:
        """Smallest x, y and z of the object, m."""
        return self.mesh.extent()[0]

    @property
    def high(self) -> Float[np.ndarray, "3"]:
        """Largest x, y and z of the object, m."""
        return self.mesh.extent()[1]

    @property
    def place(self) -> Float[np.ndarray, "6"]:
        """Centre and edge lengths of the upright box around the object, m."""
        return np.concatenate([(self.low + self.high) / 2.0, self.high - self.low])


def drawn_site(
    name: str,
    things: Mapping[str, AbstractObject],
    labels: Mapping[str, str],
    room: Workspace,
    generator: np.random.Generator,
) -> Site:
    """An object at a random place and turn.

    Args:
        name: of the object.
        things: name -> object.
        labels: name -> class.
        room: the workspace.
        generator: of the placement.

    Raises:
        InputError: an unknown object, or one that is too large for the task (by `Site`).

    Example:
        >>> from eaip_prob.simulation import Bookshelf
        >>> shelf = Bookshelf(0.4, 0.3, 0.9, 2, 0.018, (0.4, 0.25, 0.15), (0.3, 0.2, 0.1))
        >>> generator = np.random.default_rng(0)
        >>> drawn_site("shelf", {"shelf": shelf}, {"shelf": "bookshelf"}, Workspace(shelf), generator).label
        'bookshelf'
    """
    if name not in things or name not in labels:
        raise InputError(f"Expected an object among {sorted(set(things) & set(labels))}, got {name!r}. Add its class.")
    x, y = np.array(MIDDLE) + np.array(SPREAD) * generator.uniform(-1.0, 1.0, 2)
    turn = TURN + TURNED * generator.uniform(-1.0, 1.0)
    placed = replace(room, thing=things[name], thing_position=(float(x), float(y)), thing_turn=float(turn))
    return Site(name, labels[name], placed)

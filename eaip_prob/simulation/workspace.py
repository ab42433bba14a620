"""The room in which a robot and its partner cover an object with a bag."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import cached_property

import numpy as np
from jaxtyping import Float

from eaip_prob.simulation.furniture import AbstractObject
from eaip_prob.simulation.meshes import Color, Mesh, sheet
from eaip_prob.simulation.person import Person
from eaip_prob.simulation.robot import Bag, BaxterShape
from eaip_prob.simulation.scene import Part, Scene


@dataclass(frozen=True)
class Workspace:
    """The robot at the origin, the object before it, the person behind the object, and the bag between them.

    World frame: the robot's base, x towards the partner, y to the robot's left, z up, m.

    Args:
        thing: the object to cover.
        person: the partner.
        robot: outline of the robot; none if None.
        bag: none if None.
        floor: height of the floor, m. Baxter on its pedestal has its base about 0.93 m above it.
        thing_position: (x, y) of the object, m.
        thing_turn: of the object about the vertical axis, rad.
        person_position: (x, y) between the partner's feet, m.
        floor_color: RGB from 0 to 1.
        tile: edge of the floor's tiles, m.

    Example:
        >>> from eaip_prob.simulation import Bookshelf
        >>> shelf = Bookshelf(0.4, 0.3, 0.9, 2, 0.018, (0.4, 0.25, 0.15), (0.3, 0.2, 0.1))
        >>> hands = np.array([[1.3, -0.3, 0.2], [1.3, 0.3, 0.2]])
        >>> scene = Workspace(shelf).scene(hands, grippers=hands[::-1] - [0.6, 0.0, 0.0])
        >>> [part.name for part in scene.parts]
        ['floor', 'thing', 'person', 'left_glove', 'right_glove', 'robot', 'bag']
    """

    thing: AbstractObject
    person: Person = field(default_factory=Person)
    robot: BaxterShape | None = field(default_factory=BaxterShape)
    bag: Bag | None = field(default_factory=Bag)
    floor: float = -0.93
    thing_position: Sequence[float] = (0.95, 0.0)
    thing_turn: float = 0.0
    person_position: Sequence[float] = (1.8, 0.0)
    floor_color: Color = (0.62, 0.60, 0.57)
    tile: float = 0.5

    def scene(
        self,
        hands: Float[np.ndarray, "hands 3"],
        grippers: Float[np.ndarray, "hands 3"],
        lip: Float[np.ndarray, "hands 3"] | None = None,
        bag: Mesh | None = None,
    ) -> Scene:
        """What is there while gloves and grippers are where they are.

        Args:
            hands: (2, 3), centres of the person's left and right glove, m.
            grippers: (2, 3), tips of the robot's left and right gripper, m.
            lip: (2, 3), where the partner's edge of the bag is held, m; default by both hands.
            bag: that was simulated (`ClothBag.mesh`), in its place; default the sheet of `Bag` between the hands.
        """
        hands, grippers = np.asarray(hands, float), np.asarray(grippers, float)
        held = hands if lip is None else np.asarray(lip, float)
        parts = {"floor": self._floor, "thing": self.placed}
        parts |= self.person.meshes(hands, (*self.person_position, self.floor))
        if self.robot is not None:
            parts["robot"] = self.robot.mesh(grippers)
        if bag is not None:
            parts["bag"] = bag
        elif self.bag is not None:
            # The partner faces the robot: the robot's left gripper is across from the partner's right hand.
            parts["bag"] = self.bag.mesh(np.stack([grippers, held[::-1]]))
        return Scene([Part(name, mesh, self.tile if name == "floor" else 0.0) for name, mesh in parts.items()])

    @cached_property
    def _floor(self) -> Mesh:
        x, y = np.meshgrid([-4.0, 6.0], [-5.0, 5.0])
        return sheet(np.stack([x, y, np.full_like(x, self.floor)], -1), self.floor_color)

    @cached_property
    def placed(self) -> Mesh:
        """The object where it stands in the world, m."""
        T, c, s = np.eye(4), np.cos(self.thing_turn), np.sin(self.thing_turn)
        T[:2, :2] = [[c, -s], [s, c]]
        T[:3, 3] = (*self.thing_position, self.floor)
        return self.thing.mesh().moved(T)

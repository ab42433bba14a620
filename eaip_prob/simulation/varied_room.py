"""The room of the task, as it differs from view to view: people, the bag, the light, and where the object stands.

Robot, camera and floor are those of the laboratory in which the detector is used, as in the paper, whose training
images come from the same Kinect; what changes between views is what changes between trials.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from jaxtyping import Float

from eaip_prob.simulation.furniture import AbstractObject
from eaip_prob.simulation.person import Person
from eaip_prob.simulation.render import Lighting
from eaip_prob.simulation.robot import Bag, BaxterShape
from eaip_prob.simulation.scene import Scene
from eaip_prob.simulation.varied_draw import Draw
from eaip_prob.simulation.workspace import Workspace

FLOOR = -0.93
_MIDDLE, _SPREAD = (0.95, 0.0), 0.16  # of the object's place, m
_TURN, _TURNED = -0.9, 1.2  # rad; the front is more or less towards the right camera
_LOW = 0.3  # share of the views in which the bag hides a part of the object


def varied_scene(thing: AbstractObject, draw: Draw) -> Scene:
    """The room with the object somewhere in the workspace, and mostly a bag above it or over a part of it.

    Args:
        thing: the object.
        draw: everything else.

    Example:
        >>> from eaip_prob.simulation.varied_furniture import varied
        >>> draw = Draw(np.random.default_rng(0))
        >>> varied_scene(varied("table", draw), draw).parts[1].name
        'thing'
    """
    g = draw.generator
    place = np.array(_MIDDLE) + g.uniform(-_SPREAD, _SPREAD, 2)
    top = float(thing.mesh().extent()[1, 2]) + FLOOR
    grey = np.asarray(Workspace(thing).floor_color) * g.uniform(0.85, 1.15) + g.normal(0.0, 0.02, 3)
    room = Workspace(
        thing,
        person=_person(draw),
        robot=BaxterShape(),
        bag=_bag(draw) if draw.chance(0.85) else None,
        floor=FLOOR,
        thing_position=place.tolist(),
        thing_turn=_TURN + g.uniform(-_TURNED, _TURNED),
        person_position=(g.uniform(1.65, 1.95), g.uniform(-0.15, 0.15)),
        floor_color=grey.clip(0.0, 1.0).tolist(),
    )
    return room.scene(*_hands_and_grippers(draw, place, top))


def varied_lighting(draw: Draw) -> Lighting:
    """The room's lamp, a little elsewhere and brighter or darker.

    Args:
        draw: of both.

    Example:
        >>> varied_lighting(Draw(np.random.default_rng(0))).lamp[2] > 0.5
        True
    """
    g, usual = draw.generator, Lighting()
    levels = {name: getattr(usual, name) * g.uniform(0.8, 1.2) for name in ("ambient", "sky", "lamp_light")}
    return replace(usual, lamp=(np.asarray(usual.lamp) + g.normal(0.0, 0.25, 3)).tolist(), **levels)


def _person(draw: Draw) -> Person:
    return Person(draw.generator.uniform(1.5, 1.95), shirt_color=draw.color(), trouser_color=draw.color())


def _bag(draw: Draw) -> Bag:
    return Bag(draw.length(0.01, 0.1), draw.length(0.05, 0.5), tuple(draw.generator.uniform(0.7, 0.95, 3).tolist()))


def _hands_and_grippers(
    draw: Draw, place: Float[np.ndarray, "2"], top: float
) -> tuple[Float[np.ndarray, "hands 3"], Float[np.ndarray, "hands 3"]]:
    """On both sides of the object, mostly above it."""
    g = draw.generator
    above = g.uniform(-0.35, 0.1) if draw.chance(_LOW) else g.uniform(0.15, 0.8)
    half, y = g.uniform(0.2, 0.42), place[1] + g.uniform(-0.1, 0.1)
    sides = np.array([[0.0, -half, 0.0], [0.0, half, 0.0]])
    hands = np.array([place[0] + g.uniform(0.25, 0.55), y, top + above]) + sides
    grippers = np.array([place[0] - g.uniform(0.25, 0.5), y, top + above]) - sides
    if draw.chance(0.3):  # one end of the bag higher than the other
        hands[:, 2] += g.uniform(-0.3, 0.2)
        grippers[:, 2] += g.uniform(-0.3, 0.2)
    return hands + g.normal(0.0, 0.05, (2, 3)), grippers + g.normal(0.0, 0.05, (2, 3))

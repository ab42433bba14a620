"""Demonstrations: a partner covers an object while the robot's left arm is led, and perception watches."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace

import numpy as np

from eaip_prob.detection import Detections
from eaip_prob.perception.hands import HandState
from eaip_prob.simulation.cloth import ClothBag
from eaip_prob.simulation.cloth_contact import Obstacle
from eaip_prob.tasks.bag_covering.cases import Case
from eaip_prob.tasks.bag_covering.looking import best_look
from eaip_prob.tasks.bag_covering.motion import RATE
from eaip_prob.tasks.bag_covering.perceiving import AbstractPerception, Instant
from eaip_prob.tasks.bag_covering.recorded import RecordedCovering
from eaip_prob.tasks.bag_covering.seeing import frame_of_truth, labelled_frame

LOOKING = 1.0  # s in which the object is looked for, before the bag comes over it
_ROUND_OFF = 1e-6  # s


def demonstrated(case: Case, perception: AbstractPerception, rate: float = 10.0) -> RecordedCovering:
    """One demonstration as perceived.

    Args:
        case: the trial, whose gripper path is taken as it is.
        perception: of hands and object.
        rate: frames a second.
    """
    return recorded_as(case, perception, watched(case, perception, rate), looked_at(case, perception))


def recorded_as(
    case: Case, perception: AbstractPerception, hands: Sequence[HandState], detections: Detections
) -> RecordedCovering:
    """A demonstration from its parts.

    Args:
        case: the trial.
        perception: in whose image the object's true box is.
        hands: as tracked.
        detections: of the object.
    """
    truth = labelled_frame(case.site, perception.detecting).objects[0]
    motion = case.motion
    return RecordedCovering(
        case.site.name, case.partner.name, tuple(hands), motion.time, motion.gripper, detections, truth
    )


def watched(case: Case, perception: AbstractPerception, rate: float = 10.0) -> list[HandState]:
    """The partner's hands as tracked over the whole motion.

    Args:
        case: the trial.
        perception: of the hands.
        rate: frames a second.
    """
    state, hands = perception.init(case.site, case.seed), []
    for instant in instants(case, rate, perception.reads_pixels):
        found, state = perception.track(instant, state)
        hands += [] if found is None else [found]
    return hands


def looked_at(case: Case, perception: AbstractPerception, rate: float = 5.0) -> Detections:
    """The object in the best look of the first second.

    Args:
        case: the trial.
        perception: of the object.
        rate: frames a second.
    """
    state, found = perception.init(case.site, case.seed), []
    for instant in instants(case, rate, perception.reads_pixels):
        if instant.time >= LOOKING - _ROUND_OFF:
            break
        detections, state = perception.detect(instant, state)
        found.append(detections)
    return best_look(found)


def instants(case: Case, rate: float, with_bag: bool = True) -> Iterator[Instant]:
    """How the demonstration stands at each frame.

    Args:
        case: the trial.
        rate: frames a second.
        with_bag: whether the bag is simulated; only images show it.
    """
    motion, every = case.motion, max(round(RATE / rate), 1)
    bag, cloth = (ClothBag() if with_bag else None), None
    around = Obstacle.around(case.site.mesh, case.site.room.floor)
    for step, time in enumerate(motion.time):
        if bag is not None:
            handles = np.stack([motion.gripper[step], motion.still, *motion.hands[step]])
            cloth = bag.init(handles, around) if cloth is None else bag.step(cloth, handles, 1.0 / RATE, around)
        if step % every == 0:
            mesh = None if bag is None or cloth is None else bag.mesh(cloth)
            grippers = np.stack([motion.gripper[step], motion.still])
            yield Instant(float(time), motion.hands[step], grippers, mesh)


def seen_by(recorded: Sequence[RecordedCovering], perception: AbstractPerception) -> list[RecordedCovering]:
    """The same demonstrations with the object as another detector would have found it, from what it truly was.

    Args:
        recorded: of any perception.
        perception: whose detector reads labelled frames; one that reads pixels leaves them as they are.
    """
    if perception.reads_pixels:
        return list(recorded)
    detect, camera = perception.detector.detect, perception.detecting
    return [replace(one, detections=detect([frame_of_truth(one.truth, camera)])) for one in recorded]

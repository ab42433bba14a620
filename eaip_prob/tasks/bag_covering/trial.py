"""One trial in the simulated room: partner, perception, loop, robot and bag, step by step until a stated outcome."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field

import numpy as np
from jaxtyping import Float

from eaip_prob.execution import ExecutionState
from eaip_prob.simulation.cloth import ClothBag, ClothState
from eaip_prob.simulation.cloth_contact import Obstacle as ClothObstacle
from eaip_prob.tasks.bag_covering.faults import Faults
from eaip_prob.tasks.bag_covering.loop import CoveringLoop, LoopReport
from eaip_prob.tasks.bag_covering.motion import RATE, Covering
from eaip_prob.tasks.bag_covering.perceiving import AbstractPerception, Instant, Sighting
from eaip_prob.tasks.bag_covering.site import Site

_SETTLING = 1.0  # s for which the bag comes to rest behind the end
_ROUND_OFF = 1e-6  # s


@dataclass(frozen=True)
class Looks:
    """When the cameras look.

    Args:
        rate: frames a second at first; 30 at most.
        later_rate: frames a second after that.
        change: when the rate changes, s.
        seeking_rate: looks for the object a second, of those frames; it does not move, and the bag hides it soon.

    Example:
        >>> [step for step in range(60) if Looks(30.0, 5.0, 0.1).due(step)][:6]
        [0, 1, 2, 6, 12, 18]
    """

    rate: float = 10.0
    later_rate: float = 10.0
    change: float = 1.5
    seeking_rate: float = 5.0

    def due(self, step: int) -> bool:
        """Whether there is a frame at a step of the simulation.

        Args:
            step: 30 a second.
        """
        rate = self.rate if step / RATE < self.change else self.later_rate
        return step % max(round(RATE / rate), 1) == 0

    def seeks(self, step: int) -> bool:
        """Whether the object is looked for at a step of the simulation.

        Args:
            step: 30 a second.
        """
        return step % max(round(RATE / self.seeking_rate), 1) == 0


@dataclass(frozen=True, eq=False)
class Step:
    """What happened at one time.

    Args:
        instant: how things were.
        sighting: what the robot was told, with what went wrong; None between looks.
        report: of the loop.
        execution: of the robot after it.
    """

    instant: Instant
    sighting: Sighting | None
    report: LoopReport
    execution: ExecutionState


@dataclass(frozen=True, eq=False)
class Trial:
    """One run: an object, a partner's motion, how it is seen, and what goes wrong.

    Args:
        site: the object in its place.
        motion: of the partner, and where the grippers start.
        perception: of the robot.
        seed: of all errors.
        looks: when cameras look.
        faults: what goes wrong.
        bag: the cloth; None leaves it out, and nothing is then covered.
    """

    site: Site
    motion: Covering
    perception: AbstractPerception
    seed: int = 0
    looks: Looks = field(default_factory=Looks)
    faults: Faults = field(default_factory=Faults)
    bag: ClothBag | None = field(default_factory=ClothBag)

    def steps(self, loop: CoveringLoop) -> Iterator[Step]:
        """What happens, 30 steps a second, until the robot's motion has an outcome and the bag has come to rest.

        Args:
            loop: of the robot.
        """
        state, seeing = loop.init(self.motion.gripper[0]), self.perception.init(self.site, self.seed)
        around = ClothObstacle.around(self.site.mesh, self.site.room.floor)
        cloth, late, number, left = None, [], 0, round(_SETTLING * RATE)
        while state.execution.outcome is None or left > 0:
            time = number / RATE
            hands, gripper = self._hands(time), state.execution.command.position
            cloth = self._carried(cloth, hands, gripper, around)
            mesh = None if cloth is None or self.bag is None else self.bag.mesh(cloth)
            instant = Instant(time, hands, np.stack([gripper, self.motion.still]), mesh)
            ended = state.execution.outcome is not None
            if self.looks.due(number) and not ended:
                seeks = self.looks.seeks(number) and time < loop.looking - _ROUND_OFF
                sighting, seeing = self.perception.see(instant, seeing, seeks)
                late.append(sighting)
            arrived = late.pop(0) if late and late[0].time + self.faults.delay <= time + _ROUND_OFF else None
            told = None if arrived is None else self._faulty(arrived)
            report, state = loop.step(told, time, state)
            yield Step(instant, told, report, state.execution)
            number, left = number + 1, left - ended

    def _carried(
        self, cloth: ClothState | None, hands: np.ndarray, gripper: np.ndarray, around: ClothObstacle
    ) -> ClothState | None:
        if self.bag is None:
            return None
        handles = np.stack([gripper, self.motion.still, hands[0], hands[1]])
        return self.bag.init(handles, around) if cloth is None else self.bag.step(cloth, handles, 1.0 / RATE, around)

    def _hands(self, time: float) -> Float[np.ndarray, "hands 3"]:
        at = float(self.faults.partner_time(np.array(time)))
        index = min(at * RATE, len(self.motion.time) - 1.0)
        low = min(int(index), len(self.motion.time) - 2)
        return self.motion.hands[low] + (index - low) * (self.motion.hands[low + 1] - self.motion.hands[low])

    def _faulty(self, sighting: Sighting) -> Sighting:
        hands, detections = self.faults.hands(sighting.hands), self.faults.detections(sighting.detections)
        return Sighting(sighting.time, hands, detections)

"""How a trial ended, in one of five stated ways, and what was measured on the way."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
import torch
from jaxtyping import Float

from eaip_prob.readiness import first_ready, remaining_deviation
from eaip_prob.tasks.bag_covering.judging import COVERED, Judge
from eaip_prob.tasks.bag_covering.trial import Step

KINDS = ("covered", "uncovered", "collided", "held", "aborted")
SCORES = ("success", "collisions", "covered", "held")
READY = 0.065  # m; half of what a plan with the usual clearance may be off before it comes nearer than allowed
_MOVING = 0.01  # m/s


@dataclass(frozen=True, eq=False)
class Run:
    """What came of one trial.

    Args:
        kind: one of `KINDS`.
        reason: in words.
        duration: until the robot's motion ended, s.
        covered: share of the counted surface points under the cloth at the end.
        clearance: smallest distance of lip, gripper and forearm from the object while the robot moved, m.
        ready: time from which on the remaining deviation stays below `READY`, s; infinite where never.
        time: (T,), s.
        gripper: (T, 3), where the left gripper was, m.
        near: (T,), distance from the object, m.
        deviation: (P, 2): times of predictions, s, and remaining deviation of the worst signal, m.
    """

    kind: str
    reason: str
    duration: float
    covered: float
    clearance: float
    ready: float
    time: Float[np.ndarray, "time"]
    gripper: Float[np.ndarray, "time 3"]
    near: Float[np.ndarray, "time"]
    deviation: Float[np.ndarray, "predictions 2"]

    @property
    def is_success(self) -> bool:
        """Whether the object was covered, and nothing came too near."""
        return self.kind == "covered"

    def flags(self) -> dict[str, float]:
        """success, collisions, covered and held as 0 or 1; a run that was aborted counts as held."""
        held = self.kind in ("held", "aborted")
        flags = (self.is_success, self.kind == "collided", self.covered >= COVERED, held)
        return dict(zip(SCORES, map(float, flags), strict=True))


def ended(steps: Iterable[Step], judge: Judge) -> Run:
    """The outcome of a trial, from all its steps.

    A collision counts while the robot moves: where it holds, the partner would not pull on.

    Args:
        steps: of a trial.
        judge: of the object in its place.
    """
    taken, deviation = [], []
    for step in steps:
        taken.append((step.instant.time, step.instant.grippers[0], step.instant.hands[1], step.report.command.velocity))
        last = step
        if step.report.prediction is not None:
            now = step.instant.time
            deviation.append((now, float(remaining_deviation(step.report.prediction, now).max())))
    time, gripper, hand, velocity = (np.array(column) for column in zip(*taken, strict=True))
    clearance = judge.clearance(gripper, hand)
    moving = np.linalg.norm(velocity, axis=-1) > _MOVING
    outcome, bag = last.execution.outcome, last.instant.bag
    assert outcome is not None
    covered = 0.0 if bag is None else judge.covered(bag)
    kind, reason = outcome.kind, outcome.reason
    if last.execution.held is not None and kind == "aborted":
        kind, reason = "held", f"{last.execution.held} {reason}"
    if clearance.collides(moving):
        nearest = int(np.where(moving, clearance.smallest, np.inf).argmin())
        kind, reason = "collided", f"{clearance.smallest[nearest]:.3f} m from the object at {time[nearest]:.1f} s."
    elif kind == "finished":
        kind, reason = ("covered" if covered >= COVERED else "uncovered"), f"{covered:.0%} of the points under the bag."
    table = np.array(deviation).reshape(-1, 2)
    return Run(
        kind=kind,
        reason=reason,
        duration=outcome.time,
        covered=covered,
        clearance=float(np.where(moving, clearance.smallest, np.inf).min()),
        ready=_ready(table),
        time=time,
        gripper=gripper,
        near=clearance.smallest,
        deviation=table,
    )


def _ready(deviation: Float[np.ndarray, "predictions 2"]) -> float:
    if not len(deviation):
        return float("inf")
    values = torch.from_numpy(deviation)
    return float(first_ready(values[:, 1:], values[:, 0], READY))

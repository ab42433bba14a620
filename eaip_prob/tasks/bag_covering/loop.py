"""The loop of Fig. 12: from what is seen to where the robot's left gripper shall be, frame by frame.

Hands and detections come in; the trajectory so far and the features of the scene are kept; every `period` a prediction
is made, its plan checked, and followed from where the gripper is if it is safe. A real robot runs the same loop.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np
import torch
from jaxtyping import Float

from eaip_prob.data import EnvironmentFeatures, Trajectory
from eaip_prob.detection import AbstractEnvironmentEncoder, Detections
from eaip_prob.execution import (
    Execution,
    ExecutionState,
    Obstacle,
    PartnerReport,
    PartnerState,
    PartnerWatch,
    Plan,
    RobotCommand,
    SafetyRules,
    Verdict,
    check_plan,
)
from eaip_prob.forecast import Prediction
from eaip_prob.methods import BLIND, asked
from eaip_prob.perception.hands import HandState, hands_to_trajectory
from eaip_prob.prediction import InteractionPredictor
from eaip_prob.robot import SerialArm
from eaip_prob.tasks.bag_covering.looking import best_look
from eaip_prob.tasks.bag_covering.perceiving import Sighting

_ROUND_OFF = 1e-6  # s


@dataclass(frozen=True, eq=False)
class LoopState:
    """What the loop remembers.

    Args:
        execution: of the robot.
        partner: of the watch.
        hands: as tracked so far, at most one each `sampling` seconds.
        detections: of the best look so far.
        detected: time at which an object was last seen, s.
        joints: (J,), angles of the arm, rad; None before the first plan.
        next_plan: time of the next prediction, s.
    """

    execution: ExecutionState
    partner: PartnerState
    hands: tuple[HandState, ...] = ()
    detections: Detections | None = None
    detected: float = -np.inf
    verdict: Verdict | None = None
    next_plan: float = -np.inf


@dataclass(frozen=True, eq=False)
class LoopReport:
    """What one step did.

    Args:
        command: where the gripper shall be.
        partner: what the partner does.
        prediction: made at this step; None where none was.
        verdict: on its plan.
        environment: the features that the prediction was told.
    """

    command: RobotCommand
    partner: PartnerReport
    prediction: Prediction | None = None
    verdict: Verdict | None = None
    environment: EnvironmentFeatures | None = None


@dataclass(frozen=True, eq=False)
class CoveringLoop:
    """One method in the loop.

    Args:
        predictor: fitted.
        method: what is withheld from it, one of the names in `eaip_prob.methods`.
        encoder: of the detections, as the predictor was fitted with.
        arm: whose limits are kept.
        execution: of plans.
        rules: what a plan must keep.
        watch: of the partner.
        observe: time for which the robot only watches, s.
        period: between two predictions, s.
        sampling: least time between two samples of the hands, s.
        looking: time during which the object is looked for; later the bag hides it, s.
        seed: of the draws with which risks are estimated.
    """

    predictor: InteractionPredictor
    method: str
    encoder: AbstractEnvironmentEncoder
    arm: SerialArm | None
    execution: Execution = field(default_factory=Execution)
    rules: SafetyRules = field(default_factory=SafetyRules)
    watch: PartnerWatch = field(default_factory=PartnerWatch)
    observe: float = 1.0
    period: float = 0.2
    sampling: float = 0.1
    looking: float = 1.0
    seed: int = 0

    def init(self, gripper: Float[np.ndarray, "3"], time: float = 0.0) -> LoopState:
        """The state before anything was seen.

        Args:
            gripper: (3,), where the left gripper rests, m.
            time: s.
        """
        return LoopState(self.execution.init(gripper, time), self.watch.init(), next_plan=time + self.observe)

    def step(self, sighting: Sighting | None, now: float, state: LoopState) -> tuple[LoopReport, LoopState]:
        """(report, next state) at one time.

        Args:
            sighting: what arrived; None where nothing did.
            now: s, not before the last step.
            state: from `init` or the last step.
        """
        partner, watching = self.watch.step(sighting.hands if sighting else None, now, state.partner)
        state = replace(state, partner=watching)
        if sighting is not None:
            state = self._remembered(sighting, state)
        stop = None if partner.status == "moves" else partner.reason
        plan = verdict = prediction = environment = None
        if state.hands and stop is None and now >= state.next_plan - _ROUND_OFF:
            environment = self.environment(state)
            prediction = asked(self.predictor, self.method, self.observed(state), environment)
            plan = self.execution.plan(state.execution, prediction)
            verdict = self.verdict(plan, state, now)
            state = replace(state, next_plan=now + self.period, verdict=verdict)
        command, execution = self.execution.step(state.execution, plan, verdict, now, stop)
        return LoopReport(command, partner, prediction, verdict, environment), replace(state, execution=execution)

    def observed(self, state: LoopState) -> Trajectory:
        """The partner's motion so far.

        Args:
            state: with hands seen at least once.
        """
        return hands_to_trajectory(state.hands, correlated=False)

    def environment(self, state: LoopState) -> EnvironmentFeatures:
        """The features of the scene, not observed where no object was detected.

        Args:
            state: from a step.
        """
        if state.detections is None:
            return EnvironmentFeatures.unseen(self.encoder.names)
        return self.encoder.encode(state.detections)

    def _remembered(self, sighting: Sighting, state: LoopState) -> LoopState:
        hands, last = sighting.hands, state.hands[-1].time if state.hands else -np.inf
        if hands is not None and hands.time - last >= self.sampling - _ROUND_OFF:
            state = replace(state, hands=(*state.hands, hands))
        found, known = sighting.detections, state.detections
        if found is None or not len(found):
            return state
        state = replace(state, detected=sighting.time)
        early = sighting.time < self.looking - _ROUND_OFF
        if known is None or early:
            state = replace(state, detections=best_look([found, *([] if known is None else [known])]))
        return state

    def verdict(self, plan: Plan, state: LoopState, now: float) -> Verdict:
        """Whether the robot may follow a plan; a method that is told of the scene also clears what was detected.

        Args:
            plan: from where the gripper is.
            state: from a step.
            now: s.
        """
        chance = torch.Generator().manual_seed(self.seed)
        present = state.execution.command
        joints, underway = self._joints(state, now), state.execution.underway
        if self.method in BLIND:
            return check_plan(plan, present, None, self.rules, self.arm, chance, joints, underway)
        obstacle = None if state.detections is None else Obstacle.most_certain(state.detections)
        if obstacle is None:
            return Verdict(False, "No object was detected and placed, so that nothing is known of what to clear.", 1.0)
        obstacle = obstacle.unseen_for(max(now - state.detected, 0.0))
        return check_plan(plan, present, obstacle, self.rules, self.arm, chance, joints, underway)

    def _joints(self, state: LoopState, now: float) -> Float[np.ndarray, "joints"] | None:
        """Of the arm at present: on the last plan that was followed."""
        plan, verdict = state.execution.plan, state.verdict
        if plan is None or verdict is None or verdict.joints is None or not verdict.safe:
            return None
        return np.array([np.interp(now, plan.time, angles) for angles in verdict.joints.T])

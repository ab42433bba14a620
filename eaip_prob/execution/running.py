"""The robot's side of a motion: it follows the last plan that was found safe, holds where none is, and ends."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import Literal

import numpy as np
from jaxtyping import Float

from eaip_prob.checks import check_positive, check_type
from eaip_prob.errors import InputError
from eaip_prob.execution.following import HASTE, MotionLimits, followed, slowed
from eaip_prob.execution.plan import Plan, RobotCommand, planned
from eaip_prob.execution.safety import Verdict
from eaip_prob.forecast import Prediction

_LOSING = 1e-9  # s; a time before the last step by no more is round-off


@dataclass(frozen=True)
class Outcome:
    """How a motion ended.

    Args:
        kind: "finished": at the end of the plan, and slow; "held": no plan was safe, or not again, until the deadline;
            "aborted": the deadline passed far from the end, or whoever watches stopped it.
        reason: in words.
        time: of the end, s.

    Example:
        >>> Outcome("aborted", "The partner left.", 4.2).kind
        'aborted'
    """

    kind: Literal["finished", "held", "aborted"]
    reason: str
    time: float


@dataclass(frozen=True, eq=False)
class ExecutionState:
    """What `Execution.step` remembers.

    Args:
        command: the last one.
        begun: time of `init`, s.
        plan: the last one that was accepted.
        held: why the robot holds; None while it may move, or has nothing to follow yet.
        outcome: how it ended; None before.
        late: how late the gripper is on the predicted motion, since it waited or held, s.
        haste: by how much faster than the clock it may make up for that.

    Example:
        >>> state = Execution().init([0.4, -0.6, -0.2], time=0.0)
        >>> state.at_rest, state.plan is None, state.outcome is None
        (True, True, True)
    """

    command: RobotCommand
    begun: float
    plan: Plan | None = None
    held: str | None = None
    outcome: Outcome | None = None
    late: float = 0.0
    haste: float = HASTE

    @property
    def underway(self) -> bool:
        """Whether a plan is followed."""
        return self.plan is not None and self.held is None

    @property
    def at_rest(self) -> bool:
        """Whether the gripper stands still."""
        return not self.command.velocity.any()


@dataclass(frozen=True)
class Execution:
    """Follows the newest plan that was found safe, from where the gripper is, without a jump of position or velocity.

    Before the first plan it waits where it is, and afterwards makes up for the time along the path, up to 1.6 times as
    fast, half as hastily after each plan that was too fast. A plan that is not safe makes it hold: it comes to rest on
    a straight way, at the deceleration of its limits, and goes on from there when a later plan is safe. An older plan
    is not followed on, since what made the newer one unsafe holds for it as well. Without a new plan (no frame arrived,
    or it is not certain enough to act) the last one is followed on. State is passed in and returned.

    Args:
        limits: speed, acceleration and deceleration of the gripper.
        deadline: s after `init` at which the motion is given up.
        tolerance: distance from the rest of the path at which the motion is finished, m.
        slow: speed of the gripper below which it may be finished, m/s.
        num_times: at which plans are made.

    Raises:
        InputError: a number that is not above zero.

    Example:
        >>> from eaip_prob.data import Trajectory
        >>> from eaip_prob.execution import known_path
        >>> share = np.linspace(0.0, 1.0, 30)[:, None]
        >>> sweep = np.array([0.4, -0.6, 0.3]) + share**2 * (3.0 - 2.0 * share) * np.array([0.0, 1.2, 0.0])
        >>> across = known_path(Trajectory(4.0 * share[:, 0], sweep, ("x", "y", "z")))
        >>> execution = Execution(deadline=15.0)
        >>> state = execution.init([0.4, -0.6, 0.2], time=0.0)
        >>> plan, now = execution.plan(state, across), 0.0
        >>> command, state = execution.step(state, plan, Verdict(safe=True), now)
        >>> while state.outcome is None:
        ...     now += 0.05
        ...     command, state = execution.step(state, None, None, now)
        >>> state.outcome.kind, command.position.round(1).tolist()
        ('finished', [0.4, 0.6, 0.3])
    """

    limits: MotionLimits = field(default_factory=MotionLimits)
    deadline: float = 30.0
    tolerance: float = 0.03
    slow: float = 0.05
    num_times: int = 50

    def __post_init__(self) -> None:
        for name in ("deadline", "tolerance", "slow"):
            check_positive(name, getattr(self, name))

    def init(self, position: Sequence[float] | Float[np.ndarray, "3"], time: float) -> ExecutionState:
        """The state of a gripper at rest.

        Args:
            position: (3,), in the robot's base, m.
            time: s.
        """
        return ExecutionState(RobotCommand(time, np.array(position, dtype=np.float64), np.zeros(3)), time)

    def plan(self, state: ExecutionState, prediction: Prediction) -> Plan:
        """How the gripper would take a predicted path, from the last command on.

        Args:
            state: from `init` or the last step.
            prediction: of the robot's x, y and z, m.
        """
        return planned(prediction, state.command, self.limits, self.num_times, state.late, state.haste)

    def moved(self, state: ExecutionState, present: RobotCommand) -> ExecutionState:
        """The same state with the gripper elsewhere: where somebody pushed it, or where it lags behind.

        Args:
            state: from `init` or the last step.
            present: as measured.

        Example:
            >>> execution = Execution()
            >>> state = execution.init([0.4, -0.6, -0.2], time=0.0)
            >>> execution.moved(state, RobotCommand(0.1, [0.4, -0.6, 0.1], [0, 0, 0])).command.position[2].item()
            0.1
        """
        check_type("present", present, RobotCommand, "Make one with RobotCommand(time, position, velocity).")
        return replace(state, command=present)

    def step(
        self,
        state: ExecutionState,
        plan: Plan | None,
        verdict: Verdict | None,
        time: float,
        stop: str | None = None,
    ) -> tuple[RobotCommand, ExecutionState]:
        """(where the gripper shall be at this time, next state).

        Args:
            state: from `init` or the last step.
            plan: a new one, or None to go on.
            verdict: about the new plan.
            time: s, not before the last step.
            stop: why the motion ends now, where somebody who watches wants that: the partner left.

        Raises:
            InputError: a plan without a verdict or the other way round, or a time before the last step.
        """
        self._check(state, plan, verdict, time)
        if plan is not None and verdict is not None and state.outcome is None:
            # What is too fast with haste would be so for ever: the gripper would hold, and be later still.
            haste = 0.5 * state.haste if verdict.too_fast else state.haste
            state = replace(state, held=verdict.reason or "The plan is not safe.", haste=haste)
            if verdict.safe:
                state = replace(state, plan=plan, held=None)
        state = replace(state, command=self._command(state, time), late=self._late(state, time))
        if state.outcome is None:
            state = replace(state, outcome=self._outcome(state, stop))
        return state.command, state

    def _command(self, state: ExecutionState, time: float) -> RobotCommand:
        last, plan = state.command, state.plan
        elapsed = max(time - last.time, 0.0)
        now = np.stack([last.position, last.velocity])
        if elapsed == 0.0:
            return last
        if plan is None or state.held is not None or state.outcome is not None:
            return RobotCommand(time, *slowed(now, elapsed, self.limits.deceleration))
        path = np.stack([plan.expected(last.time), plan.expected(time)])
        return RobotCommand(time, *followed(now, path, elapsed, plan.rate, self.limits))

    def _late(self, state: ExecutionState, time: float) -> float:
        if state.plan is None or state.held is not None:
            return state.late + max(time - state.command.time, 0.0)
        return float(state.plan.lateness(time))

    def _outcome(self, state: ExecutionState, stop: str | None) -> Outcome | None:
        command, plan = state.command, state.plan
        if stop is not None:
            return Outcome("aborted", stop, command.time)
        left = np.inf if plan is None else plan.distance_left(command.position, command.time)
        if state.held is None and left < self.tolerance and np.linalg.norm(command.velocity) < self.slow:
            return Outcome("finished", "The gripper is at the end of the path.", command.time)
        if command.time - state.begun < self.deadline:
            return None
        late = f"after {self.deadline:g} s"
        if state.held is not None:
            return Outcome("held", f"Not safe {late}: {state.held}", command.time)
        if plan is None:
            return Outcome("held", f"There was no plan to follow {late}.", command.time)
        return Outcome("aborted", f"Not at the end {late}: up to {left:.2f} m of the path are left.", command.time)

    def _check(self, state: ExecutionState, plan: Plan | None, verdict: Verdict | None, time: float) -> None:
        check_type("state", state, ExecutionState, "Pass what init or the last step returned.")
        if (plan is None) != (verdict is None):
            raise InputError("Expected a plan together with its verdict, or neither, got one of them. Use check_plan.")
        if plan is not None:
            check_type("plan", plan, Plan, "Make one with Execution.plan(state, prediction).")
            check_type("verdict", verdict, Verdict, "Make one with check_plan.")
        if not state.command.time - _LOSING <= time < np.inf:
            raise InputError(
                f"Expected time not before the last step at {state.command.time:g} s, got {time}. Pass that of now."
            )

"""Whether the robot may follow a plan: it can, it would not jump, and the bag clears the object probably enough."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import torch
from jaxtyping import Float

from eaip_prob.checks import check_count, check_fraction, check_positive, check_type
from eaip_prob.errors import InputError
from eaip_prob.execution.following import free_response
from eaip_prob.execution.obstacle import Obstacle, clearance
from eaip_prob.execution.plan import SIGNALS, Plan, RobotCommand
from eaip_prob.robot import SerialArm, check_motion

_ROUND_OFF = 1e-9  # m
_BETWEEN = 4  # points looked at from one time of a plan to the next: at 0.2 s and 0.5 m/s they are 2.5 cm apart


@dataclass(frozen=True)
class SafetyRules:
    """What a plan must keep.

    Args:
        margin: clearance of the lip from the object, m, at least 0.
        risk: probability with which the clearance may fall below the margin, 0 to 1.
        underway: the same for a robot that follows a plan already, where that is more: to stop over an object,
            with a partner who goes on, is no safe state either.
        reach: how far points of the plan may be out of reach, m; the arm then passes by them that near.
        jump: distance of the plan's beginning from where the robot is, m.
        speed: of the gripper, m/s.
        num_samples: paths and boxes drawn; a risk of 0.2 is then known to 0.035 with the default.

    Raises:
        InputError: a negative margin, or a number out of its range.

    Example:
        >>> SafetyRules(risk=0.1).margin
        0.05
    """

    margin: float = 0.05
    risk: float = 0.2
    underway: float = 0.4
    reach: float = 0.01
    jump: float = 0.1
    speed: float = 1.0
    num_samples: int = 128

    def __post_init__(self) -> None:
        if not 0.0 <= self.margin < float("inf"):
            raise InputError(f"Expected margin of at least 0 and finite, in m, got {self.margin}.")
        check_fraction("risk", self.risk)
        check_fraction("underway", self.underway)
        if not 0.0 < self.reach < float("inf"):
            raise InputError(f"Expected reach above zero and finite, in m, got {self.reach}.")
        check_positive("jump", self.jump)
        check_positive("speed", self.speed)
        check_count("num_samples", self.num_samples)


@dataclass(frozen=True, eq=False)
class Verdict:
    """What was found about a plan.

    Args:
        safe: whether the robot may follow it.
        reason: why not, in words; None where it may.
        risk: probability that the lip comes nearer to the object than the margin; 0 where no object is known.
        joints: (S, J), joint angles along the plan, rad; None where no arm was given.
        too_fast: whether the gripper or a joint would be faster than allowed.

    Example:
        >>> Verdict(False, "The gripper cannot reach that far.", 0.0).safe
        False
    """

    safe: bool
    reason: str | None = None
    risk: float = 0.0
    joints: Float[np.ndarray, "times joints"] | None = None
    too_fast: bool = False


def check_plan(
    plan: Plan,
    present: RobotCommand,
    obstacle: Obstacle | None,
    rules: SafetyRules,
    arm: SerialArm | None,
    generator: torch.Generator,
    joints: Float[np.ndarray, "joints"] | None = None,
    underway: bool = False,
) -> Verdict:
    """Whether the gripper may follow a plan, and if not, why not: all that is wrong with it.

    Looked at is what the gripper would do from where it is. A generator that is seeded anew for each plan compares
    plans by the same draws, so that a plan does not become unsafe by chance alone.

    Args:
        plan: from `Execution.plan`.
        present: where the robot is.
        obstacle: to be cleared; None where nothing is known of one, and the risk is not looked at.
        rules: what is allowed.
        arm: whose limits are kept; None for a robot without joints.
        generator: of the draws.
        joints: (J,), joint angles at present, rad; None where they are not known.
        underway: whether the robot follows a plan already.

    Raises:
        InputError: arguments of other types, or what `check_motion` refuses.

    Example:
        >>> from eaip_prob.data import Trajectory
        >>> from eaip_prob.execution import Execution, known_path
        >>> share = torch.linspace(0.0, 1.0, 30)[:, None]
        >>> sweep = torch.tensor([0.5, -0.6, 0.1]) + share**2 * (3.0 - 2.0 * share) * torch.tensor([0.0, 1.2, 0.0])
        >>> across = known_path(Trajectory(8.0 * share[:, 0], sweep, SIGNALS), std=0.02)
        >>> execution = Execution()
        >>> state = execution.init([0.5, -0.6, 0.1], time=0.0)
        >>> plan, chance = execution.plan(state, across), torch.Generator().manual_seed(0)
        >>> low, high = (Obstacle([0.9, 0.0, top - 0.4, 0.5, 0.4, 0.8], 1e-6 * np.eye(6)) for top in (-0.1, 0.1))
        >>> check_plan(plan, state.command, low, SafetyRules(), None, chance).safe
        True
        >>> check_plan(plan, state.command, high, SafetyRules(), None, chance).reason
        'The lip of the bag comes nearer to the object than 0.05 m with probability 0.98, where 0.20 is allowed.'
    """
    check_type("plan", plan, Plan, "Make one with Execution.plan(state, prediction).")
    check_type("present", present, RobotCommand, "Make one with RobotCommand(time, position, velocity).")
    check_type("rules", rules, SafetyRules, "Make them with SafetyRules().")
    motion = None if arm is None else check_motion(arm, plan.time, plan.path, joints, rules.reach)
    risk = 0.0 if obstacle is None else collision_risk(plan, obstacle, rules, generator)
    speed = _speed(plan, rules)
    reasons = [motion.reason if motion else None, _jump(plan, present, rules), speed, _risk(risk, rules, underway)]
    reason = " ".join(text for text in reasons if text)
    too_fast = speed is not None or (motion is not None and motion.speed_share > 1.0)
    return Verdict(not reason, reason or None, risk, None if motion is None else motion.joints, too_fast)


def collision_risk(plan: Plan, obstacle: Obstacle, rules: SafetyRules, generator: torch.Generator) -> float:
    """Share of draws in which the lip comes nearer to the object than the margin somewhere along the rest of the path.

    A draw is a motion from the prediction against a box from the obstacle's Gaussian. The gripper's path in it is the
    planned one plus the drawn deviation from the mean, which comes in as the attractor lets go of where the gripper is:
    that it is there is certain, and so is that it may be there: where the margin is not kept at present, only coming
    nearer still counts. Between two times paths are straight.

    Args:
        plan: what the gripper would do.
        obstacle: to be cleared.
        rules: margin and number of draws.
        generator: of the draws.

    Example:
        >>> from eaip_prob.data import Trajectory
        >>> from eaip_prob.execution import Execution, known_path
        >>> share = torch.linspace(0.0, 1.0, 30)[:, None]
        >>> sweep = torch.tensor([0.5, -0.6, 0.1]) + share**2 * (3.0 - 2.0 * share) * torch.tensor([0.0, 1.2, 0.0])
        >>> across = known_path(Trajectory(8.0 * share[:, 0], sweep, SIGNALS), std=0.02)
        >>> execution = Execution()
        >>> plan = execution.plan(execution.init([0.5, -0.6, 0.1], time=0.0), across)
        >>> table = Obstacle([0.9, 0.0, -0.35, 0.5, 0.4, 0.8], 1e-6 * np.eye(6))
        >>> 0.3 < collision_risk(plan, table, SafetyRules(), torch.Generator().manual_seed(0)) < 0.7
        True
    """
    paths = _drawn_paths(plan, rules.num_samples, generator)
    sides = obstacle.sides(rules.num_samples, generator)
    share = np.linspace(0.0, 1.0, _BETWEEN, endpoint=False)[:, None]
    dense = paths[:, :-1, None] + share * np.diff(paths, axis=1)[:, :, None]
    points = np.concatenate([dense.reshape(len(paths), -1, 2), paths[:, -1:]], axis=1)
    near = clearance(points, sides)
    # Nearer than it is at present, where it is within the margin already: to hold would leave it there.
    return float((near.min(-1) < np.minimum(rules.margin, near[:, 0] - _ROUND_OFF)).mean())


def _drawn_paths(plan: Plan, num: int, generator: torch.Generator) -> Float[np.ndarray, "num times 2"]:
    """Y and z of the gripper's path in draws of the motion."""
    time = plan.time - plan.lateness(plan.time)
    order = [plan.prediction.names.index(name) for name in SIGNALS[1:]]
    drawn = plan.prediction.at(torch.from_numpy(time)).sample(num, generator)[..., order].detach().numpy()
    # A draw differs from the plan as far as the attractor has let go of where the gripper is. What a draw does at this
    # moment is not handed on: a wiggle of a centimetre has half a metre per second, which would become a motion.
    kept = free_response(plan.time - plan.time[0], plan.rate)[0][:, :1]
    return plan.path[:, 1:] + (1.0 - kept) * (drawn - plan.mean[:, 1:])


def _jump(plan: Plan, present: RobotCommand, rules: SafetyRules) -> str | None:
    distance = float(np.linalg.norm(plan.commanded(present.time)[0] - present.position))
    if distance <= rules.jump:
        return None
    return f"The plan begins {distance:.3f} m from where the robot is, farther than the {rules.jump:g} m allowed."


def _speed(plan: Plan, rules: SafetyRules) -> str | None:
    steps = np.linalg.norm(np.diff(plan.path, axis=0), axis=-1) / np.diff(plan.time)
    fastest = max(float(steps.max()), float(np.linalg.norm(plan.velocity, axis=-1).max()))
    if fastest <= rules.speed * (1.0 + 1e-9):
        return None
    return f"The gripper would move at {fastest:.2f} m/s, faster than the {rules.speed:g} m/s allowed."


def _risk(risk: float, rules: SafetyRules, underway: bool) -> str | None:
    allowed = max(rules.underway, rules.risk) if underway else rules.risk
    if risk <= allowed:
        return None
    return (
        f"The lip of the bag comes nearer to the object than {rules.margin:g} m with probability {risk:.2f}, "
        f"where {allowed:.2f} is allowed."
    )

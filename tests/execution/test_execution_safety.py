from __future__ import annotations

import dataclasses

import numpy as np
import pytest
import torch
from execution_world import DURATION, SIGNALS, START, box, smooth, sweep
from scipy.stats import norm

from eaip_prob.data.trajectory import Trajectory
from eaip_prob.errors import InputError
from eaip_prob.execution import (
    Execution,
    Plan,
    RobotCommand,
    SafetyRules,
    check_plan,
    clearance,
    collision_risk,
    known_path,
)
from eaip_prob.execution.safety import _drawn_paths
from eaip_prob.forecast import Prediction
from eaip_prob.gaussian import BlockGaussian
from eaip_prob.robot import baxter_left_arm

EXECUTION = Execution()
STATE = EXECUTION.init(START, time=0.0)
RULES = SafetyRules()


def generator(seed: int = 0) -> torch.Generator:
    return torch.Generator().manual_seed(seed)


def level(std: float, height: float = 0.3) -> Plan:
    """A straight path to the left at one height, which is known up to a Gaussian."""
    share = smooth(np.linspace(0.0, 1.0, 120))
    points = np.array([0.5, -2.0, height]) + share[:, None] * [0.0, 2.8, 0.0]
    motion = Trajectory(torch.linspace(0.0, 20.0, 120), torch.from_numpy(points), SIGNALS)
    state = Execution(num_times=100).init(points[0], time=0.0)
    return Execution(num_times=100).plan(state, known_path(motion, (0.0, 0.0, std)))


@pytest.mark.parametrize(("std", "top_std", "gap"), [(0.05, 0.0, 0.02), (0.03, 0.04, 0.1), (0.0, 0.05, 0.05)])
def test_the_risk_of_a_straight_path_is_a_normal_probability(std, top_std, gap):
    obstacle = box(top=0.3 - gap)
    covariance = np.zeros((6, 6))
    covariance[2, 2] = top_std**2
    obstacle = dataclasses.replace(obstacle, covariance=covariance)
    rules = SafetyRules(num_samples=2000)
    risk = collision_risk(level(std), obstacle, rules, generator())
    # Height minus top is normal over the box, where the attractor has long come to the drawn height.
    exact = norm.cdf((rules.margin - gap) / np.hypot(std, top_std))
    assert abs(risk - exact) < 4.0 * np.sqrt(exact * (1.0 - exact) / 2000)


def uncertain(height: float) -> Prediction:
    """A sweep of which the forces, the goal and the start are known up to Gaussians: its velocity too is uncertain."""
    one = sweep(height)
    gaussian = one.posterior.components
    std = torch.cat([torch.full((one.primitive.num_weights - 3,), 20.0), torch.tensor([0.05, 0.03, 0.05])]).repeat(3)
    known = BlockGaussian(gaussian.mean, torch.diag(std.double() ** 2)[None], gaussian.layout)
    return dataclasses.replace(one, posterior=dataclasses.replace(one.posterior, components=known))


def slow_paths(plan: Plan, num: int, seed: int) -> np.ndarray:
    """The same draws, decoded one by one, each as far as an attractor has let go of where the gripper is."""
    prediction = plan.prediction
    weights, _ = prediction.posterior.sample(num, generator(seed))
    phase = torch.from_numpy(plan.time - plan.lateness(plan.time)) / DURATION
    paths = []
    for one in weights:
        apart = prediction.primitive.decode(one, phase, DURATION).numpy() - plan.mean
        elapsed = plan.rate * (plan.time - plan.time[0])
        paths.append(plan.path + (1.0 - (1.0 + elapsed) * np.exp(-elapsed))[:, None] * apart)
    return np.stack(paths)


@pytest.mark.parametrize(("time", "late"), [(0.0, 0.0), (3.0, 0.0), (3.0, 1.5)])
def test_draws_come_in_as_the_attractor_lets_go(time, late):
    state = dataclasses.replace(EXECUTION.init(START, time=time), late=late)
    plan = EXECUTION.plan(state, uncertain(0.7))
    exact = slow_paths(plan, 20, seed=3)
    np.testing.assert_allclose(_drawn_paths(plan, 20, generator(3)), exact[..., 1:], atol=1e-6)


def test_the_risk_is_that_of_a_slow_loop():
    plan, obstacle, rules = EXECUTION.plan(STATE, uncertain(0.7)), box(top=0.15, std=0.02), SafetyRules(num_samples=60)
    chance, risk = generator(3), collision_risk(plan, obstacle, rules, generator(3))
    paths, count = _drawn_paths(plan, 60, chance), 0
    for path, side in zip(paths, obstacle.sides(60, chance), strict=True):
        nearest = np.inf
        for before, after in zip(path[:-1], path[1:], strict=True):
            for share in (0.0, 0.25, 0.5, 0.75, 1.0):
                nearest = min(nearest, float(clearance((before + share * (after - before))[None], side)[0]))
        count += nearest < min(rules.margin, float(clearance(path[:1], side)[0]))
    assert 0.1 < risk < 0.95
    assert risk == count / 60


def test_where_the_gripper_is_now_is_certain():
    beside = box(top=0.0, width=2.0 * (0.6 - 0.08))  # its side 8 cm from the start, which a prediction knows to 10 cm
    still = Trajectory(torch.linspace(0.0, 10.0, 60), torch.from_numpy(np.tile(START, (60, 1))), SIGNALS)
    plan = EXECUTION.plan(STATE, known_path(still, (0.0, 0.1, 0.0)))
    soon = dataclasses.replace(plan, time=plan.time[:2] / 10.0, path=plan.path[:2], mean=plan.mean[:2])
    assert collision_risk(soon, beside, RULES, generator()) == 0.0
    assert collision_risk(plan, beside, RULES, generator()) > 0.3


def test_more_is_allowed_to_a_robot_that_is_underway():
    obstacle, rules = box(top=0.15, std=0.02), SafetyRules(risk=0.1, underway=0.9)
    plan = EXECUTION.plan(STATE, uncertain(0.7))
    begins, goes_on = (
        check_plan(plan, STATE.command, obstacle, rules, None, generator(), underway=going) for going in (False, True)
    )
    assert 0.1 < begins.risk == goes_on.risk < 0.9 and goes_on.safe
    assert not begins.safe and "where 0.10 is allowed" in str(begins.reason)


def test_an_arm_may_pass_by_a_point_as_near_as_is_allowed():
    arm, far = baxter_left_arm(), known_path(Trajectory([0.0, 9.0], [[0.5, 0.0, 0.1], [1.35, 0.0, 0.1]], SIGNALS))
    plan = EXECUTION.plan(EXECUTION.init(np.array([0.5, 0.0, 0.1]), 0.0), far)
    command = RobotCommand(0.0, plan.path[0], np.zeros(3))
    short, long = (check_plan(plan, command, None, SafetyRules(reach=reach), arm, generator()) for reach in (0.01, 0.5))
    assert not short.safe and "out of reach" in str(short.reason) and "out of reach" not in str(long.reason)


def test_a_plan_is_not_refused_for_where_the_gripper_is():
    beside = box(top=0.0, width=2.0 * (0.6 - 0.01), std=0.001)  # its side is 1 cm from the start, less than the margin
    away, towards = (
        known_path(Trajectory(torch.linspace(0.0, 10.0, 60), torch.from_numpy(START + way), SIGNALS), 1e-6)
        for way in (np.linspace(0.0, 1.0, 60)[:, None] * np.array([0.0, end, 0.0]) for end in (-0.3, 0.3))
    )
    leaving, coming = (
        collision_risk(EXECUTION.plan(STATE, one), beside, RULES, generator()) for one in (away, towards)
    )
    assert leaving == 0.0 and coming == 1.0


def test_a_late_start_that_would_cut_the_corner_is_refused():
    obstacle, prediction = box(top=0.25), sweep(0.7)
    early = check_plan(EXECUTION.plan(STATE, prediction), STATE.command, obstacle, RULES, None, generator())
    assert early.safe
    late = EXECUTION.init(START, time=5.5)
    verdict = check_plan(EXECUTION.plan(late, prediction), late.command, obstacle, RULES, None, generator())
    assert not verdict.safe
    assert verdict.risk == 1.0


def test_a_corner_between_two_times_is_not_missed():
    plan = level(0.0, height=0.0)
    two = dataclasses.replace(plan, time=np.array([0.0, 20.0]), path=plan.path[[0, -1]], mean=plan.mean[[0, -1]])
    assert collision_risk(two, box(top=0.2, width=1.2), RULES, generator()) == 1.0


def test_the_same_seed_gives_the_same_risk_and_the_generator_moves_on():
    plan, obstacle, chance = EXECUTION.plan(STATE, sweep(0.4, std=0.05)), box(0.15, std=0.05), generator(5)
    risks = [collision_risk(plan, obstacle, RULES, chance) for _ in range(4)]
    assert len(set(risks)) > 1
    assert risks[0] == collision_risk(plan, obstacle, RULES, generator(5))


def test_more_margin_is_more_risk_and_is_named():
    plan, obstacle = EXECUTION.plan(STATE, sweep(0.4, std=0.03)), box(-0.05)
    risks = [collision_risk(plan, obstacle, SafetyRules(margin=margin), generator()) for margin in (0.0, 0.15, 0.4)]
    assert risks[0] < risks[1] < risks[2] == 1.0
    verdict = check_plan(plan, STATE.command, obstacle, SafetyRules(margin=0.4), None, generator())
    assert (verdict.safe, verdict.risk) == (False, 1.0)
    assert verdict.reason is not None
    assert "nearer to the object than 0.4 m with probability 1.00, where 0.20 is allowed" in verdict.reason
    assert check_plan(plan, STATE.command, obstacle, SafetyRules(margin=0.4, risk=1.0), None, generator()).safe


def test_without_an_object_there_is_no_risk_to_look_at():
    verdict = check_plan(EXECUTION.plan(STATE, sweep()), STATE.command, None, RULES, None, generator())
    assert (verdict.safe, verdict.reason, verdict.risk, verdict.joints) == (True, None, 0.0, None)


def test_a_plan_that_begins_elsewhere_is_refused():
    plan = EXECUTION.plan(STATE, sweep())
    far = RobotCommand(0.0, START + [0.0, 0.0, 0.12], np.zeros(3))
    verdict = check_plan(plan, far, None, RULES, None, generator())
    assert not verdict.safe
    assert verdict.reason == "The plan begins 0.120 m from where the robot is, farther than the 0.1 m allowed."
    # A measurement that comes later is compared with where the plan is by then.
    later = RobotCommand(5.0, plan.commanded(5.0)[0], np.zeros(3))
    assert check_plan(plan, later, None, RULES, None, generator()).safe
    assert not check_plan(plan, RobotCommand(5.0, START, np.zeros(3)), None, RULES, None, generator()).safe


def test_a_plan_that_is_too_fast_is_refused():
    rules = SafetyRules(speed=0.2)
    verdict = check_plan(EXECUTION.plan(STATE, sweep()), STATE.command, None, rules, None, generator())
    assert verdict.reason is not None
    assert verdict.reason.startswith("The gripper would move at 0.33 m/s, faster than the 0.2 m/s allowed")
    plan = EXECUTION.plan(STATE, sweep(0.0))
    leap = dataclasses.replace(plan, path=plan.path + np.where(np.arange(50) > 20, 0.3, 0.0)[:, None])
    assert "faster than the 1 m/s" in str(check_plan(leap, STATE.command, None, RULES, None, generator()).reason)


def test_an_arm_gives_joints_or_its_reason():
    arm = baxter_left_arm()
    plan = EXECUTION.plan(STATE, sweep())
    verdict = check_plan(plan, STATE.command, None, RULES, arm, generator())
    assert verdict.safe, verdict.reason
    assert verdict.joints is not None
    np.testing.assert_allclose(arm.tip(verdict.joints), plan.path, atol=2e-3)
    turned = verdict.joints[0] + np.array([0.1, 0.0, -0.2, 0.1, 0.3, 0.0, 0.0])
    again = check_plan(plan, STATE.command, None, RULES, arm, generator(), joints=turned)
    assert again.joints is not None
    assert np.abs(again.joints[0] - turned).max() < 0.15 < np.abs(again.joints[0] - verdict.joints[0]).max()
    far = check_plan(EXECUTION.plan(STATE, sweep(1.8)), STATE.command, box(0.4), RULES, arm, generator())
    assert not far.safe
    assert "out of reach" in str(far.reason)
    hasty = check_plan(
        EXECUTION.plan(STATE, sweep(duration=1.6)), STATE.command, None, SafetyRules(speed=9.0), arm, generator()
    )
    assert hasty.too_fast
    assert "times its limit" in str(hasty.reason)


def test_all_that_is_wrong_is_said():
    plan = EXECUTION.plan(STATE, sweep(0.0))
    far = RobotCommand(0.0, START + 1.0, np.zeros(3))
    verdict = check_plan(plan, far, box(0.4), SafetyRules(speed=0.1), None, generator())
    for words in ("The plan begins", "The gripper would move", "The lip of the bag"):
        assert words in str(verdict.reason)


@pytest.mark.parametrize(
    ("name", "value"),
    [
        ("margin", -0.01),
        ("margin", float("nan")),
        ("risk", 1.2),
        ("risk", float("nan")),
        ("jump", 0.0),
        ("speed", -1.0),
        ("num_samples", 0),
    ],
)
def test_rules_out_of_range_are_refused(name, value):
    with pytest.raises(InputError, match=name):
        SafetyRules(**{name: value})


def test_arguments_of_other_types_are_refused():
    plan = EXECUTION.plan(STATE, sweep())
    with pytest.raises(InputError, match="plan as Plan"):
        check_plan(plan.prediction, STATE.command, None, RULES, None, generator())  # pyright: ignore[reportArgumentType]
    with pytest.raises(InputError, match="present as RobotCommand"):
        check_plan(plan, START, None, RULES, None, generator())  # pyright: ignore[reportArgumentType]

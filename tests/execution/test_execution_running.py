from __future__ import annotations

import dataclasses

import numpy as np
import pytest
import torch
from execution_world import DURATION, SIGNALS, START, path, sweep

from eaip_prob.data.trajectory import Trajectory
from eaip_prob.errors import InputError
from eaip_prob.execution import (
    Execution,
    ExecutionState,
    MotionLimits,
    RobotCommand,
    SafetyRules,
    Verdict,
    check_plan,
    known_path,
)
from eaip_prob.forecast import Prediction
from eaip_prob.primitives import Boundary

STEP = 1.0 / 30.0
SAFE, UNSAFE = Verdict(True), Verdict(False, "The lip would touch the chair.", 0.9)
EXECUTION = Execution()
GOAL = path()[1][-1]


def run(
    execution: Execution,
    state: ExecutionState,
    until: float,
    plans: dict[int, tuple[Prediction, Verdict]] | None = None,
    stop: dict[int, str] | None = None,
) -> tuple[np.ndarray, np.ndarray, ExecutionState]:
    """(positions, velocities, state) of steps at 30 Hz, with plans and reasons to stop at some of them."""
    commands, count = [state.command], round((until - state.command.time) / STEP)
    for k in range(count):
        prediction, verdict = (plans or {}).get(k, (None, None))
        plan = None if prediction is None else execution.plan(state, prediction)
        time = commands[0].time + (k + 1) * STEP
        command, state = execution.step(state, plan, verdict, time, (stop or {}).get(k))
        commands.append(command)
    return np.stack([c.position for c in commands]), np.stack([c.velocity for c in commands]), state


def test_steps_are_the_dmp_s_own_rollout_from_the_present_state():
    prediction, pushed = sweep(), RobotCommand(2.0, START + [0.0, 0.1, 0.1], np.array([0.0, 0.05, 0.0]))
    state = EXECUTION.moved(EXECUTION.init(START, time=0.0), pushed)
    positions, velocities, _ = run(EXECUTION, state, 8.0, {0: (prediction, SAFE)})
    phase = torch.from_numpy(2.0 + STEP * np.arange(len(positions))) / DURATION
    weights, present = prediction.posterior.components.mean[0], Boundary(pushed.position, pushed.velocity)
    exact = prediction.primitive.rollout(weights, present, 0.2, phase, DURATION).numpy()
    np.testing.assert_allclose(positions, exact, atol=2e-4)
    np.testing.assert_allclose(velocities, np.gradient(exact, STEP, axis=0), atol=8e-3)


@pytest.mark.parametrize("seed", range(4))
def test_commands_never_jump(seed):
    rng, limits = np.random.default_rng(seed), MotionLimits(speed=0.4, acceleration=1.0, deceleration=0.7)
    plans = {
        int(k): (sweep(rng.uniform(-0.5, 0.9), duration=rng.uniform(3.0, 14.0)), SAFE if rng.random() < 0.7 else UNSAFE)
        for k in rng.choice(300, 60, replace=False)
    }
    execution = Execution(limits)
    positions, velocities, _ = run(execution, execution.init(START, 0.0), 10.0, plans)
    assert np.linalg.norm(np.diff(positions, axis=0), axis=-1).max() <= 0.4 * STEP + 1e-9
    assert np.linalg.norm(np.diff(velocities, axis=0), axis=-1).max() <= 1.0 * STEP + 1e-9
    assert np.linalg.norm(velocities, axis=-1).max() > 0.1


def test_what_was_checked_is_what_is_executed():
    execution = Execution(MotionLimits(speed=0.35, acceleration=0.8), tolerance=1e-6)
    state = execution.init(START, time=4.0)
    plan = execution.plan(state, sweep())
    positions, _, _ = run(execution, state, 12.0, {0: (sweep(), SAFE)})
    checked = np.stack([plan.commanded(4.0 + STEP * k)[0] for k in range(len(positions))])
    assert np.linalg.norm(positions - checked, axis=-1).max() < 0.02


def test_a_refused_plan_makes_it_hold_and_a_safe_one_go_on():
    positions, velocities, held = run(
        EXECUTION, EXECUTION.init(START, 0.0), 6.0, {0: (sweep(), SAFE), 150: (sweep(), UNSAFE)}
    )
    assert held.held == "The lip would touch the chair."
    speed = np.linalg.norm(velocities, axis=-1)
    assert speed[150] > 0.2
    rest = 150 + int(np.ceil(speed[150] / 1.0 / STEP))
    assert (speed[rest:] == 0.0).all()
    assert (speed[150:rest] > 0.0).all()
    assert held.at_rest
    assert np.linalg.norm(positions[-1] - positions[150]) == pytest.approx(speed[150] ** 2 / 2.0)
    _, velocities, on = run(EXECUTION, held, 20.0, {0: (sweep(), SAFE)})
    assert on.held is None
    assert on.outcome is not None
    assert on.outcome.kind == "finished"


def test_an_older_safe_plan_is_not_followed_on():
    _, _, state = run(EXECUTION, EXECUTION.init(START, 0.0), 1.0, {0: (sweep(), SAFE), 1: (sweep(), UNSAFE)})
    assert state.plan is not None
    assert state.at_rest


def test_without_a_new_plan_the_last_one_is_followed():
    once, _, _ = run(EXECUTION, EXECUTION.init(START, 0.0), 8.0, {0: (sweep(), SAFE)})
    often, _, _ = run(EXECUTION, EXECUTION.init(START, 0.0), 8.0, {k: (sweep(), SAFE) for k in range(0, 240, 5)})
    np.testing.assert_allclose(once, often, atol=1e-3)


def test_waiting_and_holding_are_made_up_for_along_the_path():
    _, _, waited = run(EXECUTION, EXECUTION.init(START, 0.0), 3.0)
    assert waited.late == pytest.approx(3.0)
    positions, _, state = run(EXECUTION, waited, 3.5, {0: (sweep(0.6), SAFE)})
    assert state.late == pytest.approx(3.0 - 0.6 * 0.5)
    _, _, state = run(EXECUTION, state, 5.5, {0: (sweep(0.6), UNSAFE)})
    assert state.late == pytest.approx(2.7 + 2.0)
    positions, _, state = run(EXECUTION, state, 25.0, {0: (sweep(0.6), SAFE)})
    assert state.outcome is not None
    assert state.outcome.kind == "finished"
    assert positions[:, 2].max() > START[2] + 0.58
    assert state.late < 0.05


def test_what_is_too_fast_in_haste_is_tried_with_less():
    late = dataclasses.replace(EXECUTION.init(START, 6.0), late=6.0)
    plan = EXECUTION.plan(late, sweep())
    rules = SafetyRules(speed=0.38)  # 0.33 m/s at the tempo of the motion
    verdicts = []
    while not verdicts or not verdicts[-1].safe:
        plan = EXECUTION.plan(late, sweep())
        verdicts.append(check_plan(plan, late.command, None, rules, None, torch.Generator()))
        _, late = EXECUTION.step(late, plan, verdicts[-1], late.command.time + STEP)
        assert len(verdicts) < 6
    assert [verdict.too_fast for verdict in verdicts] == [True, True, False]
    assert late.haste == pytest.approx(0.6 / 4)
    assert plan.lateness(plan.time[1]) == pytest.approx(plan.late - 0.15 * (plan.time[1] - plan.time[0]))
    _, unhurt = EXECUTION.step(late, plan, UNSAFE, late.command.time + STEP)
    assert unhurt.haste == late.haste


def test_it_waits_for_the_first_plan():
    positions, _, state = run(EXECUTION, EXECUTION.init(START, 0.0), 3.0)
    np.testing.assert_array_equal(positions, np.tile(START, (len(positions), 1)))
    assert (state.held, state.outcome, state.at_rest) == (None, None, True)


def test_it_finishes_at_the_end_of_the_path_and_stays():
    positions, _, state = run(EXECUTION, EXECUTION.init(START, 0.0), 20.0, {0: (sweep(), SAFE)})
    assert state.outcome is not None
    assert state.outcome.kind == "finished"
    assert 8.0 < state.outcome.time < 11.0
    assert np.linalg.norm(positions[-1] - GOAL) < EXECUTION.tolerance + 0.002
    assert state.at_rest


def test_a_path_that_comes_back_to_its_beginning_is_not_finished_there():
    time, there = path(0.5)
    motion = Trajectory(
        torch.from_numpy(time), torch.from_numpy(np.where(time[:, None] < 5.0, there, there[::-1])), SIGNALS
    )
    execution = Execution(tolerance=0.05)
    _, _, state = run(execution, execution.init(START, 0.0), 0.2, {0: (known_path(motion), SAFE)})
    assert state.outcome is None


def test_where_the_last_plan_was_refused_it_is_not_finished():
    at_goal = EXECUTION.moved(EXECUTION.init(GOAL, 0.0), RobotCommand(12.0, GOAL, np.array([0.0, 0.15, 0.0])))
    positions, _, state = run(EXECUTION, at_goal, 13.0, {0: (sweep(), SAFE), 1: (sweep(), UNSAFE)})
    assert state.at_rest
    assert np.linalg.norm(positions[-1] - GOAL) < EXECUTION.tolerance
    assert state.outcome is None


def test_a_fast_pass_through_the_end_is_not_the_end():
    execution = Execution(slow=1e-3)
    at_goal = execution.moved(execution.init(GOAL, 0.0), RobotCommand(12.0, GOAL, np.array([0.0, 0.3, 0.0])))
    _, _, state = run(execution, at_goal, 12.0 + STEP, {0: (sweep(), SAFE)})
    assert state.outcome is None


@pytest.mark.parametrize(
    ("plans", "kind", "words"),
    [
        ({}, "held", "no plan to follow after 4 s"),
        ({0: (sweep(), UNSAFE)}, "held", "Not safe after 4 s: The lip would touch the chair."),
        ({0: (sweep(), SAFE), 60: (sweep(), UNSAFE)}, "held", "Not safe after 4 s"),
        ({0: (sweep(), SAFE)}, "aborted", "Not at the end after 4 s: up to"),
    ],
)
def test_the_deadline_says_what_was_missing(plans, kind, words):
    execution = Execution(deadline=4.0)
    _, _, before = run(execution, execution.init(START, 1.0), 4.9, plans)
    assert before.outcome is None
    _, velocities, state = run(execution, execution.init(START, 1.0), 7.0, plans)
    assert state.outcome is not None
    assert state.outcome.kind == kind
    assert words in state.outcome.reason
    assert state.outcome.time == pytest.approx(5.0, abs=STEP)
    assert state.at_rest


def test_whoever_watches_can_end_it():
    positions, velocities, state = run(
        EXECUTION, EXECUTION.init(START, 0.0), 8.0, {0: (sweep(), SAFE)}, {149: "The partner left."}
    )
    assert state.outcome is not None
    assert (state.outcome.kind, state.outcome.reason) == ("aborted", "The partner left.")
    assert state.outcome.time == pytest.approx(5.0)
    assert state.at_rest
    assert np.linalg.norm(np.diff(velocities, axis=0), axis=-1).max() <= 2.0 * STEP


def test_after_the_end_no_plan_moves_it():
    _, _, state = run(EXECUTION, EXECUTION.init(START, 0.0), 2.0, {0: (sweep(), SAFE)}, {10: "Enough."})
    ended = state.outcome
    _, velocities, after = run(EXECUTION, state, 4.0, {0: (sweep(), SAFE), 1: (sweep(), UNSAFE)}, {5: "Again."})
    assert after.outcome is ended
    assert (after.plan is state.plan, after.held) == (True, None)
    assert not velocities.any()


def test_a_state_is_not_changed_by_a_step():
    state = EXECUTION.init(START, 0.0)
    plan = EXECUTION.plan(state, sweep())
    first, _ = EXECUTION.step(state, plan, SAFE, 1.0)
    assert (state.plan, state.command.time) == (None, 0.0)
    second, _ = EXECUTION.step(state, plan, SAFE, 1.0)
    np.testing.assert_array_equal(first.position, second.position)
    np.testing.assert_array_equal(state.command.position, START)


def test_wrong_calls_are_refused():
    state = EXECUTION.init(START, 1.0)
    plan = EXECUTION.plan(state, sweep())
    with pytest.raises(InputError, match="together with its verdict"):
        EXECUTION.step(state, plan, None, 1.1)
    with pytest.raises(InputError, match="together with its verdict"):
        EXECUTION.step(state, None, SAFE, 1.1)
    with pytest.raises(InputError, match="plan as Plan"):
        EXECUTION.step(state, sweep(), SAFE, 1.1)  # pyright: ignore[reportArgumentType]
    with pytest.raises(InputError, match="verdict as Verdict"):
        EXECUTION.step(state, plan, True, 1.1)  # pyright: ignore[reportArgumentType]
    for time in (0.9, float("nan"), float("inf")):
        with pytest.raises(InputError, match="not before the last step at 1 s"):
            EXECUTION.step(state, None, None, time)
    with pytest.raises(InputError, match="finite numbers in position"):
        EXECUTION.init([0.0, np.nan, 0.0], 0.0)
    for name in ("deadline", "tolerance", "slow"):
        with pytest.raises(InputError, match=name):
            Execution(**{name: 0.0})

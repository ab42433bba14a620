from __future__ import annotations

import dataclasses

import numpy as np
import pytest
import torch
from execution_world import DURATION, START, path, sweep

from eaip_prob.data.trajectory import Trajectory
from eaip_prob.errors import InputError, ShapeError
from eaip_prob.execution import MotionLimits, RobotCommand, known_path
from eaip_prob.execution.following import free_response
from eaip_prob.execution.plan import attractor_rate, planned
from eaip_prob.gaussian import BlockGaussian, BlockLayout
from eaip_prob.models import Posterior
from eaip_prob.phase import PhaseEstimate
from eaip_prob.primitives import DMP, Boundary, ProMP

LIMITS = MotionLimits()
WIDE = MotionLimits(speed=10.0, acceleration=100.0)
PRESENT = RobotCommand(2.5, START + [0.0, 0.05, 0.1], np.array([0.0, 0.1, -0.05]))


@pytest.mark.parametrize("alpha", [25.0, 40.0])
def test_a_plan_is_the_dmp_s_own_rollout(alpha):
    dmp = DMP(alpha_y=alpha, beta_y=alpha / 4)
    prediction = sweep(primitive=dmp)
    plan = planned(prediction, PRESENT, WIDE)
    weights = prediction.posterior.components.mean[0]
    present = Boundary(PRESENT.position, PRESENT.velocity)
    phase = torch.from_numpy(plan.time) / DURATION
    exact = dmp.rollout(weights, present, 0.25, phase, DURATION)
    np.testing.assert_allclose(plan.path, exact.numpy(), atol=1e-7)
    np.testing.assert_allclose(plan.mean_velocity[:-1], dmp.velocity(weights, phase, DURATION).numpy()[:-1], atol=1e-7)


def test_the_plan_s_velocity_is_that_of_its_path():
    plan = planned(sweep(), PRESENT, WIDE)
    for time in (2.51, 4.0, 7.77):
        slope = (plan.commanded(time + 1e-5)[0] - plan.commanded(time - 1e-5)[0]) / 2e-5
        np.testing.assert_allclose(plan.commanded(time)[1], slope, atol=1e-6)
    np.testing.assert_allclose(plan.commanded(2.5), [PRESENT.position, PRESENT.velocity], atol=1e-9)
    slope = (planned(sweep(), PRESENT, WIDE, 5000).path[1:] - planned(sweep(), PRESENT, WIDE, 5000).path[:-1])[0]
    np.testing.assert_allclose(
        slope / np.diff(planned(sweep(), PRESENT, WIDE, 5000).time)[0], plan.velocity[0], atol=2e-3
    )


def test_between_its_times_a_plan_is_the_predicted_path():
    prediction = sweep()
    plan, at = planned(prediction, PRESENT, WIDE), np.linspace(2.5, 9.9, 77)
    exact = prediction.at(torch.from_numpy(at)).mean.numpy()
    between = np.stack([plan.expected(time)[0] for time in at])
    np.testing.assert_allclose(between, exact, atol=2e-4)
    position, velocity = plan.expected(1e3)
    np.testing.assert_array_equal(position, plan.mean[-1])
    np.testing.assert_array_equal(velocity, 0.0)


def test_promp_follows_the_same_law_and_signals_may_be_in_any_order():
    named = planned(sweep(primitive=ProMP(), names=("z", "x", "y")), PRESENT, WIDE)
    prediction = sweep(primitive=ProMP())
    plain = planned(prediction, PRESENT, WIDE)
    np.testing.assert_allclose(named.path, plain.path, atol=1e-9)
    mean = prediction.at(torch.from_numpy(plain.time)).mean.numpy()
    apart = np.stack([PRESENT.position - mean[0], PRESENT.velocity - plain.mean_velocity[0]])
    exact = mean + free_response(plain.time - 2.5, 25.0 / (2.0 * DURATION))[0] @ apart
    np.testing.assert_allclose(plain.path, exact, atol=1e-12)


def test_a_late_start_catches_up_within_the_limits():
    late = RobotCommand(6.5, START, np.zeros(3))
    limits = MotionLimits(speed=0.3, acceleration=0.8)
    free, plan = planned(sweep(), late, WIDE), planned(sweep(), late, limits)
    assert np.linalg.norm(free.velocity, axis=-1).max() > 0.35
    assert np.linalg.norm(plan.velocity, axis=-1).max() <= 0.3 + 1e-12
    assert limits.keeps(plan.velocity * (1 - 1e-12), plan.time)
    assert np.linalg.norm(plan.path[-1] - path()[1][-1]) < 0.08
    np.testing.assert_array_equal(plan.path[0], START)


def test_hypotheses_about_the_tempo_share_one_clock():
    phase = PhaseEstimate(
        torch.tensor([0.0, 1.0]),
        torch.tensor([[0.0, 0.05], [0.0, 0.01], [0.0, 0.1]]),
        torch.zeros(3),
        torch.tensor([20.0, 100.0, 10.0]),
    )
    one = sweep()
    gaussian = one.posterior.components
    shared = BlockGaussian(
        gaussian.mean.expand(3, -1), gaussian.covariance, BlockLayout({"robot": gaussian.mean.shape[-1]})
    )
    weight = torch.tensor([0.395, 0.005, 0.6]).double().log()
    prediction = dataclasses.replace(one, phase=phase, posterior=Posterior(shared, weight, torch.zeros(()).double()))
    plan = planned(prediction, RobotCommand(1.0, START, np.zeros(3)), WIDE)
    rate = 0.6 / 10.0 + 0.395 / 20.0 + 0.005 / 100.0
    reached = 0.6 * 0.1 + 0.395 * 0.05 + 0.005 * 0.01
    assert plan.time[-1] == pytest.approx(1.0 + (1.0 - reached) / rate)
    assert plan.rate == pytest.approx(12.5 / (0.6 * 10 + 0.395 * 20 + 0.005 * 100))
    one_clock = prediction.in_step().at(torch.from_numpy(plan.time))
    np.testing.assert_allclose(plan.mean, one_clock.mean.numpy(), atol=1e-12)


def test_who_waited_takes_the_whole_path():
    present = RobotCommand(4.0, START, np.zeros(3))
    plan, drawn = planned(sweep(0.6), present, WIDE, late=4.0), planned(sweep(0.6), present, WIDE)
    assert plan.path[:, 2].max() > START[2] + 0.58 > drawn.path[:, 2].max() + 0.05
    assert plan.time[-1] == pytest.approx(DURATION + 4.0)
    at = plan.time - plan.lateness(plan.time)
    np.testing.assert_allclose(plan.mean, sweep(0.6).at(torch.from_numpy(at)).mean.numpy(), atol=1e-12)
    exact = np.gradient(plan.mean, plan.time, axis=0)
    np.testing.assert_allclose(plan.mean_velocity[1:-1], exact[1:-1], atol=0.03)
    for wrong in (-0.1, float("nan"), float("inf")):
        with pytest.raises(InputError, match="late of at least 0"):
            planned(sweep(), present, WIDE, late=wrong)
    with pytest.raises(InputError, match="haste above zero"):
        planned(sweep(), present, WIDE, late=1.0, haste=0.0)


def test_a_plan_after_the_end_leads_to_the_goal():
    goal = path()[1][-1]
    plan = planned(sweep(), RobotCommand(14.0, goal + [0.0, 0.0, 0.2], np.zeros(3)), WIDE)
    np.testing.assert_allclose(plan.path[-1], goal, atol=0.2 * 0.02)
    assert plan.time[-1] == pytest.approx(14.0 + 6.0 / plan.rate)


def test_distance_left_is_to_the_farthest_point_of_the_rest():
    plan = planned(sweep(), RobotCommand(0.0, START, np.zeros(3)), WIDE)
    goal = plan.mean[-1]
    assert plan.distance_left(goal, 11.0) == 0.0
    assert plan.distance_left(goal, 0.0) == pytest.approx(np.linalg.norm(plan.mean - goal, axis=-1).max())
    assert plan.distance_left(START, 5.0) == pytest.approx(np.linalg.norm(goal - START), abs=1e-3)


@pytest.mark.parametrize("missing", ["x", "y", "z"])
def test_a_prediction_of_other_signals_is_refused(missing):
    names = tuple(name if name != missing else "grip" for name in ("x", "y", "z"))
    time, positions = path()
    other = known_path(Trajectory(torch.from_numpy(time), torch.from_numpy(positions), names))
    with pytest.raises(InputError, match=r"signals \('x', 'y', 'z'\).*grip"):
        planned(other, PRESENT, LIMITS)


def test_batches_nan_and_single_times_are_refused():
    one = sweep()
    batch = dataclasses.replace(one.posterior, log_weight=torch.zeros(2, 1).double())
    with pytest.raises(ShapeError, match=r"one motion, got a batch \(2,\)"):
        planned(dataclasses.replace(one, posterior=batch), PRESENT, LIMITS)
    with pytest.raises(InputError, match="num_times"):
        planned(one, PRESENT, LIMITS, num_times=1)
    with pytest.raises(InputError, match="prediction as Prediction, got str"):
        planned("path", PRESENT, LIMITS)  # pyright: ignore[reportArgumentType]
    broken = BlockGaussian(
        one.posterior.components.mean, one.posterior.components.covariance, one.posterior.components.layout
    )
    object.__setattr__(broken, "mean", broken.mean * float("nan"))
    with pytest.raises(InputError, match="finite numbers in the predicted path"):
        planned(
            dataclasses.replace(one, posterior=dataclasses.replace(one.posterior, components=broken)), PRESENT, LIMITS
        )


@pytest.mark.parametrize("name", ["position", "velocity"])
def test_a_command_has_three_finite_numbers(name):
    good = {"position": np.zeros(3), "velocity": np.zeros(3)}
    with pytest.raises(ShapeError, match=f"{name} with shape"):
        RobotCommand(0.0, **good | {name: np.zeros(2)})
    with pytest.raises(InputError, match=f"finite numbers in {name}"):
        RobotCommand(0.0, **good | {name: np.array([0.0, np.nan, 0.0])})
    with pytest.raises(InputError, match="finite numbers in time"):
        RobotCommand(float("nan"), **good)


def test_a_known_path_displaces_whole_signals():
    for primitive in (DMP(), ProMP()):
        prediction = sweep(std=(0.0, 0.02, 0.05), primitive=primitive)
        np.testing.assert_allclose(prediction.mean.numpy(), path()[1], atol=5e-3)
        deviation = prediction.variance.sqrt().numpy()
        np.testing.assert_allclose(deviation, np.broadcast_to([0.0, 0.02, 0.05], deviation.shape), atol=1e-3)
        drawn = prediction.sample(3, torch.Generator().manual_seed(0)).numpy() - prediction.mean.numpy()
        np.testing.assert_allclose(drawn.std(1), 0.0, atol=1e-3)


def test_a_known_path_refuses_what_it_cannot_hold():
    time, positions = path()
    motion = Trajectory(torch.from_numpy(time), torch.from_numpy(positions))
    with pytest.raises(InputError, match="weights hold the start"):
        known_path(motion, primitive=DMP(boundary="given"))
    with pytest.raises(InputError, match="std of at least 0"):
        known_path(motion, -0.1)
    with pytest.raises(ShapeError, match="std as one number or 3"):
        known_path(motion, (0.1, 0.1))
    with pytest.raises(InputError, match="finite numbers in std"):
        known_path(motion, float("nan"))
    with pytest.raises(ShapeError, match="one motion"):
        known_path(Trajectory(motion.time, motion.values[None]))


def test_the_rate_is_that_of_the_dmp():
    assert attractor_rate(sweep(primitive=DMP(alpha_y=40.0, beta_y=10.0))) == pytest.approx(40.0 / 2.0 / DURATION)
    assert attractor_rate(sweep(duration=5.0, primitive=ProMP())) == pytest.approx(2.5)

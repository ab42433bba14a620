from __future__ import annotations

import dataclasses

import numpy as np
import pytest
import torch
from selection_world import BASIS, FIXED, demonstrations, fit, predictor

from eaip_prob.data.demonstrations import Demonstration, DemonstrationSet
from eaip_prob.data.environment import EnvironmentFeatures
from eaip_prob.data.features import QuadraticFeatures, RawFeatures
from eaip_prob.data.trajectory import Trajectory
from eaip_prob.evidence import PositionEvidence
from eaip_prob.folds import group_folds
from eaip_prob.held_out import HeldOut, LeftOut, folds_of
from eaip_prob.models import GaussianJointModel
from eaip_prob.phase import AbstractPhaseEstimator, ElapsedClock, ExpectedClock, MarginalClock
from eaip_prob.primitives import DMP
from eaip_prob.training import Fitted, Recipe

NOISE = torch.tensor([0.3], dtype=torch.float64), torch.tensor([5.0], dtype=torch.float64)


def parts(motions: DemonstrationSet, clock: AbstractPhaseEstimator) -> list[HeldOut]:
    recipe = Recipe("robot", PositionEvidence(), clock, {"human": BASIS, "robot": DMP(num_basis=5)}, None)
    folds = folds_of(motions, recipe, group_folds(motions.groups), alike=True)
    return [fold.with_features(QuadraticFeatures()).with_model(GaussianJointModel(FIXED), NOISE) for fold in folds]


def disturbed(one: Demonstration) -> Demonstration:
    """Another motion, three times as long, in another scene."""
    assert one.human is not None and one.robot is not None and one.environment is not None
    human, robot = (
        dataclasses.replace(each, time=3.0 * each.time, values=7.0 - 2.0 * each.values)
        for each in (one.human, one.robot)
    )
    return Demonstration(human, robot, EnvironmentFeatures(("width",), 900.0 + 3.0 * one.environment.value))


def knowledge(fitted: Fitted) -> list[torch.Tensor]:
    scenes, features = fitted.scenes, fitted.features
    assert scenes is not None and isinstance(features, QuadraticFeatures) and features.mean is not None
    prior = fitted.model.prior
    durations = fitted.phase.estimate(Trajectory([0.0, 0.1], [[0.0], [0.0]])).duration
    learnt = [prior.mean, prior.covariance, fitted.residual, fitted.boundary.start, features.mean, durations]
    numbers = [fitted.step, fitted.phase.limit, fitted.primitives["robot"].limit, float(scenes.num_scenes)]
    return [*learnt, scenes.low, scenes.high, torch.tensor(numbers)]


@pytest.mark.parametrize("clock", [ElapsedClock(), MarginalClock(num_durations=4), ExpectedClock()])
def test_nothing_of_a_left_out_group_reaches_its_fold(clock: AbstractPhaseEstimator) -> None:
    motions = demonstrations(18, groups=3, tempo=0.15)
    other = DemonstrationSet(
        [disturbed(m) if g == 1 else m for m, g in zip(motions, motions.groups, strict=True)], motions.groups
    )
    before, after = parts(motions, clock), parts(other, clock)
    assert len(before) == 3
    for place, (one, two) in enumerate(zip(before, after, strict=True)):
        alike = [torch.equal(a, b) for a, b in zip(knowledge(one.fitted), knowledge(two.fitted), strict=True)]
        assert all(alike) if place == 1 else not all(alike[:2])
        assert set(one.left_out.groups) == {place}


@pytest.mark.parametrize("num", [9, 32, 33, 77])
def test_at_most_thirty_two_motions_evenly_over_a_fold(num: int) -> None:
    motions = demonstrations(num + 2, groups=1)
    fold = torch.arange(2, num + 2)
    left_out = LeftOut.of(motions, "robot", fold)
    assert left_out is not None and left_out.environment is not None
    places = [int(p) for p in np.linspace(2, num + 1, min(num, 32)).round()]
    assert len(set(places)) == min(num, 32)
    torch.testing.assert_close(left_out.human.values, motions.trajectories("human").values[places])
    assert motions.environments is not None
    torch.testing.assert_close(left_out.environment.value, motions.environments.value[places])
    assert len(left_out.groups) == len(places)


def test_motions_whose_scene_was_missed_are_not_held_out_with_it() -> None:
    motions = demonstrations(12, groups=2)
    part = [
        dataclasses.replace(one, environment=EnvironmentFeatures.unseen(("width",)) if i in (1, 4) else one.environment)
        for i, one in enumerate(motions)
    ]
    left_out = LeftOut.of(DemonstrationSet(part, motions.groups), "robot", torch.arange(6))
    assert left_out is not None
    torch.testing.assert_close(left_out.human.values, motions.trajectories("human").values[[0, 2, 3, 5]])
    assert LeftOut.of(DemonstrationSet(part, motions.groups), "robot", torch.tensor([1, 4])) is None


def slow_gate(motions: DemonstrationSet) -> tuple[float, float, float, float]:
    """(slope, its standard error, gate, share explained) of what the scene alone predicts, motion by motion."""
    labels = sorted(set(motions.groups))
    robots, scene = motions.trajectories("robot").values.numpy(), motions.environments
    assert scene is not None
    feature = scene.value.numpy()[:, 0]
    phase = torch.linspace(0, 1, robots.shape[1], dtype=torch.float64)
    weights = [BASIS.encode(motions.trajectories(agent), phase, 1.0) for agent in ("human", "robot")]
    rows = torch.cat([*weights, scene.value], -1)
    matrix = BASIS.design(phase)[0].numpy()
    sums = []
    for label in labels:
        out = [i for i, group in enumerate(motions.groups) if group == label]
        kept = rows[[i for i in range(len(motions)) if i not in out]]
        covariance = FIXED.estimate(kept, [], torch.arange(4, 12), torch.tensor([12])).numpy()
        mean = kept.mean(0).numpy()
        before = matrix @ mean[4:12].reshape(2, 4).T
        truth, moved = [], []
        for i in out:
            shift = covariance[4:12, 12] / (covariance[12, 12] + 25.0) * (feature[i] - mean[12])
            truth.append(robots[i] - before)
            moved.append(matrix @ shift.reshape(2, 4).T)
        unit = np.sqrt(np.mean(np.square(truth), (0, 1)))
        t, m = np.array(truth) / unit, np.array(moved) / unit
        sums.append([(t * m).sum(), (m * m).sum(), (t * t).sum()])
    product, power, total = np.array(sums).T
    slope, num = product.sum() / power.sum(), len(labels)
    without = [(product.sum() - product[k]) / (power.sum() - power[k]) for k in range(num)]
    error = np.sqrt((num - 1) / num * np.sum((without - np.mean(without)) ** 2))
    share = min(slope, 1.0)
    gains = (total - 2 * product + power) - (total - 2 * share * product + share**2 * power)
    # Four groups leave three degrees of freedom: a t variable has the variance 3.
    certain = gains.mean() ** 2 / (gains.mean() ** 2 + 3.0 * gains.var(ddof=1) / num) if share < 1.0 else 0.0
    gate = 1.0 + (share - 1.0) * certain
    left = 1.0 - (total.sum() - 2 * gate * product.sum() + gate**2 * power.sum()) / total.sum()
    return float(slope), float(error), float(gate), float(left)


@pytest.mark.parametrize("separate", [False, True])
@pytest.mark.parametrize(("num", "seed", "is_open"), [(30, 1, False), (24, 2, True)])
def test_gate_is_the_slope_of_left_out_motions_on_what_the_scene_predicts(
    num: int, seed: int, is_open: bool, separate: bool
) -> None:
    motions = demonstrations(num, seed=seed, groups=4)
    fitted = fit(motions, noise=0.3, environment_noise=5.0, gate=True, separate=separate, recalibrate=False)
    slope, error, gate, explained = slow_gate(motions)
    np.testing.assert_allclose(fitted.gate.estimate, slope, rtol=1e-6)
    np.testing.assert_allclose(fitted.gate.error, error, rtol=1e-6)
    assert (slope > error and explained > 0.005) == is_open
    np.testing.assert_allclose(fitted.gate.value, gate * is_open, rtol=1e-6)
    np.testing.assert_allclose(fitted.gate.explained, explained * is_open, rtol=1e-6)


def bent(motions: DemonstrationSet, seed: int) -> DemonstrationSet:
    """The robot goes as far as the square of the width says."""
    generator = torch.Generator().manual_seed(seed)
    made = []
    for one in motions:
        assert one.robot is not None and one.environment is not None
        width = torch.randn(1, generator=generator, dtype=torch.float64)
        way = 8.0 * (width.square() - 1.0) * torch.linspace(0, 1, one.robot.num_samples)[:, None]
        robot = dataclasses.replace(one.robot, values=one.robot.values + way)
        made.append(Demonstration(one.human, robot, EnvironmentFeatures(("width",), 100.0 + 20.0 * width)))
    return DemonstrationSet(made, motions.groups)


def test_features_are_those_that_predict_left_out_groups() -> None:
    maps = (RawFeatures(), QuadraticFeatures())
    given = {"noise": 0.3, "environment_noise": 1.0, "features": maps, "separate": True}
    motions = demonstrations(24, groups=4)
    chosen = fit(bent(motions, 5), **given)
    assert isinstance(chosen.features, QuadraticFeatures) and chosen.features.names == ("width", "width^2")
    assert chosen.alone is not None and chosen.alone.features is None
    # Where all maps say the same, the first: width is 0 or 1, of which the square is no news.
    two = [
        dataclasses.replace(one, environment=EnvironmentFeatures(("width",), [float(i % 2)]))
        for i, one in enumerate(motions)
    ]
    for order in (maps, maps[::-1]):
        model = predictor(**given | {"features": order, "environment_noise": 0.1}).fit(
            DemonstrationSet(two, motions.groups)
        )
        assert model.fitted is not None and type(model.fitted.features) is type(order[0])


def test_a_clock_that_lives_by_the_scene_has_no_part_without_one() -> None:
    given = {"noise": 0.3, "environment_noise": 5.0, "separate": True}
    motions = demonstrations(18, groups=3, tempo=0.15)
    fitted = fit(motions, phase=(ExpectedClock(), ElapsedClock()), **given)
    assert fitted.alone is not None and isinstance(fitted.alone.phase, ElapsedClock)

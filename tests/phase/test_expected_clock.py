from __future__ import annotations

import math

import numpy as np
import pytest
import torch
from hydra import compose, initialize_config_dir

from eaip_prob.config import build, conf_dir
from eaip_prob.data import (
    Demonstration,
    DemonstrationSet,
    DistanceFeatures,
    EnvironmentFeatures,
    QuadraticFeatures,
    RawFeatures,
    Trajectory,
)
from eaip_prob.errors import InputError, NotFittedError, ShapeError
from eaip_prob.phase import ElapsedClock, ExpectedClock, MarginalClock
from eaip_prob.phase.log_duration import HeldOut, LogDurationRegression
from eaip_prob.tasks.passing_over import PassingOver

NAMES = ("x", "y", "size")
UNITS = torch.tensor([0.4, 0.2, 30.0], dtype=torch.float64)
MEANS = torch.tensor([0.7, -0.3, 90.0], dtype=torch.float64)


def normal(*shape, seed):
    return torch.randn(*shape, generator=torch.Generator().manual_seed(seed), dtype=torch.float64)


def linear(z):
    return 0.4 + 0.3 * z[:, 0] - 0.2 * z[:, 2]


def quadratic(z):
    return 0.4 + 0.2 * z[:, 0].square() + 0.15 * z[:, 0] * z[:, 1] - 0.1 * z[:, 2]


def data(law, num=150, noise=0.05, seed=0, num_groups=10, shuffled=False, observed=None, units=UNITS, robot=None):
    z = normal(num, 3, seed=seed)
    log_duration = law(z) + noise * normal(num, seed=seed + 1)
    order = torch.randperm(num, generator=torch.Generator().manual_seed(seed + 2)) if shuffled else torch.arange(num)
    mask = torch.ones(num, 3, dtype=torch.bool) if observed is None else observed
    values = ((z + MEANS / UNITS) * units)[order]
    demonstrations = [
        Demonstration(
            Trajectory([2.0, 2.0 + float(T)], [[0.0], [1.0]]),
            environment=EnvironmentFeatures(NAMES, value, observed=seen),
        )
        for T, value, seen in zip(log_duration.exp(), values, mask, strict=True)
    ]
    return DemonstrationSet(demonstrations, [i % num_groups for i in range(num)])


def durations(demonstrations):
    return demonstrations.trajectories("human").duration


def constant(demonstrations):
    return ElapsedClock().fit(demonstrations, "human").duration


def expected(clock, environment):
    seen = Trajectory([1.0, 1.5], torch.zeros(*environment.value.shape[:-1], 2, 1))
    return clock.estimate(seen, environment).duration[..., 0]


@pytest.mark.parametrize(("law", "features"), [(linear, RawFeatures), (quadratic, QuadraticFeatures)])
def test_a_known_law_is_recovered_with_its_own_features(law, features):
    clock = ExpectedClock().fit(data(law, seed=20), "human")
    assert isinstance(clock.chosen, features)
    assert clock.slope > 0.95 and clock.explained > 0.95
    z = normal(30, 3, seed=5).clamp(-1.5, 1.5)
    error = expected(clock, EnvironmentFeatures(NAMES, z * UNITS + MEANS)).log() - law(z)
    assert float(error.square().mean()) < 0.03**2


def test_the_phase_is_time_since_the_first_sample_over_the_expectation():
    clock = ExpectedClock().fit(data(linear), "human")
    scene = EnvironmentFeatures(NAMES, MEANS + UNITS * torch.tensor([1.0, 0.0, 0.0]))
    seen = Trajectory([1.0, 1.5, 3.0], torch.zeros(3, 2))
    for phase in (clock.estimate(seen, scene), clock.encoding(seen, scene)):
        assert phase.paths.shape == (1, 3)
        torch.testing.assert_close(phase.paths[0], torch.tensor([0.0, 0.5, 2.0]).double() / phase.duration)
        assert float(phase.duration) == pytest.approx(math.exp(0.7), rel=0.05)


def test_a_shuffled_environment_leaves_the_constant_clock_or_costs_next_to_nothing():
    gated, ungated, closed = [], [], 0
    for seed in range(20):
        demonstrations = data(linear, num=100, shuffled=True, seed=10 * seed)
        clock = ExpectedClock().fit(demonstrations, "human")
        scenes = EnvironmentFeatures(NAMES, MEANS + UNITS * normal(200, 3, seed=seed))
        gated.append(float((expected(clock, scenes).log() - clock.mean).square().mean()))
        ungated.append(float((clock.regression.expectation(scenes) - clock.mean).square().mean()))
        if clock.slope == 0.0:
            closed += 1
            assert expected(clock, scenes).tolist() == pytest.approx([constant(demonstrations)] * 200, rel=1e-14)
    assert closed >= 14
    assert np.mean(gated) < 0.3 * np.mean(ungated)
    assert np.mean(gated) < 0.015 * (0.3**2 + 0.2**2)  # the variance of log T


def test_a_tempo_that_is_independent_of_the_object_explains_nothing():
    spreads = []
    for seed in range(3):
        clock = ExpectedClock().fit(PassingOver().demonstrations(8, seed), "human")
        sizes = EnvironmentFeatures(("width", "height"), [[125.0, 125.0], [325.0, 325.0]])
        spreads.append(float(expected(clock, sizes).log().diff()))
    assert np.mean(np.abs(spreads)) < 0.03


def test_one_group_earns_no_slope():
    demonstrations = data(quadratic, num_groups=1)
    clock = ExpectedClock().fit(demonstrations, "human")
    assert clock.slope == 0.0 and isinstance(clock.chosen, RawFeatures)
    assert expected(clock, demonstrations[3].environment) == pytest.approx(constant(demonstrations))


def test_nothing_seen_is_the_constant_clock_for_each_member():
    demonstrations = data(linear)
    clock = ExpectedClock().fit(demonstrations, "human")
    value = (MEANS + UNITS).expand(2, 3)
    mask = torch.tensor([[False] * 3, [True] * 3])
    mixed = expected(clock, EnvironmentFeatures(NAMES, value, observed=mask))
    seen = Trajectory([1.0, 1.5], torch.zeros(2, 1))
    assert float(mixed[0]) == float(clock.estimate(seen).duration) == pytest.approx(constant(demonstrations))
    assert float(mixed[1]) != pytest.approx(float(mixed[0]), rel=0.02)
    assert clock.estimate(seen).paths.shape == (1, 2)


@pytest.mark.parametrize("shown", [(True, False, True), (False, True, False), (True, True, True)])
@pytest.mark.parametrize("sensor", [0.0, 0.6])
def test_what_is_not_observed_is_marginalised(shown, sensor):
    demonstrations = data(linear, noise=0.3)
    clock = ExpectedClock(RawFeatures(), ridge=0.02).fit(demonstrations, "human")
    environments, log_duration = demonstrations.environments, durations(demonstrations).log().numpy()
    scene = (MEANS + UNITS * torch.tensor([0.5, -1.0, 0.3])).numpy()
    root = UNITS[:, None].numpy() * sensor * normal(3, 3, seed=3).numpy()
    at = np.flatnonzero(shown)
    rows = environments.value.numpy()[:, at]
    sample = np.cov(rows.T, bias=True).reshape(len(at), len(at))
    cross = (rows - rows.mean(0)).T @ (log_duration - log_duration.mean()) / len(rows)
    matrix = sample + 0.02 * np.diag(np.diag(sample)) + (root @ root.T)[np.ix_(at, at)]
    deviation = np.linalg.inv(matrix) @ cross @ (scene[at] - rows.mean(0))
    wanted = np.exp(log_duration.mean() + clock.slope * deviation)
    observed = EnvironmentFeatures(NAMES, scene, root @ root.T, torch.tensor(shown))
    assert float(expected(clock, observed)) == pytest.approx(wanted, rel=1e-9)


def test_a_noisy_sensor_pulls_the_expectation_to_the_mean():
    clock = ExpectedClock(RawFeatures()).fit(data(linear), "human")
    value = MEANS + UNITS * torch.tensor([1.0, 0.0, -1.0])
    exact, noisy, useless = (
        float(expected(clock, EnvironmentFeatures(NAMES, value, torch.diag(UNITS.square()) * size)).log())
        for size in (0.0, 1.0, 1e8)
    )
    mean = clock.mean
    assert noisy - mean == pytest.approx((exact - mean) / 2, rel=0.1)
    assert useless == pytest.approx(mean, abs=1e-6)


@pytest.mark.parametrize("sensor", [0.0, 0.3])
def test_a_batch_is_its_members(sensor):
    clock = ExpectedClock().fit(data(quadratic), "human")
    mask = torch.rand(2, 3, 3, generator=torch.Generator().manual_seed(1)) > 0.4
    mask[0, 0] = False
    covariance = torch.diag((sensor * UNITS).square())
    scenes = EnvironmentFeatures(NAMES, MEANS + UNITS * normal(2, 3, 3, seed=4), covariance, mask)
    together = expected(clock, scenes)
    for i in range(2):
        for j in range(3):
            assert float(expected(clock, scenes[i][j])) == pytest.approx(float(together[i, j]), rel=1e-12)
    shared = clock.estimate(Trajectory([0.0, 1.0], torch.zeros(4, 2, 1)), scenes[1][1])
    assert shared.paths.shape[-1] == 2 and shared.paths.numel() == 2


@pytest.mark.parametrize("sensor", [0.0, 0.3])
def test_units_do_not_matter(sensor):
    factor = torch.tensor([1000.0, 0.01, 3.0], dtype=torch.float64)
    one = ExpectedClock().fit(data(quadratic), "human")
    other = ExpectedClock().fit(data(quadratic, units=UNITS * factor), "human")
    value, covariance = MEANS + UNITS * normal(5, 3, seed=6), torch.diag((sensor * UNITS).square())
    mask = torch.rand(5, 3, generator=torch.Generator().manual_seed(2)) > 0.3
    first = expected(one, EnvironmentFeatures(NAMES, value, covariance, mask))
    scaled = covariance * factor[:, None] * factor
    second = expected(other, EnvironmentFeatures(NAMES, value * factor, scaled, mask))
    torch.testing.assert_close(first, second, rtol=1e-9, atol=0.0)


def test_far_environments_give_no_hours():
    demonstrations = data(linear)
    clock = ExpectedClock(RawFeatures()).fit(demonstrations, "human")
    far = EnvironmentFeatures(NAMES, MEANS + UNITS * torch.tensor([[200.0, 0.0, 0.0], [-200.0, 0.0, 0.0]]))
    shortest, longest = durations(demonstrations).min(), durations(demonstrations).max()
    assert clock.slope > 0.97
    bounds = torch.stack([2.0 * longest, shortest / 2.0]).log()
    mean = clock.mean
    torch.testing.assert_close(expected(clock, far).log(), mean + clock.slope * (bounds - mean))


def test_the_limit_is_the_longest_demonstration_on_the_clock():
    demonstrations = data(linear, noise=0.2)
    clock = ExpectedClock().fit(demonstrations, "human")
    ratio = durations(demonstrations) / expected(clock, demonstrations.environments)
    assert clock.limit == pytest.approx(float(ratio.max()))
    assert 1.2 < clock.limit < 2.0
    even = DemonstrationSet([Demonstration(Trajectory([0.0, 2.0], torch.zeros(2, 1)))] * 3)
    assert ExpectedClock().fit(even, "human").limit == 1.0


def test_without_environments_it_is_the_constant_clock():
    timed = data(linear)
    bare = DemonstrationSet([Demonstration(each.human) for each in timed], timed.groups)
    clock = ExpectedClock().fit(bare, "human")
    assert clock.chosen is None and clock.slope == 0.0
    unknown = EnvironmentFeatures(("anything",), [[1.0], [2.0]])
    assert expected(clock, unknown).tolist() == pytest.approx([constant(bare)] * 2)


def test_wholly_unobserved_demonstrations_count_for_the_mean_only():
    seen = torch.ones(150, 3, dtype=torch.bool)
    seen[100:] = False
    whole, part = data(linear), data(linear, observed=seen)
    clock = ExpectedClock(RawFeatures()).fit(part, "human")
    only = ExpectedClock(RawFeatures()).fit(whole.subset(range(100)), "human")
    assert clock.mean == pytest.approx(math.log(constant(whole)))
    torch.testing.assert_close(clock.regression.coefficient, only.regression.coefficient)
    assert clock.slope == only.slope
    assert float(expected(clock, EnvironmentFeatures.unseen(NAMES))) == pytest.approx(constant(whole), rel=1e-14)
    nothing = data(linear, observed=torch.zeros(150, 3, dtype=torch.bool))
    assert ExpectedClock().fit(nothing, "human").chosen is None


def test_partly_observed_demonstrations_do_not_bias_the_regression():
    def law(z):  # x and the size are correlated: a mean in the place of what is missing would bias both slopes
        return 0.3 * z[:, 0] - 0.2 * z[:, 2]

    z = normal(10_000, 3, seed=0)
    z[:, 2] = 0.8 * z[:, 0] + 0.6 * z[:, 2]
    mask = torch.rand(10_000, 3, generator=torch.Generator().manual_seed(1)) > 0.4
    mask[:, 1] = True
    environment = EnvironmentFeatures(NAMES, z * UNITS + MEANS, observed=mask)
    fitted = LogDurationRegression.fit(RawFeatures(), environment, law(z) + 0.3 * normal(10_000, seed=2), 1e-5)
    slopes = fitted.coefficient * UNITS
    torch.testing.assert_close(slopes, torch.tensor([0.3, 0.0, -0.2]).double(), rtol=0.0, atol=0.03)


def test_features_that_never_vary_or_were_never_seen_say_nothing():
    demonstrations = data(linear)
    scenes = demonstrations.environments
    value, mask = scenes.value.clone(), scenes.observed.clone()
    value[:, 1], mask[:, 2] = 0.1, False
    log_duration = durations(demonstrations).log()
    fitted = LogDurationRegression.fit(
        QuadraticFeatures(), EnvironmentFeatures(NAMES, value, observed=mask), log_duration, 1e-3
    )
    new = EnvironmentFeatures(NAMES, value[:3] + torch.tensor([0.0, 50.0, 0.0]))
    same = EnvironmentFeatures(NAMES, value[:3], observed=mask[:3])
    torch.testing.assert_close(fitted.expectation(new), fitted.expectation(same))
    assert float(fitted.expectation(same).std()) > 0.01


def test_the_slope_is_that_of_groups_left_out():
    predicted, group = normal(400, seed=0), torch.arange(400) % 8
    true = 0.6 * predicted + 0.5 * normal(400, seed=1)
    slope = HeldOut(predicted, true, group).slope()
    estimate = float(predicted @ true / (predicted @ predicted))
    assert slope.estimate == pytest.approx(estimate)
    saved = true.square() - (true - estimate * predicted).square()
    gains = torch.stack([saved[group == label].sum() for label in range(8)])
    # Eight groups leave seven degrees of freedom: a t variable has the variance 7 / 5.
    certain = float(gains.mean() ** 2 / (gains.mean() ** 2 + 1.4 * gains.var() / 8))
    assert slope.value == pytest.approx(estimate * certain)
    left = (true - slope.value * predicted).square().sum() / true.square().sum()
    assert slope.explained == pytest.approx(1.0 - float(left))
    ratios = [
        predicted[group != left] @ true[group != left] / predicted[group != left].square().sum() for left in range(8)
    ]
    assert slope.error == pytest.approx(float(torch.stack(ratios).std(correction=0)) * math.sqrt(7))
    assert HeldOut(predicted, true, torch.zeros(400, dtype=torch.int64)).slope().value == 0.0


def test_fitting_changes_nothing_in_place_and_the_agent_named_is_timed():
    clock, demonstrations = ExpectedClock(), data(linear)
    both = DemonstrationSet(
        [
            Demonstration(each.human, Trajectory(each.human.time * 3.0, each.human.values), each.environment)
            for each in demonstrations
        ],
        demonstrations.groups,
    )
    fitted = clock.fit(both, "robot")
    assert clock.mean is None and clock.limit == 1.0
    assert fitted.mean == pytest.approx(math.log(3.0 * constant(demonstrations)))
    assert fitted.fit(demonstrations, "human").mean == pytest.approx(math.log(constant(demonstrations)))


def test_other_feature_maps_can_compete():
    def distance(z):
        return 0.5 * ((z + MEANS / UNITS) * UNITS)[:, :2].norm(dim=1).log()

    maps = [RawFeatures(), DistanceFeatures(["x", "y"])]
    clock = ExpectedClock(maps).fit(data(distance, noise=0.02), "human")
    assert isinstance(clock.chosen, DistanceFeatures) and clock.explained > 0.9


def test_refusals():
    with pytest.raises(NotFittedError, match="fitted ExpectedClock"):
        ExpectedClock().estimate(Trajectory([0.0, 1.0], torch.zeros(2, 1)))
    with pytest.raises(InputError, match="at least one feature map"):
        ExpectedClock([])
    with pytest.raises(InputError, match="AbstractFeatureMap, got str"):
        ExpectedClock(["raw"])
    with pytest.raises(InputError, match="ridge above zero"):
        ExpectedClock(ridge=0.0)
    clock = ExpectedClock().fit(data(linear, num=20), "human")
    with pytest.raises(InputError, match="Expected environment features"):
        expected(clock, EnvironmentFeatures(("x", "y"), [1.0, 2.0]))
    with pytest.raises(ShapeError, match="one environment for all motions"):
        clock.estimate(Trajectory([0.0, 1.0], torch.zeros(3, 2, 1)), EnvironmentFeatures(NAMES, torch.ones(2, 3)))


@pytest.mark.parametrize("clock", [ExpectedClock(), ElapsedClock(), MarginalClock()])
@pytest.mark.parametrize(("wrong", "said"), [(3600.0, r"3\.6e\+03 s"), (0.002, r"0\.002 s")])
def test_a_recording_that_was_not_stopped_is_refused_by_number(clock, wrong, said):
    motions = [Trajectory([0.0, T], torch.zeros(2, 1)) for T in (1.0, 1.5, wrong, 1.2)]
    with pytest.raises(InputError, match=rf"got {said} for motion \(2,\) at a median of 1\.\d+ s: |Cut or leave out"):
        clock.fit(DemonstrationSet([Demonstration(motion) for motion in motions]), "human")


def test_only_this_clock_uses_the_environment():
    assert isinstance(ExpectedClock().without_environment(), ElapsedClock)


@pytest.mark.parametrize("name", ["phase/expected", "phase/absolute", "features/raw", "features/quadratic"])
def test_configurations(name):
    with initialize_config_dir(str(conf_dir()), version_base=None):
        cfg = compose(name)
        part = compose("features/distance", ["predictor.features.offsets=[x,y]"]).predictor.features
    kinds = {"expected": ExpectedClock, "absolute": ElapsedClock, "raw": RawFeatures, "quadratic": QuadraticFeatures}
    folder, option = name.split("/")
    assert type(build(cfg.predictor[folder])) is kinds[option]
    assert build(part).offsets == ("x", "y")

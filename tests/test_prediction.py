from __future__ import annotations

import dataclasses
from collections.abc import Callable

import numpy as np
import pytest
import torch

from eaip_prob.data.demonstrations import Demonstration, DemonstrationSet
from eaip_prob.data.environment import EnvironmentFeatures
from eaip_prob.data.trajectory import Trajectory
from eaip_prob.encoding import encode
from eaip_prob.errors import InputError, NotFittedError
from eaip_prob.evidence import ForcingEvidence
from eaip_prob.models import EmpiricalCovariance, GaussianJointModel
from eaip_prob.observation import LinearObservation
from eaip_prob.phase import DTWClock, ElapsedClock, KnownPhase, MarginalClock, known_phase
from eaip_prob.prediction import InteractionPredictor
from eaip_prob.primitives import DMP, AbstractPrimitive, ProMP, initial_boundary

HUMAN, ROBOT = ProMP(num_basis=5), ProMP(num_basis=4)
SIZES = (5, 8, 2)
DURATION, SAMPLES, SENSOR = 2.5, 30, 0.005
Make = Callable[[Demonstration], Demonstration]


def world() -> tuple[torch.Tensor, torch.Tensor]:
    """(mean, root of the covariance) of [human, robot, features]: robot = linear(human, scene) + own."""
    generator = torch.Generator().manual_seed(11)
    root = torch.zeros(15, 15, dtype=torch.float64)
    human, scene = slice(0, 5), slice(13, 15)
    root[human, human] = torch.randn(5, 5, generator=generator, dtype=torch.float64)
    root[scene, scene] = torch.tensor([[1.0, 0.0], [0.0, 20.0]])
    root[scene, human] = torch.randn(2, 5, generator=generator, dtype=torch.float64) * torch.tensor([[0.3], [8.0]])
    root[5:13, human] = 2.0 * torch.randn(8, 5, generator=generator, dtype=torch.float64)
    root[5:13, scene] = 1.5 * torch.randn(8, 2, generator=generator, dtype=torch.float64)
    root[5:13, 5:13] = 0.4 * torch.eye(8, dtype=torch.float64)
    mean = torch.cat([torch.arange(5.0), 5.0 - torch.arange(8.0), torch.tensor([3.0, 200.0])]).double()
    return mean, root


def demonstrations(num: int, seed: int = 0, groups: int | None = 3, ragged: bool = False) -> DemonstrationSet:
    generator = torch.Generator().manual_seed(seed)
    mean, root = world()
    weights = mean + torch.randn(num, 15, generator=generator, dtype=torch.float64) @ root.mT
    length = torch.exp(0.15 * ragged * torch.randn(num, generator=generator, dtype=torch.float64))
    noise = SENSOR * torch.randn(num, SAMPLES, 1, generator=generator, dtype=torch.float64)
    result = []
    phase = torch.linspace(0, 1, SAMPLES, dtype=torch.float64)
    for i in range(num):
        time = phase * DURATION * length[i]
        human = HUMAN.decode(weights[i, :5], phase) + noise[i]
        scene = EnvironmentFeatures(("width", "height"), weights[i, 13:])
        robot = Trajectory(time, ROBOT.decode(weights[i, 5:13], phase), ("u", "v"))
        result.append(Demonstration(Trajectory(time, human, ("x",)), robot, scene))
    return DemonstrationSet(result, None if groups is None else [i * groups // num for i in range(num)])


def changed(demonstrations: DemonstrationSet, change: Make) -> DemonstrationSet:
    return DemonstrationSet([change(one) for one in demonstrations], demonstrations.groups)


def scaled(trajectory: Trajectory, factor: float) -> Trajectory:
    return dataclasses.replace(trajectory, values=trajectory.values * factor)


def predictor(robot: AbstractPrimitive = ROBOT, **arguments: object) -> InteractionPredictor:
    arguments = {"phase": ElapsedClock()} | arguments
    return InteractionPredictor(human=HUMAN, robot=robot, **arguments)  # pyright: ignore[reportArgumentType]


def paper(target: str = "robot") -> InteractionPredictor:
    model = GaussianJointModel(EmpiricalCovariance(), "regression")
    dmp = DMP(num_basis=6, boundary="given")
    return InteractionPredictor(
        dmp, dmp, DTWClock(num_samples=60), ForcingEvidence(), model, target, criterion="evidence", num_samples=40
    )


@pytest.fixture(scope="module")
def fitted() -> InteractionPredictor:
    return predictor().fit(demonstrations(24))


@pytest.fixture(scope="module")
def ragged() -> InteractionPredictor:
    return predictor(DMP(num_basis=5)).fit(demonstrations(18, ragged=True, groups=2))


@pytest.fixture(scope="module")
def papers() -> dict[str, InteractionPredictor]:
    motions = demonstrations(18, ragged=True, groups=2)
    chosen = paper("robot").fit(motions)
    assert chosen.fitted is not None
    noise = {name: getattr(chosen.fitted, name).tolist() for name in ("noise", "environment_noise")}
    return {"robot": chosen, "human": dataclasses.replace(paper("human"), **noise).fit(motions)}


@pytest.fixture(scope="module")
def large() -> InteractionPredictor:
    model = GaussianJointModel(EmpiricalCovariance())
    given = predictor(model=model, noise=SENSOR, environment_noise=0.0, recalibrate=False)
    return given.fit(demonstrations(600, groups=1))


def test_documented_use() -> None:
    task = demonstrations(8, groups=2)
    trained = InteractionPredictor().fit(task)
    new = demonstrations(1, seed=7, groups=None)[0]
    assert new.human is not None
    prediction = trained.predict(new.human.first(10), new.environment)
    low, high = prediction.interval(0.9)
    assert prediction.names == ("u", "v")
    assert bool((low < prediction.mean).all() and (prediction.mean < high).all())


def analytic(seen: int, motion: Demonstration, scene: bool, time: torch.Tensor) -> tuple[np.ndarray, np.ndarray]:
    """(mean, variance) of the robot's path under the world's own Gaussian."""
    mean, root = (part.numpy() for part in world())
    covariance = root @ root.T
    phase = torch.linspace(0, 1, SAMPLES, dtype=torch.float64)[:seen]
    design = np.zeros((seen + 2, 15))
    design[:seen, :5] = HUMAN.design(phase)[0].numpy()
    design[seen:, 13:] = np.eye(2)
    assert motion.human is not None and motion.environment is not None
    value = np.concatenate([motion.human.values[:seen, 0].numpy(), motion.environment.value.numpy()])
    noise = np.diag([SENSOR**2] * seen + [1e-9] * 2)
    kept = slice(None) if scene else slice(seen)
    design, value, noise = design[kept], value[kept], noise[kept, kept]
    gain = covariance @ design.T @ np.linalg.inv(design @ covariance @ design.T + noise)
    mean, covariance = mean + gain @ (value - design @ mean), covariance - gain @ design @ covariance
    matrix = np.kron(np.eye(2), ROBOT.design(time / DURATION)[0].numpy())
    variance = np.diag(matrix @ covariance[5:13, 5:13] @ matrix.T)
    return (matrix @ mean[5:13]).reshape(2, -1).T, variance.reshape(2, -1).T


@pytest.mark.parametrize("scene", [False, True])
@pytest.mark.parametrize("seen", [4, 15])
def test_close_to_the_truth_with_many_demonstrations(large: InteractionPredictor, seen: int, scene: bool) -> None:
    motion = demonstrations(1, seed=5, groups=None)[0]
    assert motion.human is not None
    time = torch.linspace(0, DURATION, 13, dtype=torch.float64)
    came = large.predict(motion.human.first(seen), motion.environment if scene else None, time=time)
    mean, variance = analytic(seen, motion, scene, time)
    _, prior = analytic(0, motion, False, time)
    # Mean: sqrt(weights / demonstrations) = 16 % of what is left uncertain; variance: sqrt(2 / 600) = 6 %.
    assert (np.abs(came.mean.numpy() - mean) / np.sqrt(variance)).max() < 3 * (15 / 600) ** 0.5
    assert np.abs(np.log(came.variance.numpy() / variance)).max() < 4 * (2 / 600) ** 0.5
    assert (variance < 0.7 * prior).any()


def dense(
    model: InteractionPredictor, motion: Trajectory, scene: EnvironmentFeatures | None, time: torch.Tensor
) -> tuple[np.ndarray, np.ndarray]:
    """(mean, covariance (S, D, D)) of the fitted joint, by the textbook formula."""
    fit = model.fitted
    assert fit is not None
    joint, layout = fit.model.prior, fit.model.prior.layout
    mean, covariance = joint.mean.numpy(), joint.covariance.numpy()
    duration = fit.phase.estimate(motion).duration
    seen = motion.num_samples
    design = np.zeros((seen + 2, len(mean)))
    design[:seen, layout.slice("human")] = (
        fit.primitives["human"].design((motion.time - motion.time[0]) / duration)[0].numpy()
    )
    design[seen:, layout.slice("environment")] = np.eye(2)
    value = np.concatenate([motion.values[:, 0].numpy(), np.zeros(2) if scene is None else scene.value.numpy()])
    noise = np.diag(np.concatenate([np.full(seen, float(fit.noise) ** 2), fit.environment_noise.numpy() ** 2]))
    kept = slice(seen if scene is None else None)
    design, value, noise = design[kept], value[kept], noise[kept, kept]
    gain = covariance @ design.T @ np.linalg.inv(design @ covariance @ design.T + noise)
    mean, covariance = mean + gain @ (value - design @ mean), covariance - gain @ design @ covariance
    robot = layout.slice("robot")
    rows = (
        fit.primitives["robot"].design((time - motion.time[0]) / duration, duration)[0].numpy().reshape(len(time), -1)
    )
    matrix = np.einsum("tb,de->tdeb", rows, np.eye(2)).reshape(len(time), 2, -1)
    total = matrix @ covariance[robot, robot] @ matrix.transpose(0, 2, 1)
    return matrix @ mean[robot], fit.inflation * (total + np.diag(fit.residual))


@pytest.mark.parametrize("which", ["fitted", "ragged"])
@pytest.mark.parametrize("scene", [False, True])
@pytest.mark.parametrize("seen", [1, 9])
def test_against_the_textbook_formula(which: str, scene: bool, seen: int, request: pytest.FixtureRequest) -> None:
    model = request.getfixturevalue(which)
    motion = demonstrations(1, seed=5, groups=None)[0]
    assert motion.human is not None
    time = torch.linspace(0, 1.1 * DURATION, 8, dtype=torch.float64)
    features = motion.environment if scene else None
    came = model.predict(motion.human.first(seen), features, time=time)
    mean, covariance = dense(model, motion.human.first(seen), features, time)
    np.testing.assert_allclose(came.mean, mean, rtol=1e-6, atol=1e-6)
    np.testing.assert_allclose(came.covariance, covariance, rtol=1e-5, atol=1e-6)
    np.testing.assert_allclose(came.variance, np.diagonal(covariance, axis1=1, axis2=2), rtol=1e-5, atol=1e-6)


def test_residual_is_the_target_primitives(ragged: InteractionPredictor) -> None:
    motions, fit = demonstrations(18, ragged=True, groups=2), ragged.fitted
    assert fit is not None
    clock = fit.phase.encoding(motions.trajectories("human"))
    expected = encode(fit.primitives["robot"], motions.trajectories("robot"), clock, fit.phase.limit).residual
    torch.testing.assert_close(fit.residual, expected)
    assert float(expected[0]) != pytest.approx(float(expected[1]), rel=1e-3)


def test_unknown_duration() -> None:
    fixed = {"noise": 0.05, "environment_noise": 0.5, "recalibrate": False}
    model = predictor(phase=MarginalClock(num_durations=9), **fixed).fit(demonstrations(24, ragged=True))
    motions = demonstrations(6, seed=9, ragged=True)
    humans, robots = motions.trajectories("human"), motions.trajectories("robot")
    assert model.fitted is not None and isinstance(model.fitted.phase, MarginalClock)
    durations = model.fitted.phase.estimate(humans).duration
    for seen in (3, 20):
        came = model.predict(humans.first(seen), motions.environments, time=robots.time)
        log_weight = model.fitted.phase.estimate(humans).log_weight
        parts = [
            model.predict(
                humans.first(seen), motions.environments, robots.time, known_phase(humans.first(seen), d.expand(6))
            )
            for d in durations
        ]
        weight = torch.softmax(log_weight + torch.stack([part.log_evidence for part in parts], -1), -1)
        mean = sum(weight[:, j, None, None] * part.mean for j, part in enumerate(parts))
        torch.testing.assert_close(came.mean, mean, rtol=1e-7, atol=1e-7)
        torch.testing.assert_close(came.posterior.weight, weight, rtol=1e-6, atol=1e-9)


def observation(seed: int = 3, seen: int = 12) -> tuple[Trajectory, EnvironmentFeatures]:
    motion = demonstrations(1, seed=seed, groups=None)[0]
    assert motion.human is not None and motion.environment is not None
    return motion.human.first(seen), motion.environment


def test_nothing_detected_is_ip_to_the_last_digit(fitted: InteractionPredictor) -> None:
    seen, scene = observation()
    nothing = torch.zeros(2, dtype=torch.bool)
    ip = fitted.predict(seen)
    for other in (
        EnvironmentFeatures.unseen(("width", "height")),
        EnvironmentFeatures.unseen(("height", "width")),
        dataclasses.replace(scene, observed=nothing),
    ):
        came = fitted.predict(seen, other)
        assert torch.equal(came.mean, ip.mean)
        assert torch.equal(came.covariance, ip.covariance)
        assert torch.equal(came.log_evidence, ip.log_evidence)


def test_hidden_human_without_a_scene_is_the_prior(fitted: InteractionPredictor) -> None:
    seen, _ = observation()
    came = fitted.predict(seen.hide(["x"]))
    assert fitted.fitted is not None
    prior = fitted.fitted.model.prior
    robot = fitted.fitted.primitives["robot"]
    expected = robot.decode(prior.block_mean("robot"), came.time / DURATION)
    torch.testing.assert_close(came.mean, expected, rtol=1e-12, atol=1e-12)
    assert float(came.log_evidence) == 0.0
    assert bool((came.variance >= fitted.predict(seen).variance - 1e-9).all())


def test_hidden_human_with_a_scene_is_the_scene_alone(fitted: InteractionPredictor) -> None:
    seen, scene = observation()
    came = fitted.predict(seen.hide(["x"]), scene)
    other = fitted.predict(scaled(seen, -7.0).hide(["x"]), scene)
    assert torch.equal(came.mean, other.mean)
    assert not torch.allclose(came.mean, fitted.predict(seen.hide(["x"])).mean)


def test_one_feature_of_two(fitted: InteractionPredictor) -> None:
    seen, scene = observation()
    part = dataclasses.replace(scene, observed=torch.tensor([True, False]))
    joint = fitted.fitted
    assert joint is not None
    row = LinearObservation(
        {"environment": torch.tensor([[1.0, 0.0]])},
        torch.zeros(1),
        scene.value[:1],
        joint.environment_noise[:1].square(),
    )
    came, expected = fitted.predict(seen, part), fitted.predict(seen, also=[row])
    torch.testing.assert_close(came.mean, expected.mean, rtol=1e-8, atol=1e-8)
    torch.testing.assert_close(came.log_evidence, expected.log_evidence)


def test_order_of_the_features_does_not_matter(fitted: InteractionPredictor) -> None:
    seen, scene = observation()
    scene = dataclasses.replace(scene, covariance=torch.tensor([[0.1, 0.2], [0.2, 9.0]]))
    one, other = (fitted.predict(seen, part) for part in (scene, scene.ordered_as(("height", "width"))))
    assert torch.equal(one.mean, other.mean)
    assert torch.equal(one.covariance, other.covariance)


def test_sensor_covariance_of_the_scene_counts(fitted: InteractionPredictor) -> None:
    seen, scene = observation()
    vague = dataclasses.replace(scene, covariance=1e12 * torch.eye(2))
    torch.testing.assert_close(fitted.predict(seen, vague).mean, fitted.predict(seen).mean, rtol=1e-5, atol=1e-5)


@pytest.mark.parametrize("which", ["fitted", "ragged", "papers"])
def test_batch_equals_loop(which: str, request: pytest.FixtureRequest) -> None:
    model = request.getfixturevalue(which)
    model = model["robot"] if which == "papers" else model
    motions = demonstrations(6, seed=8, ragged=which != "fitted")
    humans, scenes = motions.trajectories("human"), motions.environments
    assert scenes is not None
    batch = humans.first(11)
    time = torch.linspace(0, 3.0, 7, dtype=torch.float64)
    whole = model.predict(batch, scenes, time=time)
    assert whole.mean.shape == (6, 7, 2)
    shape = (2, 3)
    folded = model.predict(
        Trajectory(batch.time.expand(6, 11).reshape(*shape, 11), batch.values.reshape(*shape, 11, 1), ("x",)),
        EnvironmentFeatures(scenes.names, scenes.value.reshape(*shape, 2)),
        time=time,
    )
    torch.testing.assert_close(folded.mean.flatten(0, 1), whole.mean, rtol=1e-8, atol=1e-8)
    torch.testing.assert_close(
        folded.covariance.flatten(0, 1), whole.covariance.expand(6, -1, -1, -1), rtol=1e-7, atol=1e-8
    )
    for i in range(6):
        one = model.predict(batch[i], scenes[i], time=time)
        torch.testing.assert_close(whole.mean[i], one.mean, rtol=1e-8, atol=1e-8)
        torch.testing.assert_close(whole.variance.expand(6, -1, -1)[i], one.variance, rtol=1e-7, atol=1e-8)
        torch.testing.assert_close(whole.log_evidence[i], one.log_evidence)


def test_list_of_motions_of_several_lengths(ragged: InteractionPredictor) -> None:
    seen = [
        one.human.first(n)
        for one, n in zip(demonstrations(3, seed=8, ragged=True), (4, 20, 9), strict=True)
        if one.human
    ]
    time = torch.linspace(0, 3.0, 7, dtype=torch.float64)
    whole = ragged.predict(seen, time=time)
    for i, one in enumerate(seen):
        alone = ragged.predict(one, time=time)
        torch.testing.assert_close(whole.mean[i], alone.mean, rtol=1e-7, atol=1e-7)
        torch.testing.assert_close(whole.log_evidence[i], alone.log_evidence, rtol=1e-7, atol=1e-7)


def test_start_of_the_clock_does_not_matter(ragged: InteractionPredictor) -> None:
    seen, scene = observation()
    later = dataclasses.replace(seen, time=seen.time + 40.0)
    one, other = ragged.predict(seen, scene), ragged.predict(later, scene)
    torch.testing.assert_close(other.time, one.time + 40.0)
    torch.testing.assert_close(other.mean, one.mean, rtol=1e-8, atol=1e-8)


@pytest.mark.parametrize("target", ["human", "robot"])
def test_paper_set_up(papers: dict[str, InteractionPredictor], target: str) -> None:
    model = papers[target]
    motions = demonstrations(8, seed=4, ragged=True)
    humans = motions.trajectories("human")
    truth = motions.trajectories(target)
    came = model.predict(humans.first(20), motions.environments, time=truth.time)
    prior = model.predict(humans.first(20).hide(["x"]), time=truth.time)
    assert came.mean.shape == truth.values.shape
    error, without = (
        (part.mean - truth.values)[truth.mask.expand_as(part.mean)].square().mean() for part in (came, prior)
    )
    assert error < 0.6 * without


def test_paper_motion_starts_where_it_was_seen(papers: dict[str, InteractionPredictor]) -> None:
    seen, scene = observation(seen=9)
    came = papers["human"].predict(seen, scene, time=seen.time)
    torch.testing.assert_close(came.mean[0], seen.values[0], rtol=1e-9, atol=1e-9)
    hidden = papers["human"].predict(seen.hide(["x"]), scene, time=seen.time)
    assert papers["human"].fitted is not None
    torch.testing.assert_close(hidden.mean[0], papers["human"].fitted.boundary.start, rtol=1e-9, atol=1e-9)


def test_positions_of_a_motion_whose_start_is_given() -> None:
    given = InteractionPredictor(
        DMP(num_basis=6, boundary="given"), ROBOT, ElapsedClock(), noise=0.1, environment_noise=1.0, recalibrate=False
    )
    model = given.fit(demonstrations(12))
    assert model.fitted is not None
    seen, _ = observation(seen=9)
    start = initial_boundary(seen)
    design, offset = model.fitted.primitives["human"].design(seen.time / DURATION, DURATION, start)
    rows = LinearObservation({"human": design}, offset[0], seen.values[:, 0], torch.full((9,), 0.01))
    came, expected = model.predict(seen), model.predict(seen.hide(["x"]), also=[rows])
    torch.testing.assert_close(came.mean, expected.mean, rtol=1e-7, atol=1e-7)
    torch.testing.assert_close(came.log_evidence, expected.log_evidence)


def test_forces_need_three_samples(papers: dict[str, InteractionPredictor]) -> None:
    seen, _ = observation(seen=2)
    assert float(papers["robot"].predict(seen).log_evidence) == 0.0


def test_own_motion_follows_what_was_seen() -> None:
    motions = demonstrations(24, groups=2)
    alone = DemonstrationSet([Demonstration(one.human, environment=one.environment) for one in motions], motions.groups)
    model = predictor(target="human").fit(alone)
    seen, scene = observation(seen=20)
    came = model.predict(seen, scene, time=seen.time)
    assert came.names == ("x",)
    assert (came.mean - seen.values).abs().max() < 0.2
    assert bool((came.variance < model.predict(seen.first(2), scene, time=seen.time).variance + 1e-9).all())


def test_known_phase() -> None:
    fixed = {"noise": 0.05, "environment_noise": 0.5, "recalibrate": False}
    elapsed = predictor(**fixed).fit(demonstrations(24))
    known = predictor(phase=KnownPhase(), **fixed).fit(demonstrations(24, ragged=True))
    alike, other = demonstrations(4, seed=9), demonstrations(4, seed=9, ragged=True)
    seen, longer = alike.trajectories("human").first(9), other.trajectories("human")
    one = elapsed.predict(seen, alike.environments, time=alike.trajectories("robot").time)
    told = known_phase(longer.first(9), longer.duration)
    two = known.predict(longer.first(9), other.environments, other.trajectories("robot").time, told)
    assert (longer.duration / DURATION - 1).abs().max() > 0.05
    torch.testing.assert_close(two.mean, one.mean, rtol=1e-6, atol=1e-6)
    torch.testing.assert_close(two.variance, one.variance, rtol=1e-5, atol=1e-8)
    with pytest.raises(InputError, match="true durations"):
        known.predict(seen)


def test_known_phase_with_chosen_noise() -> None:
    model = predictor(phase=KnownPhase()).fit(demonstrations(10, ragged=True, groups=2))
    assert model.fitted is not None and float(model.fitted.noise) > 0


def test_phase_that_replaces_the_clock(ragged: InteractionPredictor) -> None:
    seen, scene = observation()
    clock = ragged.fitted
    assert clock is not None and isinstance(clock.phase, ElapsedClock) and clock.phase.duration is not None
    one = ragged.predict(seen, scene)
    same = ragged.predict(seen, scene, phase=known_phase(seen, clock.phase.duration))
    other = ragged.predict(seen, scene, phase=known_phase(seen, 2 * clock.phase.duration))
    assert torch.equal(one.mean, same.mean)
    assert other.time[-1] > 1.5 * one.time[-1]


def test_read_at_other_times(ragged: InteractionPredictor) -> None:
    seen, scene = observation()
    came = ragged.predict(seen, scene)
    came.mean  # noqa: B018  # what is kept must not outlive the times
    other = came.at([0.3, 1.7])
    expected = ragged.predict(seen, scene, time=torch.tensor([0.3, 1.7], dtype=torch.float64))
    assert torch.equal(other.mean, expected.mean)
    assert torch.equal(other.variance, expected.variance)


def test_goal_is_held_after_the_end(ragged: InteractionPredictor) -> None:
    clock = ragged.fitted
    assert clock is not None and isinstance(clock.phase, ElapsedClock) and clock.phase.duration is not None
    assert clock.phase.limit > 1.05
    end = clock.phase.limit * clock.phase.duration
    came = ragged.predict(*observation(), time=torch.tensor([end, end + 0.5, end + 100.0], dtype=torch.float64))
    torch.testing.assert_close(came.mean[1:], came.mean[:1].expand(2, -1), rtol=1e-9, atol=1e-9)
    torch.testing.assert_close(came.variance[1:], came.variance[:1].expand(2, -1), rtol=1e-9, atol=1e-9)


def test_default_times(fitted: InteractionPredictor) -> None:
    seen, scene = observation(seen=7)
    time = fitted.predict(seen, scene).time
    torch.testing.assert_close(time, torch.linspace(0, DURATION, SAMPLES, dtype=torch.float64))
    overdue = Trajectory(torch.linspace(0, 4.0, 9), torch.zeros(9, 1), ("x",))
    assert 4.0 <= float(fitted.predict(overdue).time[-1]) < 4.0 + DURATION / (SAMPLES - 1)


@pytest.mark.parametrize("duration", [0.7, 1.3, 1.9, 3.3, 4.7])
def test_default_times_take_no_step_for_round_off(duration: float) -> None:
    def retimed(trajectory: Trajectory | None) -> Trajectory:
        assert trajectory is not None
        return dataclasses.replace(trajectory, time=torch.linspace(0, duration, SAMPLES, dtype=torch.float64))

    def both(one: Demonstration) -> Demonstration:
        return dataclasses.replace(one, human=retimed(one.human), robot=retimed(one.robot))

    motions = changed(demonstrations(4, groups=1), both)
    model = predictor().fit(motions)
    assert motions[0].human is not None
    for seen in range(1, SAMPLES):
        assert model.predict(motions[0].human.first(seen)).time.shape == (SAMPLES,)


@pytest.mark.parametrize("which", ["fitted", "ragged"])
def test_via_point_of_the_robot_is_hit(which: str, request: pytest.FixtureRequest) -> None:
    model = request.getfixturevalue(which)
    seen, scene = observation()
    at = torch.tensor([1.9], dtype=torch.float64)
    before = model.predict(seen, scene, time=at)
    goal = before.mean[0] + torch.tensor([1.0, -0.5])
    design, _ = model.fitted.primitives["robot"].design(before.phase.at(at)[0], before.phase.duration[0])
    rows = torch.block_diag(design[0, None], design[0, None])
    via = LinearObservation({"robot": rows}, torch.zeros(2), goal, torch.full((2,), 1e-10))
    after = model.predict(seen, scene, time=at, also=[via])
    torch.testing.assert_close(after.mean[0], goal, rtol=0, atol=1e-4)
    assert (after.variance[0] - model.fitted.inflation * model.fitted.residual).max() < 1e-6


def test_deterministic_and_without_side_effects() -> None:
    motions = demonstrations(12)
    before = [one.human.values.clone() for one in motions if one.human]
    given = predictor(noise=0.05)
    models = [given.fit(motions) for _ in range(2)]
    assert given.fitted is None
    assert all(torch.equal(one.human.values, b) for one, b in zip(motions, before, strict=True) if one.human)
    seen, scene = observation()
    values, features = seen.values.clone(), scene.value.clone()
    first, second, third = (
        models[0].predict(seen, scene),
        models[0].predict(seen, scene),
        models[1].predict(seen, scene),
    )
    assert torch.equal(first.mean, second.mean) and torch.equal(first.mean, third.mean)
    assert torch.equal(first.covariance, third.covariance)
    assert torch.equal(seen.values, values) and torch.equal(scene.value, features)


def in_other_units(one: Demonstration, robot: float, human: float, scene: float) -> Demonstration:
    assert one.human is not None and one.robot is not None and one.environment is not None
    factor = torch.tensor([scene, 1.0], dtype=torch.float64)
    features = EnvironmentFeatures(one.environment.names, one.environment.value * factor)
    return Demonstration(scaled(one.human, human), scaled(one.robot, robot), features)


@pytest.fixture(scope="module")
def small() -> dict[str, InteractionPredictor]:
    motions = demonstrations(8, groups=2)
    return {"promp": predictor().fit(motions), "dmp": predictor(DMP(num_basis=5)).fit(motions)}


@pytest.mark.parametrize(
    ("name", "factors"),
    [
        ("promp", (1000.0, 1.0, 1.0)),
        ("promp", (1.0, 1000.0, 1.0)),
        ("promp", (1.0, 1.0, 1000.0)),
        ("dmp", (1e-3, 50.0, 7.0)),
    ],
)
def test_units_change_nothing_but_the_units(
    small: dict[str, InteractionPredictor], name: str, factors: tuple[float, float, float]
) -> None:
    motions, new = demonstrations(8, groups=2), demonstrations(1, seed=3, groups=None)[0]
    given = dataclasses.replace(small[name], fitted=None)
    models = [small[name], given.fit(changed(motions, lambda one: in_other_units(one, *factors)))]
    told = [new, in_other_units(new, *factors)]
    one, other = (
        model.predict(t.human.first(9), t.environment) for model, t in zip(models, told, strict=True) if t.human
    )
    assert models[0].fitted is not None and models[1].fitted is not None
    np.testing.assert_allclose(models[1].fitted.inflation, models[0].fitted.inflation, rtol=1e-6)
    torch.testing.assert_close(models[1].fitted.noise, models[0].fitted.noise * factors[1], rtol=1e-9, atol=0)
    torch.testing.assert_close(other.mean, one.mean * factors[0], rtol=1e-6, atol=1e-6 * factors[0])
    torch.testing.assert_close(other.variance, one.variance * factors[0] ** 2, rtol=1e-5, atol=0)


@pytest.mark.parametrize("seen", [3, 12])
def test_coverage_of_motions_never_seen(seen: int) -> None:
    model = predictor(noise=SENSOR, environment_noise=0.0).fit(demonstrations(60, groups=5))
    motions = demonstrations(300, seed=21)
    robots = motions.trajectories("robot")
    for scene in (None, motions.environments):
        low, high = model.predict(motions.trajectories("human").first(seen), scene, time=robots.time).interval(0.9)
        inside = ((robots.values > low) & (robots.values < high)).double()[:, seen:].mean((1, 2))
        standard_error = float(inside.std() / 300**0.5)
        # Sixty demonstrations leave the estimated variances themselves uncertain by about sqrt(2 / 60) = 18 %.
        assert abs(float(inside.mean()) - 0.9) < 0.04 + 3 * standard_error


def constant(one: Demonstration, agent: str, value: float) -> Demonstration:
    trajectory = getattr(one, agent)
    values = trajectory.values.clone()
    values[:, -1] = value
    return dataclasses.replace(one, **{agent: dataclasses.replace(trajectory, values=values)})


DEGENERATE: dict[str, Callable[[DemonstrationSet], DemonstrationSet]] = {
    "two": lambda motions: motions[:2],
    "three": lambda motions: DemonstrationSet(list(motions)[:3]),
    "one group": lambda motions: DemonstrationSet(list(motions), ["a"] * len(motions)),
    "all equal": lambda motions: DemonstrationSet([motions[0]] * 6, [0, 0, 0, 1, 1, 1]),
    "zero robot signal": lambda motions: changed(motions, lambda one: constant(one, "robot", 0.0)),
    "constant robot signal": lambda motions: changed(motions, lambda one: constant(one, "robot", 0.7)),
    "constant human": lambda motions: changed(motions, lambda one: constant(one, "human", 0.7)),
    "short robot": lambda motions: changed(
        motions, lambda one: dataclasses.replace(one, robot=one.robot.first(2) if one.robot else None)
    ),
    "constant features": lambda motions: changed(
        motions, lambda one: dataclasses.replace(one, environment=EnvironmentFeatures(("width", "height"), [0.1, 0.0]))
    ),
    "beginnings not seen": lambda motions: changed(
        motions,
        lambda one: dataclasses.replace(
            one, human=dataclasses.replace(one.human, mask=(torch.arange(SAMPLES) > 8)[:, None]) if one.human else None
        ),
    ),
}


@pytest.mark.parametrize("primitive", [ROBOT, DMP(num_basis=5)])
@pytest.mark.parametrize("kind", list(DEGENERATE))
def test_degenerate_demonstrations(kind: str, primitive: AbstractPrimitive) -> None:
    model = predictor(primitive).fit(DEGENERATE[kind](demonstrations(8, groups=2)))
    seen, scene = observation()
    for features in (None, scene):
        came = model.predict(seen, features)
        assert bool(torch.isfinite(came.mean).all() and torch.isfinite(came.log_evidence).all())
        assert bool((came.variance > 0).all() and torch.isfinite(came.variance).all())


def test_demonstrations_without_a_scene() -> None:
    motions = changed(demonstrations(8, groups=2), lambda one: dataclasses.replace(one, environment=None))
    model = predictor().fit(motions)
    seen, scene = observation()
    assert torch.isfinite(model.predict(seen).mean).all()
    with pytest.raises(InputError, match="the demonstrations had none"):
        model.predict(seen, scene)


def test_input_that_cannot_be_used(fitted: InteractionPredictor) -> None:
    seen, scene = observation()
    with pytest.raises(InputError, match=r"human signals \('x',\), as fitted, got \('y',\)"):
        fitted.predict(dataclasses.replace(seen, names=("y",)))
    with pytest.raises(InputError, match="Expected environment features"):
        fitted.predict(seen, EnvironmentFeatures(("width", "depth"), scene.value))
    with pytest.raises(InputError, match="at least one trajectory"):
        fitted.predict([])
    with pytest.raises(InputError, match="finite numbers in values"):
        fitted.predict(Trajectory(seen.time, seen.values * torch.nan, ("x",)))
    with pytest.raises(NotFittedError, match="fitted predictor"):
        predictor().predict(seen)
    with pytest.raises(NotFittedError, match="fitted predictor"):
        predictor().with_noise(1.0)
    with pytest.raises(InputError, match="at least two demonstrations"):
        predictor().fit(demonstrations(1, groups=None))
    with pytest.raises(InputError, match="target 'human' or 'robot'"):
        predictor(target="table")
    with pytest.raises(InputError, match="criterion 'prediction' or 'evidence'"):
        predictor(criterion="luck")
    with pytest.raises(InputError, match="noise as one standard deviation or 1 of them"):
        predictor(noise=[0.1, 0.2]).fit(demonstrations(4))
    with pytest.raises(InputError, match="environment_noise as one standard deviation or 2"):
        predictor(environment_noise=-1.0).fit(demonstrations(4))


def test_agents_that_are_missing() -> None:
    humans = changed(demonstrations(4), lambda one: dataclasses.replace(one, robot=None))
    robots = changed(demonstrations(4), lambda one: dataclasses.replace(one, human=None))
    for motions in (humans, robots):
        with pytest.raises(InputError, match="of the target 'robot'"):
            predictor().fit(motions)


def test_other_noise_without_another_fit(fitted: InteractionPredictor) -> None:
    seen, scene = observation()
    assert fitted.fitted is not None
    assert torch.equal(fitted.with_noise().predict(seen, scene).mean, fitted.predict(seen, scene).mean)
    deaf = fitted.with_noise(noise=1e6, environment_noise=torch.tensor([1e6, 1e6]))
    prior = fitted.predict(seen.hide(["x"]))
    torch.testing.assert_close(deaf.predict(seen, scene).mean, prior.mean, rtol=1e-5, atol=1e-5)
    assert float(fitted.fitted.noise) < 1e3

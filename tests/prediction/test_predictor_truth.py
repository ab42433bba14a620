from __future__ import annotations

import numpy as np
import pytest
import torch
from prediction_world import (
    DURATION,
    HUMAN,
    ROBOT,
    SAMPLES,
    SENSOR,
    demonstrations,
    growth,
    observation,
    predictor,
    world,
)

from eaip_prob.data.demonstrations import Demonstration
from eaip_prob.data.environment import EnvironmentFeatures
from eaip_prob.data.trajectory import Trajectory
from eaip_prob.encoding import encode
from eaip_prob.errors import HeldOutWarning
from eaip_prob.models import EmpiricalCovariance, GaussianJointModel
from eaip_prob.observation import LinearObservation
from eaip_prob.prediction import InteractionPredictor


@pytest.fixture(scope="module")
def large() -> InteractionPredictor:
    model = GaussianJointModel(EmpiricalCovariance())
    given = predictor(model=model, noise=SENSOR, environment_noise=0.0, recalibrate=False)
    with pytest.warns(HeldOutWarning, match="one group"):
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
    model: InteractionPredictor, motion: Trajectory, scene: EnvironmentFeatures | None, time: torch.Tensor, num: int
) -> tuple[np.ndarray, np.ndarray]:
    """(mean, covariance (S, D, D)) of the fitted joint, by the textbook formula; num scenes were demonstrated."""
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
    factor = fit.inflation * (1.0 if scene is None else growth(model, scene, num))
    return matrix @ mean[robot], factor * (total + np.diag(fit.residual))


@pytest.mark.parametrize(("which", "num"), [("fitted", 24), ("ragged", 18)])
@pytest.mark.parametrize("scene", [False, True])
@pytest.mark.parametrize("seen", [1, 9])
def test_against_the_textbook_formula(
    which: str, num: int, scene: bool, seen: int, request: pytest.FixtureRequest
) -> None:
    model = request.getfixturevalue(which)
    motion = demonstrations(1, seed=5, groups=None)[0]
    assert motion.human is not None
    time = torch.linspace(0, 1.1 * DURATION, 8, dtype=torch.float64)
    features = motion.environment if scene else None
    came = model.predict(motion.human.first(seen), features, time=time)
    mean, covariance = dense(model, motion.human.first(seen), features, time, num)
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


@pytest.mark.parametrize(("which", "num"), [("fitted", 24), ("ragged", 18)])
def test_via_point_of_the_robot_is_hit(which: str, num: int, request: pytest.FixtureRequest) -> None:
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
    factor = model.fitted.inflation * float(growth(model, scene, num))
    assert (after.variance[0] - factor * model.fitted.residual).abs().max() < 1e-6


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

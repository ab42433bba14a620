from __future__ import annotations

import dataclasses
import warnings

import numpy as np
import pytest
import torch
from prediction_world import DURATION, demonstrations, growth, observation, predictor
from scipy.stats import multivariate_normal

from eaip_prob.data.demonstrations import DemonstrationSet
from eaip_prob.data.environment import EnvironmentFeatures
from eaip_prob.data.features import QuadraticFeatures
from eaip_prob.data.trajectory import Trajectory
from eaip_prob.errors import ExtrapolationWarning
from eaip_prob.prediction import InteractionPredictor
from eaip_prob.slope import Slope

NUM = 18
GIVEN = {"noise": 0.05, "environment_noise": [0.3, 5.0]}


def gated(model: InteractionPredictor, value: float) -> InteractionPredictor:
    assert model.fitted is not None
    return dataclasses.replace(model, fitted=dataclasses.replace(model.fitted, gate=Slope(value=value)))


@pytest.fixture(scope="module")
def one() -> InteractionPredictor:
    return predictor(**GIVEN).fit(demonstrations(NUM))


def textbook(
    model: InteractionPredictor,
    gate: float,
    motion: Trajectory,
    rows: np.ndarray,
    value: np.ndarray,
    noise: np.ndarray,
    time: torch.Tensor,
) -> tuple[np.ndarray, np.ndarray, float]:
    """(mean (S, D), covariance (S, D, D) before growth, log evidence), cov(weights, environment) times the gate."""
    fitted = model.fitted
    assert fitted is not None
    prior, layout = fitted.model.prior, fitted.model.prior.layout
    mean, covariance = prior.mean.numpy(), prior.covariance.numpy().copy()
    scene, robot, seen = layout.slice("environment"), layout.slice("robot"), motion.num_samples
    kept = covariance[scene, scene].copy()
    covariance[scene] *= gate
    covariance[:, scene] *= gate
    covariance[scene, scene] = kept
    design = np.zeros((seen + len(rows), len(mean)))
    design[:seen, layout.slice("human")] = fitted.primitives["human"].design(motion.time / DURATION)[0].numpy()
    design[seen:, scene] = rows
    total = design @ covariance @ design.T
    total[:seen, :seen] += float(fitted.noise) ** 2 * np.eye(seen)
    total[seen:, seen:] += noise
    came = np.append(motion.values[:, 0].numpy(), value)
    gain = covariance @ design.T @ np.linalg.inv(total)
    after, left = mean + gain @ (came - design @ mean), covariance - gain @ design @ covariance
    matrix = fitted.primitives["robot"].design(time / DURATION)[0].numpy()
    path = np.einsum("tb,de->tdeb", matrix, np.eye(2)).reshape(len(time), 2, -1)
    spread = path @ left[robot, robot] @ path.transpose(0, 2, 1) + np.diag(fitted.residual.numpy())
    evidence = multivariate_normal.logpdf(came, design @ mean, total)
    return path @ after[robot], fitted.inflation * spread, float(evidence)


SENSOR = torch.tensor([[0.4, -0.7], [-0.7, 30.0]], dtype=torch.float64)


@pytest.mark.parametrize("gate", [0.4, 0.83, 1.0])
@pytest.mark.parametrize("sensor", [False, True])
@pytest.mark.parametrize("seen", [1, 9])
def test_a_gate_scales_what_the_scene_has_in_common_with_the_motions(
    one: InteractionPredictor, gate: float, sensor: bool, seen: int
) -> None:
    motion, scene = observation(seed=5, seen=seen)
    scene = dataclasses.replace(scene, covariance=SENSOR * sensor)
    time = torch.linspace(0, DURATION, 8, dtype=torch.float64)
    model = gated(one, gate)
    came = model.predict(motion, scene, time=time)
    noise = np.diag(np.square(GIVEN["environment_noise"])) + sensor * SENSOR.numpy()
    mean, covariance, evidence = textbook(model, gate, motion, np.eye(2), scene.value.numpy(), noise, time)
    np.testing.assert_allclose(came.mean, mean, rtol=1e-8, atol=1e-8)
    np.testing.assert_allclose(came.covariance, growth(model, scene, NUM) * covariance, rtol=1e-7, atol=1e-9)
    np.testing.assert_allclose(came.log_evidence, evidence, rtol=1e-8)


@pytest.mark.parametrize("place", [0, 1])
def test_a_gate_on_one_feature_of_two(one: InteractionPredictor, place: int) -> None:
    motion, scene = observation(seed=5, seen=9)
    part = dataclasses.replace(scene, covariance=SENSOR, observed=torch.arange(2) == place)
    time = torch.linspace(0, DURATION, 8, dtype=torch.float64)
    model = gated(one, 0.4)
    came = model.predict(motion, part, time=time)
    assert model.fitted is not None
    prior = model.fitted.model.prior
    noise = GIVEN["environment_noise"][place] ** 2 + float(SENSOR[place, place])
    row, value = np.eye(2)[place : place + 1], scene.value.numpy()[place : place + 1]
    mean, covariance, evidence = textbook(model, 0.4, motion, row, value, np.array([[noise]]), time)
    variance = float(prior.block_covariance("environment")[place, place]) + noise
    factor = 1.0 + float(value[0] - prior.block_mean("environment")[place]) ** 2 / variance / NUM
    np.testing.assert_allclose(came.mean, mean, rtol=1e-8, atol=1e-8)
    np.testing.assert_allclose(came.covariance, factor * covariance, rtol=1e-7, atol=1e-9)
    np.testing.assert_allclose(came.log_evidence, evidence, rtol=1e-8)


@pytest.mark.parametrize("gate", [0.4, 1.0])
def test_squares_and_products_carry_the_noise_of_the_scene(gate: float) -> None:
    motions = demonstrations(NUM)
    model = gated(predictor(features=QuadraticFeatures(), **GIVEN).fit(motions), gate)
    scene = motions.environments
    assert scene is not None and model.fitted is not None
    motion, new = observation(seed=5, seen=9)
    new = dataclasses.replace(new, covariance=SENSOR)
    mean, deviation = scene.value.numpy().mean(0), scene.value.numpy().std(0)
    z = (new.value.numpy() - mean) / deviation
    unit = np.outer(deviation, deviation)
    known = SENSOR.numpy() / unit
    blurred = known + np.diag(np.square(GIVEN["environment_noise"])) / unit
    # By sampling, the error of [z, z z^T] is 2 z_i e_j + e_i e_j: its covariance by quadrature over two dimensions.
    nodes, weight = np.polynomial.hermite_e.hermegauss(8)
    grid = np.stack(np.meshgrid(nodes, nodes), -1).reshape(-1, 2) @ np.linalg.cholesky(blurred).T + z
    weights = np.outer(weight, weight).ravel() / weight.sum() ** 2
    mapped = np.column_stack([grid, grid[:, 0] ** 2, grid[:, 0] * grid[:, 1], grid[:, 1] ** 2])
    centred = mapped - weights @ mapped
    noise = (weights[:, None] * centred).T @ centred
    value = np.array([*z, z[0] ** 2 - known[0, 0], z[0] * z[1] - known[0, 1], z[1] ** 2 - known[1, 1]])
    time = torch.linspace(0, DURATION, 8, dtype=torch.float64)
    came = model.predict(motion, new, time=time)
    path, covariance, evidence = textbook(model, gate, motion, np.eye(5), value, noise, time)
    prior = model.fitted.model.prior
    away = value - prior.block_mean("environment").numpy()
    total = prior.block_covariance("environment").numpy() + noise
    np.testing.assert_allclose(came.mean, path, rtol=1e-6, atol=1e-6)
    np.testing.assert_allclose(came.covariance, (1 + away @ np.linalg.solve(total, away) / NUM) * covariance, rtol=1e-6)
    np.testing.assert_allclose(came.log_evidence, evidence, rtol=1e-7)


def test_variance_grows_by_the_scenes_and_not_by_the_motions_that_were_recorded_in_them() -> None:
    rich = demonstrations(NUM)
    six = [dataclasses.replace(one, environment=rich[i % 6].environment) for i, one in enumerate(rich)]
    model = predictor(**GIVEN).fit(DemonstrationSet(six, rich.groups))
    motion, scene = observation(seed=5)
    assert model.fitted is not None
    scene = dataclasses.replace(scene, value=model.fitted.model.prior.block_mean("environment"))
    middle = model.predict(motion, scene)
    torch.testing.assert_close(
        torch.as_tensor(middle.inflation).double(), torch.tensor(model.fitted.inflation).double()
    )
    away = dataclasses.replace(scene, value=scene.value + torch.tensor([0.5, 20.0]))
    came = model.predict(motion, away)
    np.testing.assert_allclose(came.variance / middle.variance, growth(model, away, 6), rtol=1e-9)
    assert growth(model, away, 6) > 1.05


def test_far_scenes_are_named_from_half_the_range_beyond_it(one: InteractionPredictor) -> None:
    scene = demonstrations(NUM).environments
    assert scene is not None
    low, high = scene.value.amin(0), scene.value.amax(0)
    motion, _ = observation()

    def at(width: float, height: float, observed: tuple[bool, bool] = (True, True)) -> EnvironmentFeatures:
        value = 0.5 * (low + high) + torch.tensor([width, height]) * (high - low)
        return EnvironmentFeatures(("width", "height"), value, observed=torch.tensor(observed))

    with warnings.catch_warnings():
        warnings.simplefilter("error")
        for inside in (at(0.99, 0.99), at(-0.99, -0.99), at(0.0, 7.0, (True, False)), at(7.0, 7.0, (False, False))):
            one.predict(motion, inside)
    for outside, name in (
        (at(1.01, 0.0), "width"),
        (at(0.0, -1.01), "height"),
        (at(9.0, 1.5, (False, True)), "height"),
    ):
        value = float(outside.value[outside.names.index(name)])
        with pytest.warns(ExtrapolationWarning, match=rf"^{name} = {value:g} lies far outside the demons") as caught:
            one.predict(motion, outside.ordered_as(("height", "width")))
        assert caught[0].filename == __file__
    batch = EnvironmentFeatures(scene.names, torch.stack([at(0.0, 0.0).value, at(0.0, 3.0).value]))
    with pytest.warns(ExtrapolationWarning, match=f"height = {float(batch.value[1, 1]):g}"):
        one.predict([motion, motion], batch)

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np
import pytest
import torch
from scipy.special import logsumexp
from scipy.stats import multivariate_normal

from eaip_prob.errors import InputError, NotFittedError, ShapeError
from eaip_prob.folds import group_folds
from eaip_prob.gaussian import BlockGaussian, BlockLayout
from eaip_prob.models import (
    AbstractJointModel,
    EmpiricalCovariance,
    GaussianJointModel,
    Posterior,
    ShrinkageCovariance,
)
from eaip_prob.observation import LinearObservation

SIZES = {"human": 6, "robot": 4, "environment": 2}
HUMAN, ROBOT, SCENE = slice(0, 6), slice(6, 10), slice(10, 12)


def weights(num: int, seed: int = 0) -> dict[str, torch.Tensor]:
    generator = torch.Generator().manual_seed(seed)
    hidden = torch.randn(num, 5, generator=generator, dtype=torch.float64)
    blocks = {}
    for block, size in SIZES.items():
        mixing = torch.randn(5, size, generator=generator, dtype=torch.float64)
        own = 0.5 * torch.randn(num, size, generator=generator, dtype=torch.float64)
        blocks[block] = (hidden @ mixing + own) * torch.logspace(-1, 2, size, dtype=torch.float64) + 3.0
    return blocks


def table(blocks: Mapping[str, torch.Tensor]) -> np.ndarray:
    return np.concatenate([rows.numpy() for rows in blocks.values()], -1)


def empirical(environment: str = "block") -> GaussianJointModel:
    return GaussianJointModel(EmpiricalCovariance(), environment)


def scene_seen(value: list[float], noise: list[float]) -> LinearObservation:
    return LinearObservation({"environment": torch.eye(2)}, torch.zeros(2), torch.tensor(value), torch.tensor(noise))


def human_seen(batch: tuple[int, ...], rows: int = 3, seed: int = 5) -> LinearObservation:
    generator = torch.Generator().manual_seed(seed)
    matrix = torch.randn(*batch, rows, 6, generator=generator, dtype=torch.float64)
    offset = torch.randn(*batch, rows, generator=generator, dtype=torch.float64)
    value = 2.0 * torch.randn(*batch, rows, generator=generator, dtype=torch.float64)
    noise = 0.5 + torch.rand(*batch, rows, generator=generator, dtype=torch.float64)
    return LinearObservation({"human": matrix}, offset, value, noise)


def slow_update(
    model: GaussianJointModel, seen: LinearObservation, at: tuple[int, ...]
) -> tuple[np.ndarray, np.ndarray, float]:
    mean, cov = model.prior.mean.numpy(), model.prior.covariance.numpy()
    design = np.zeros((seen.value.shape[-1], 12))
    design[:, HUMAN] = seen.matrices["human"][at]
    residual = (seen.value - seen.offset)[at].numpy() - design @ mean
    innovation = design @ cov @ design.T + np.diag(seen.noise[at])
    gain = cov @ design.T @ np.linalg.inv(innovation)
    return mean + gain @ residual, cov - gain @ design @ cov, multivariate_normal.logpdf(residual, cov=innovation)


@pytest.fixture(scope="module")
def model() -> GaussianJointModel:
    return empirical().fit(weights(40))


def posterior_of(
    model: AbstractJointModel, batch: tuple[int, ...]
) -> tuple[LinearObservation, torch.Tensor, Posterior]:
    seen = human_seen((*batch, 4))
    log_weight = torch.log_softmax(torch.arange(4.0, dtype=torch.float64) * 0.7, -1).expand(*batch, 4)
    return seen, log_weight, model.posterior([seen], log_weight)


@pytest.mark.parametrize("num", [2, 7, 10])
def test_regression_equals_block_with_few_demonstrations(num: int) -> None:
    joints = [empirical(form).fit(weights(num)) for form in ("block", "regression")]
    seen = [human_seen((1,)), scene_seen([5.0, 90.0], [0.3, 4.0])]
    block, regression = (joint.posterior(seen) for joint in joints)
    for name in ("human", "robot"):
        torch.testing.assert_close(regression.mean(name), block.mean(name), rtol=1e-7, atol=1e-7)
        torch.testing.assert_close(regression.covariance(name), block.covariance(name), rtol=1e-6, atol=1e-7)


def test_regression_differs_by_the_residual_with_many_demonstrations() -> None:
    rows = weights(40)
    block, regression = (empirical(form).fit(rows).prior.covariance.numpy() for form in ("block", "regression"))
    centred = table(rows) - table(rows).mean(0)
    theta, features = centred[:, :10], centred[:, SCENE]
    left = features - theta @ np.linalg.lstsq(theta, features, rcond=None)[0]
    np.testing.assert_allclose(block[:10], regression[:10], rtol=1e-9, atol=1e-10)
    np.testing.assert_allclose(
        block[SCENE, SCENE] - regression[SCENE, SCENE], left.T @ left / 40, rtol=1e-8, atol=1e-10
    )
    assert (np.diag(left.T @ left) / np.diag(features.T @ features)).min() > 0.01


@pytest.mark.parametrize("num", [6, 40])
@pytest.mark.parametrize("order", [("human", "robot", "environment"), ("environment", "human", "robot")])
def test_regression_weights_are_minimum_norm_least_squares(num: int, order: tuple[str, ...]) -> None:
    rows = weights(num)
    joint = GaussianJointModel(ShrinkageCovariance(0.3), "regression").fit({name: rows[name] for name in order}).prior
    theta = joint.layout.indices(["human", "robot"])
    features = joint.layout.indices(["environment"])
    centred = table(rows) - table(rows).mean(0)
    w_e = np.linalg.lstsq(centred[:, :10], centred[:, SCENE], rcond=1e-12)[0]
    sigma = joint.covariance[theta[:, None], theta].numpy()
    np.testing.assert_allclose(joint.covariance[theta[:, None], features], sigma @ w_e, rtol=1e-6, atol=1e-8)
    np.testing.assert_allclose(joint.covariance[features[:, None], features], w_e.T @ sigma @ w_e, rtol=1e-6, atol=1e-8)
    expected = ShrinkageCovariance(0.3).estimate(torch.from_numpy(table(rows)[:, :10]), [], theta, theta[:0])
    np.testing.assert_allclose(sigma, expected, rtol=1e-9)


def test_mean_is_the_demonstrations_mean(model: GaussianJointModel) -> None:
    np.testing.assert_allclose(model.prior.mean, table(weights(40)).mean(0), rtol=1e-12)
    np.testing.assert_allclose(model.prior.covariance, np.cov(table(weights(40)).T, bias=True), rtol=1e-10)


def test_without_an_environment_both_forms_are_ip() -> None:
    rows = {name: part for name, part in weights(12).items() if name != "environment"}
    block, regression = (empirical(form).fit(rows).prior for form in ("block", "regression"))
    assert torch.equal(block.covariance, regression.covariance)


def test_features_and_target_reach_the_estimator() -> None:
    rows, layout = weights(12), BlockLayout(SIZES)
    joint = GaussianJointModel().fit(rows, groups=[i // 3 for i in range(12)], target="human").prior
    folds = [torch.arange(3 * i, 3 * i + 3) for i in range(4)]
    expected = ShrinkageCovariance().estimate(
        torch.from_numpy(table(rows)), folds, layout.indices(["human"]), layout.indices(["environment"])
    )
    torch.testing.assert_close(joint.covariance, expected, rtol=1e-12, atol=0)


def test_target_reaches_the_estimator_behind_a_regression() -> None:
    rows = weights(12)
    order = ("environment", "robot", "human")
    joint = GaussianJointModel(environment="regression").fit({name: rows[name] for name in order}, target="robot").prior
    theta = torch.cat([rows["robot"], rows["human"]], -1)
    columns = torch.arange(4)
    chosen = {
        ShrinkageCovariance.chosen_amount(theta, group_folds(range(12)), at, columns[:0])
        for at in (columns, columns + 4)
    }
    assert len(chosen) == 2
    expected = ShrinkageCovariance().estimate(theta, group_folds(range(12)), columns, columns[:0])
    torch.testing.assert_close(joint.covariance[2:, 2:], expected, rtol=1e-12, atol=0)


@pytest.mark.parametrize("batch", [(), (3,), (2, 3)])
def test_hypotheses_are_weighted_by_evidence(model: GaussianJointModel, batch: tuple[int, ...]) -> None:
    seen, log_weight, posterior = posterior_of(model, batch)
    assert posterior.log_weight.shape == (*batch, 4)
    assert posterior.log_evidence.shape == batch
    for at in np.ndindex(*batch):
        parts = [slow_update(model, seen, (*at, j)) for j in range(4)]
        scores = np.array([part[2] for part in parts]) + log_weight[at].numpy()
        weight = np.exp(scores - logsumexp(scores))
        mean = sum(w * part[0] for w, part in zip(weight, parts, strict=True))
        second = sum(
            w * (part[1] + np.outer(part[0] - mean, part[0] - mean)) for w, part in zip(weight, parts, strict=True)
        )
        np.testing.assert_allclose(posterior.weight[at], weight, rtol=1e-7, atol=1e-12)
        np.testing.assert_allclose(posterior.log_evidence[at], logsumexp(scores), rtol=1e-9)
        np.testing.assert_allclose(posterior.mean("robot")[at], mean[ROBOT], rtol=1e-7)
        np.testing.assert_allclose(posterior.covariance("robot")[at], second[ROBOT, ROBOT], rtol=1e-5, atol=1e-5)


@pytest.mark.parametrize("batch", [(), (2,)])
def test_samples_have_the_moment_matched_covariance(model: GaussianJointModel, batch: tuple[int, ...]) -> None:
    _, _, posterior = posterior_of(model, batch)
    num = 10_000
    draws, index = posterior.sample(num, torch.Generator().manual_seed(3))
    assert draws.shape == (num, *batch, 12)
    assert index.shape == (num, *batch)
    frequency = torch.nn.functional.one_hot(index, 4).double().mean(0)
    error = (posterior.weight * (1 - posterior.weight) / num).sqrt()
    assert bool(((frequency - posterior.weight).abs() <= 5 * error + 1e-12).all())
    robot = draws[..., ROBOT]
    mean_error = (robot.mean(0) - posterior.mean("robot")).abs() / (robot.std(0) / num**0.5)
    assert mean_error.max() < 5
    deviation = robot - posterior.mean("robot")
    products = deviation[..., :, None] * deviation[..., None, :]
    standard_error = products.std(0) / num**0.5
    assert ((products.mean(0) - posterior.covariance("robot")).abs() / standard_error).max() < 5


def test_draws_are_of_the_component_that_is_named(model: GaussianJointModel) -> None:
    _, _, posterior = posterior_of(model, (3,))
    parts = posterior.components
    tight = BlockGaussian(parts.mean, 1e-16 * parts.covariance, parts.layout)
    draws, index = replace(posterior, components=tight).sample(50, torch.Generator().manual_seed(4))
    chosen = index[..., None, None].expand(*index.shape, 1, 12)
    means = parts.mean.expand(50, *parts.mean.shape).gather(-2, chosen)[..., 0, :]
    assert len(index.unique()) > 1
    torch.testing.assert_close(draws, means, rtol=1e-5, atol=1e-5)


def test_log_prob_of_the_mixture(model: GaussianJointModel) -> None:
    _, _, posterior = posterior_of(model, (2,))
    value = model.prior.mean + torch.linspace(-1, 1, 24, dtype=torch.float64).reshape(2, 12)
    came = posterior.log_prob(value)
    parts = posterior.components
    for i in range(2):
        terms = [
            float(posterior.log_weight[i, j])
            + multivariate_normal.logpdf(value[i], parts.mean[i, j], parts.covariance[i, j], allow_singular=True)
            for j in range(4)
        ]
        np.testing.assert_allclose(came[i], logsumexp(terms), rtol=1e-8)


def test_inflated_scales_every_component(model: GaussianJointModel) -> None:
    _, _, posterior = posterior_of(model, ())
    wider = posterior.inflated(2.5)
    torch.testing.assert_close(wider.components.covariance, 2.5 * posterior.components.covariance)
    assert torch.equal(wider.mean("robot"), posterior.mean("robot"))


def test_no_observation_is_the_prior(model: GaussianJointModel) -> None:
    posterior = model.posterior([], keep=("robot",))
    assert posterior.components.layout.names == ("robot",)
    torch.testing.assert_close(posterior.mean("robot"), model.prior.block_mean("robot"))
    torch.testing.assert_close(posterior.covariance("robot"), model.prior.block_covariance("robot"))
    torch.testing.assert_close(posterior.weight, torch.ones(1, dtype=torch.float64))


def test_missing_features_are_completed() -> None:
    rows = weights(30)
    mask = torch.ones(30, 2, dtype=torch.bool)
    mask[::4, 0] = False
    hidden = dict(rows, environment=torch.where(mask, rows["environment"], torch.nan))
    whole, part = empirical().fit(rows).prior, empirical().fit(hidden, {"environment": mask}).prior
    torch.testing.assert_close(part.covariance[:10, :10], whole.covariance[:10, :10])
    assert torch.isfinite(part.covariance).all()
    spread = whole.covariance.diagonal().sqrt()
    assert ((part.mean - whole.mean).abs() / spread).max() < 0.3
    everything = torch.ones_like(mask)
    assert torch.equal(empirical().fit(rows, {"environment": everything}).prior.covariance, whole.covariance)


def test_fit_changes_neither_the_model_nor_the_weights() -> None:
    rows = weights(8)
    before = {name: part.clone() for name, part in rows.items()}
    given = GaussianJointModel()
    given.fit(rows, {"environment": torch.arange(16).reshape(8, 2) != 3})
    assert given.joint is None
    assert all(torch.equal(rows[name], before[name]) for name in rows)


def test_not_fitted() -> None:
    with pytest.raises(NotFittedError, match="fitted joint model"):
        GaussianJointModel().posterior([])


def test_input_that_cannot_be_used() -> None:
    rows = weights(5)
    with pytest.raises(InputError, match="at least two demonstrations"):
        GaussianJointModel().fit({name: part[:1] for name, part in rows.items()})
    with pytest.raises(ShapeError, match=r"one N for all blocks.*\(4, 4\)"):
        GaussianJointModel().fit(dict(rows, robot=rows["robot"][:4]))
    with pytest.raises(ShapeError, match="one N for all blocks"):
        GaussianJointModel().fit({"human": torch.zeros(5), "robot": torch.zeros(5)})
    with pytest.raises(InputError, match="finite numbers in weights"):
        GaussianJointModel().fit(dict(rows, human=rows["human"] / 0.0))
    with pytest.raises(InputError, match="at least one block"):
        GaussianJointModel().fit({})
    with pytest.raises(InputError, match="among .*table"):
        GaussianJointModel().fit(rows, target="table")
    with pytest.raises(InputError, match="as booleans"):
        GaussianJointModel().fit(rows, {"environment": torch.ones(5, 2)})
    with pytest.raises(InputError, match="'block' or 'regression'"):
        GaussianJointModel(environment="both")


def test_observed_that_does_not_fit_the_weights() -> None:
    rows = weights(5)
    with pytest.raises(InputError, match="observed"):
        GaussianJointModel().fit(rows, {"table": torch.ones(5, 2, dtype=torch.bool)})
    with pytest.raises(ShapeError, match="observed"):
        GaussianJointModel().fit(rows, {"environment": torch.ones(5, 3, dtype=torch.bool)})
    with pytest.raises(ShapeError, match="groups"):
        GaussianJointModel().fit(rows, groups=[1, 2])

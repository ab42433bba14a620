from __future__ import annotations

import dataclasses

import numpy as np
import pytest
import torch
from scipy.optimize import brentq
from scipy.stats import norm

from eaip_prob.data.trajectory import Trajectory
from eaip_prob.forecast import Prediction
from eaip_prob.gaussian import BlockGaussian, BlockLayout
from eaip_prob.models import Posterior
from eaip_prob.phase import PhaseEstimate
from eaip_prob.primitives import DMP, AbstractPrimitive, Boundary, ProMP

DURATIONS = torch.tensor([2.0, 2.5, 3.5], dtype=torch.float64)
TIME = torch.linspace(0.0, 4.0, 6, dtype=torch.float64)
PRIMITIVES = {
    "promp": ProMP(num_basis=4, limit=1.3),
    "dmp": DMP(num_basis=4, limit=1.3),
    "given": DMP(num_basis=4, limit=1.3, boundary="given"),
}


def forecast(
    name: str = "promp", batch: tuple[int, ...] = (), shared_covariance: bool = False, seed: int = 0
) -> Prediction:
    """A mixture over three durations of a motion with two signals."""
    primitive = PRIMITIVES[name]
    generator = torch.Generator().manual_seed(seed)
    size = 2 * primitive.num_weights
    mean = 5.0 + torch.randn(*batch, 3, size, generator=generator, dtype=torch.float64)
    root = torch.randn(
        *(() if shared_covariance else (*batch, 3)), size, size, generator=generator, dtype=torch.float64
    )
    covariance = root @ root.mT / size
    log_weight = torch.log_softmax(torch.randn(*batch, 3, generator=generator, dtype=torch.float64), -1)
    components = BlockGaussian(mean, covariance, BlockLayout({"robot": size}))
    seen = torch.tensor([0.0, 0.5], dtype=torch.float64)
    phase = PhaseEstimate(seen, seen / DURATIONS[:, None], torch.log(torch.ones(3).double() / 3), DURATIONS)
    start = torch.tensor([1.0, -2.0], dtype=torch.float64).expand(*batch, 2)
    boundary = Boundary(start, 3.0 * start) if primitive.needs_boundary else None
    residual = torch.tensor([0.01, 0.4], dtype=torch.float64)
    posterior = Posterior(components, log_weight, torch.zeros(batch, dtype=torch.float64))
    return Prediction(TIME, posterior, phase, primitive, "robot", ("u", "v"), residual, 1.7, boundary)


def slow(
    prediction: Prediction, at: tuple[int, ...], time: float
) -> tuple[list[np.ndarray], list[np.ndarray], np.ndarray]:
    """(means, covariances, weights) of the components at one time."""
    posterior, primitive = prediction.posterior, prediction.primitive
    covariances = posterior.components.covariance.expand(*posterior.components.mean.shape, -1)
    means, totals = [], []
    for j in range(3):
        boundary = prediction.boundary
        if boundary is not None:
            boundary = Boundary(boundary.start[at], boundary.velocity[at])
        phase = torch.tensor([time], dtype=torch.float64) / DURATIONS[j]
        weights = posterior.components.mean[(*at, j)]
        means.append(primitive.decode(weights, phase, DURATIONS[j], boundary)[0].numpy())
        row = primitive.design(phase, DURATIONS[j], boundary)[0][0].numpy()
        matrix = np.kron(np.eye(2), row)
        within = matrix @ covariances[(*at, j)].numpy() @ matrix.T
        totals.append(1.7 * (within + np.diag(prediction.residual.numpy())))
    return means, totals, posterior.weight[at].numpy()


@pytest.mark.parametrize("name", list(PRIMITIVES))
@pytest.mark.parametrize(("batch", "shared"), [((), False), ((3,), True), ((2, 3), False)])
def test_moments_against_a_loop(name: str, batch: tuple[int, ...], shared: bool) -> None:
    prediction = forecast(name, batch, shared)
    assert prediction.mean.shape == (*batch, 6, 2)
    assert prediction.covariance.shape == (*batch, 6, 2, 2)
    for at in np.ndindex(*batch):
        for t, time in enumerate(TIME.tolist()):
            means, totals, weight = slow(prediction, at, time)
            mean = sum(w * m for w, m in zip(weight, means, strict=True))
            total = sum(w * (c + np.outer(m - mean, m - mean)) for w, m, c in zip(weight, means, totals, strict=True))
            np.testing.assert_allclose(prediction.mean[at][t], mean, rtol=1e-9)
            np.testing.assert_allclose(prediction.covariance[at][t], total, rtol=1e-8, atol=1e-10)
            np.testing.assert_allclose(prediction.variance[at][t], np.diag(total), rtol=1e-8)


@pytest.mark.parametrize("level", [0.05, 0.5, 0.9])
def test_quantile_inverts_the_mixture(level: float) -> None:
    prediction = forecast("dmp", (2,))
    came = prediction.quantile(level)
    for at in ((0,), (1,)):
        for t, time in enumerate(TIME.tolist()):
            means, totals, weight = slow(prediction, at, time)
            for d in range(2):

                def excess(y: float, d: int = d, parts: tuple = (means, totals, weight)) -> float:
                    m, c, w = parts
                    return sum(w[j] * norm.cdf(y, m[j][d], c[j][d, d] ** 0.5) for j in range(3)) - level

                np.testing.assert_allclose(
                    came[(*at, t, d)], brentq(excess, -1e3, 1e3, xtol=1e-10), rtol=1e-6, atol=1e-6
                )


def test_interval_is_two_quantiles() -> None:
    prediction = forecast()
    low, high = prediction.interval(0.8)
    torch.testing.assert_close(low, prediction.quantile(0.1))
    torch.testing.assert_close(high, prediction.quantile(0.9))


@pytest.mark.parametrize(("name", "batch"), [("dmp", ()), ("given", (2,))])
def test_samples_have_the_moments(name: str, batch: tuple[int, ...]) -> None:
    prediction, num = forecast(name, batch), 8_000
    draws = prediction.sample(num, torch.Generator().manual_seed(0))
    assert draws.shape == (num, *batch, 6, 2)
    spread = draws.std(0).clamp_min(1e-9)
    assert ((draws.mean(0) - prediction.mean).abs() / (spread / num**0.5)).max() < 5
    deviation = draws - prediction.mean
    products = deviation[..., :, None] * deviation[..., None, :]
    error = (products.mean(0) - (prediction.covariance - 1.7 * torch.diag(prediction.residual))).abs()
    assert (error / (products.std(0) / num**0.5).clamp_min(1e-9)).max() < 5


def test_samples_keep_one_hypothesis_and_are_smooth() -> None:
    certain = forecast("promp")
    components = certain.posterior.components
    still = BlockGaussian(components.mean, 1e-30 * components.covariance, components.layout)
    certain = dataclasses.replace(certain, posterior=dataclasses.replace(certain.posterior, components=still))
    draws = certain.sample(50, torch.Generator().manual_seed(0))
    distance = (draws[:, None] - certain.component_means).abs().amax((-2, -1))
    assert distance.amin(-1).max() < 1e-9
    assert len(distance.argmin(-1).unique()) == 3


def test_intervals_hold_the_samples() -> None:
    prediction, num, generator = forecast(), 8_000, torch.Generator().manual_seed(1)
    draws = prediction.sample(num, generator)
    residual = (1.7 * prediction.residual).sqrt()
    draws = draws + residual * torch.randn(draws.shape, generator=generator, dtype=torch.float64)
    low, high = prediction.interval(0.8)
    inside = ((draws > low) & (draws < high)).double().mean(0)
    assert ((inside - 0.8).abs() / (0.16 / num) ** 0.5).max() < 5


def test_samples_are_reproducible() -> None:
    one, other, third = (forecast().sample(3, torch.Generator().manual_seed(seed)) for seed in (1, 1, 2))
    assert torch.equal(one, other)
    assert not torch.equal(one, third)


def test_read_at_other_times() -> None:
    prediction = forecast()
    assert prediction.variance.shape == (6, 2)  # what is kept must not outlive the times
    other = prediction.at([0.8, 3.2])
    torch.testing.assert_close(other.mean, prediction.mean[[1, 4]], rtol=1e-12, atol=0)
    torch.testing.assert_close(other.variance, prediction.variance[[1, 4]], rtol=1e-12, atol=0)
    assert prediction.mean.shape == (6, 2)


def test_times_of_their_own_for_each_member() -> None:
    prediction = forecast("given", (2,))
    times = torch.stack([TIME, TIME + 0.3])
    whole = prediction.at(times)
    for i in range(2):
        torch.testing.assert_close(whole.mean[i], prediction.at(times[i]).mean[i], rtol=1e-12, atol=0)
        torch.testing.assert_close(whole.covariance[i], prediction.at(times[i]).covariance[i], rtol=1e-12, atol=1e-15)


@pytest.mark.parametrize("name", list(PRIMITIVES))
def test_plan_is_the_mean_over_phase(name: str) -> None:
    prediction = forecast(name, (2,))
    primitive: AbstractPrimitive = prediction.primitive
    came = prediction.plan(5)
    phase = torch.linspace(0, 1.3, 5, dtype=torch.float64)
    weight, mean = prediction.posterior.weight, prediction.posterior.components.mean
    for i in range(2):
        boundary = prediction.boundary
        if boundary is not None:
            boundary = Boundary(boundary.start[i], boundary.velocity[i])
        expected = sum(weight[i, j] * primitive.decode(mean[i, j], phase, DURATIONS[j], boundary) for j in range(3))
        torch.testing.assert_close(came[i], expected, rtol=1e-10, atol=1e-10)


def test_start_shared_by_a_batch() -> None:
    seen = Trajectory(torch.tensor([[0.0, 0.5], [0.0, 0.7]]), torch.zeros(2, 2, 1))
    phase = PhaseEstimate.linear(seen.time, torch.tensor([2.0, 3.0]))
    whole = dataclasses.replace(forecast("given"), phase=phase)
    posterior = whole.posterior
    one = BlockGaussian(posterior.components.mean[:1], posterior.components.covariance[:1], posterior.components.layout)
    certain = Posterior(one, torch.zeros(1, dtype=torch.float64), posterior.log_evidence)
    came = dataclasses.replace(whole, posterior=certain)
    assert whole.boundary is not None
    for i in range(2):
        expected = whole.primitive.decode(one.mean[0], TIME / phase.duration[i], phase.duration[i, 0], whole.boundary)
        torch.testing.assert_close(came.mean[i], expected, rtol=1e-10, atol=1e-10)

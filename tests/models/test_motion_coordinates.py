from __future__ import annotations

import numpy as np
import pytest
import torch
from scipy.linalg import block_diag, sqrtm

from eaip_prob.data.trajectory import Trajectory
from eaip_prob.errors import ShapeError
from eaip_prob.models import AbstractCovariance, EmpiricalCovariance, GaussianJointModel, ShrinkageCovariance
from eaip_prob.primitives import DMP, ProMP

HUMAN = ProMP(num_basis=5)
SIZE, SAMPLES, DURATION = 2, 60, 2.5


def dmp(num_basis: int = 9) -> DMP:
    return DMP(num_basis=num_basis, limit=1.2)


def motions(num: int, seed: int = 0, sensor: float = 0.0) -> torch.Tensor:
    """(N, T, D) smooth reaches whose amplitude and shape vary, with a standard deviation of about 3."""
    generator = torch.Generator().manual_seed(seed)
    s = torch.linspace(0.0, 1.2, SAMPLES, dtype=torch.float64)
    shapes = torch.stack([torch.ones_like(s), s, torch.sin(3 * s), torch.cos(5 * s), torch.sin(9 * s)])
    amounts = torch.randn(num, SIZE, 5, generator=generator, dtype=torch.float64)
    amounts = amounts * torch.tensor([2.0, 2.0, 1.5, 0.7, 0.3], dtype=torch.float64)
    noise = sensor * torch.randn(num, SAMPLES, SIZE, generator=generator, dtype=torch.float64)
    return 7.0 + (amounts @ shapes).mT + noise


def demonstrated(num: int, primitive: DMP, seed: int = 0, sensor: float = 0.0) -> dict[str, torch.Tensor]:
    """Weights of a robot, of a human who moves with it, and one feature."""
    generator = torch.Generator().manual_seed(seed + 100)
    paths = motions(num, seed, sensor)
    phase = torch.linspace(0.0, 1.2, SAMPLES, dtype=torch.float64)
    robot = primitive.encode(Trajectory(DURATION * phase, paths), phase, DURATION)
    mixing = torch.randn(3, 5, generator=generator, dtype=torch.float64)
    human = paths[:, ::25, 0] @ mixing + 0.3 * torch.randn(num, 5, generator=generator, dtype=torch.float64)
    feature = 100.0 + 20.0 * paths[:, -1:, 1] + torch.randn(num, 1, generator=generator, dtype=torch.float64)
    return {"human": human, "robot": robot, "environment": feature}


def decoded_variance(model: GaussianJointModel, primitive: DMP) -> torch.Tensor:
    """(200, D) variance of the robot's positions before anything is observed."""
    prior = model.prior
    robot = prior.layout.slice("robot")
    covariance = prior.covariance[robot, robot].reshape(SIZE, primitive.num_weights, SIZE, primitive.num_weights)
    design = primitive.design(torch.linspace(0.0, 1.2, 200, dtype=torch.float64), DURATION)[0]
    return torch.stack([((design @ covariance[d, :, d]) * design).sum(-1) for d in range(SIZE)], -1)


def shown_variance(weights: torch.Tensor, primitive: DMP) -> torch.Tensor:
    phase = torch.linspace(0.0, 1.2, 200, dtype=torch.float64)
    return primitive.decode(weights, phase, DURATION).var(0, correction=0)


@pytest.mark.parametrize("environment", ["block", "regression"])
@pytest.mark.parametrize("amount", [0.01, 0.1, 0.6, 1.0])
@pytest.mark.parametrize("num", [6, 30])
def test_shrinkage_keeps_the_spread_of_the_motions(num: int, amount: float, environment: str) -> None:
    primitive = dmp()
    weights = demonstrated(num, primitive)
    plain = GaussianJointModel(ShrinkageCovariance(amount), environment)
    shown = shown_variance(weights["robot"], primitive)
    model = plain.fit(weights, grams={"robot": primitive.gram(SIZE, DURATION)})
    came = decoded_variance(model, primitive)
    # In coordinates of the motions a diagonal holds their mean square: shrinking moves it along the path only.
    torch.testing.assert_close(came.mean(0), shown.mean(0), rtol=1e-6, atol=0)
    ratio = (came / shown).sqrt()
    assert float(ratio.min()) > 0.3 and float(ratio.max()) < 4.0


@pytest.mark.parametrize("num_basis", [9, 20])
def test_noise_that_cancels_in_the_motion_does_not_widen_it(num_basis: int) -> None:
    primitive = dmp(num_basis)
    weights, plain = demonstrated(30, primitive, sensor=1.0), GaussianJointModel(ShrinkageCovariance(0.6))
    shown = shown_variance(weights["robot"], primitive).mean(0).sqrt()
    came = decoded_variance(plain.fit(weights, grams={"robot": primitive.gram(SIZE, DURATION)}), primitive)
    torch.testing.assert_close(came.mean(0).sqrt(), shown, rtol=1e-6, atol=0)
    # Forcing weights of noisy motions are large and cancel; shrunk as they are, they no longer do.
    assert float((decoded_variance(plain.fit(weights), primitive).mean(0).sqrt() / shown).min()) > 5.0


@pytest.mark.parametrize(("num_basis", "loss"), [(15, 1e-6), (25, 0.03)])
def test_many_bases_near_the_floor(num_basis: int, loss: float) -> None:
    # With 25 bases the narrowest directions lie under the floor of the coordinates, which takes 2 % of the variance.
    primitive = dmp(num_basis)
    weights = demonstrated(20, primitive)
    model = GaussianJointModel(ShrinkageCovariance(0.3)).fit(weights, grams={"robot": primitive.gram(SIZE, DURATION)})
    shown = shown_variance(weights["robot"], primitive)
    torch.testing.assert_close(decoded_variance(model, primitive).mean(0), shown.mean(0), rtol=loss, atol=0)


@pytest.mark.parametrize("amount", [0.0, 0.3, 0.9])
def test_against_numpy_in_the_root_of_the_gram_matrix(amount: float) -> None:
    primitive = dmp(5)
    weights, gram = demonstrated(12, primitive), primitive.gram(SIZE, DURATION)
    size = gram.diagonal().sqrt().numpy()
    root = block_diag(np.eye(5), sqrtm(gram.numpy() / size / size[:, None]) * size, np.eye(1))
    rows = torch.cat(list(weights.values()), -1)
    inside = ShrinkageCovariance(amount).estimate(
        rows @ torch.from_numpy(root).T, [], torch.arange(5, 21), torch.tensor([21])
    )
    back = np.linalg.inv(root)
    expected = back @ inside.numpy() @ back.T
    came = GaussianJointModel(ShrinkageCovariance(amount)).fit(weights, grams={"robot": gram}).prior.covariance
    scale = np.sqrt(np.diag(expected))
    np.testing.assert_allclose(
        came.numpy() / scale / scale[:, None], expected / scale / scale[:, None], rtol=0, atol=1e-9
    )


@pytest.mark.parametrize("estimator", [EmpiricalCovariance(), ShrinkageCovariance(0.0)])
@pytest.mark.parametrize("environment", ["block", "regression"])
def test_without_regularisation_the_coordinates_do_not_matter(estimator: AbstractCovariance, environment: str) -> None:
    primitive = dmp()
    weights = demonstrated(9, primitive)
    plain = GaussianJointModel(estimator, environment)
    one, other = plain.fit(weights).prior, plain.fit(weights, grams={"robot": primitive.gram(SIZE, DURATION)}).prior
    scale = one.covariance.diagonal().sqrt()
    torch.testing.assert_close(
        other.covariance / scale / scale[:, None], one.covariance / scale / scale[:, None], rtol=0, atol=1e-8
    )


def alike(weights: dict[str, torch.Tensor]) -> dict[str, torch.Tensor]:
    return {block: rows[[0, 0, 0, 1, 1, 2]] for block, rows in weights.items()}


@pytest.mark.parametrize("repeated", [False, True])
@pytest.mark.parametrize("estimator", [EmpiricalCovariance(), ShrinkageCovariance(0.3), ShrinkageCovariance()])
def test_six_demonstrations_and_repeated_ones_leave_a_covariance(estimator: AbstractCovariance, repeated: bool) -> None:
    primitive = dmp(20)
    weights = demonstrated(6, primitive)
    if repeated:
        weights = alike(weights)
    prior = GaussianJointModel(estimator).fit(weights, grams={"robot": primitive.gram(SIZE, DURATION)}).prior
    assert torch.equal(prior.covariance, prior.covariance.mT)
    scale = prior.covariance.diagonal().sqrt()
    assert float(torch.linalg.eigvalsh(prior.covariance / scale / scale[:, None]).min()) > -1e-10
    np.testing.assert_allclose(prior.mean, torch.cat(list(weights.values()), -1).mean(0), rtol=1e-12)


@pytest.mark.parametrize("amount", [0.3, None])
@pytest.mark.parametrize(("robot", "human", "scene"), [(1e-3, 1.0, 1.0), (50.0, 1e3, 0.02)])
def test_units_change_nothing_but_the_units(amount: float | None, robot: float, human: float, scene: float) -> None:
    primitive = dmp()
    weights, grams = demonstrated(14, primitive), {"robot": primitive.gram(SIZE, DURATION)}
    model, groups = GaussianJointModel(ShrinkageCovariance(amount)), [i % 4 for i in range(14)]
    factors = {"human": human, "robot": robot, "environment": scene}
    other = {block: rows * factors[block] for block, rows in weights.items()}
    before = model.fit(weights, groups=groups, grams=grams).prior.covariance
    after = model.fit(other, groups=groups, grams=grams).prior.covariance
    units = torch.cat([torch.full_like(rows[0], factors[block]) for block, rows in weights.items()])
    scale = before.diagonal().sqrt() * units
    torch.testing.assert_close(
        after / scale / scale[:, None], before * units * units[:, None] / scale / scale[:, None], rtol=0, atol=1e-8
    )


def test_weights_in_other_units_with_their_gram_matrix_are_the_same_motions() -> None:
    primitive = dmp()
    weights, gram = demonstrated(14, primitive), primitive.gram(SIZE, DURATION)
    units = 10.0 ** torch.linspace(-3, 3, gram.shape[-1], dtype=torch.float64)
    model = GaussianJointModel(ShrinkageCovariance(0.3))
    before = model.fit(weights, grams={"robot": gram}).prior
    other = weights | {"robot": weights["robot"] * units}
    after = model.fit(other, grams={"robot": gram / units / units[:, None]}).prior
    robot = before.layout.slice("robot")
    scale = before.covariance[robot, robot].diagonal().sqrt()
    one, two = before.covariance[robot, robot], after.covariance[robot, robot] / units / units[:, None]
    torch.testing.assert_close(two / scale / scale[:, None], one / scale / scale[:, None], rtol=0, atol=1e-8)


@pytest.mark.parametrize("environment", ["block", "regression"])
@pytest.mark.parametrize(
    ("grams", "message"), [({"robot": torch.eye(4)}, r"\(24, 24\)"), ({"dog": torch.eye(4)}, "dog")]
)
def test_gram_matrices_that_fit_no_block(grams: dict[str, torch.Tensor], message: str, environment: str) -> None:
    with pytest.raises(ShapeError, match=message):
        GaussianJointModel(environment=environment).fit(demonstrated(6, dmp()), grams=grams)


def test_candidates_are_five_amounts_unless_one_is_given() -> None:
    models = GaussianJointModel(environment="regression").candidates()
    assert [model.covariance for model in models] == [ShrinkageCovariance(a) for a in (0.001, 0.01, 0.1, 0.3, 0.6)]
    assert {model.environment for model in models} == {"regression"}
    for estimator in (ShrinkageCovariance(0.02), ShrinkageCovariance(0.0), EmpiricalCovariance()):
        assert estimator.candidates() == (estimator,)
        assert [model.covariance for model in GaussianJointModel(estimator).candidates()] == [estimator]

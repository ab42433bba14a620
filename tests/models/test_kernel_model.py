from __future__ import annotations

import numpy as np
import pytest
import torch
from scipy.linalg import block_diag
from scipy.stats import multivariate_normal

from eaip_prob.config import build, conf_dir
from eaip_prob.errors import InputError, NotFittedError, ShapeError
from eaip_prob.models import (
    AbstractJointModel,
    EmpiricalCovariance,
    GaussianJointModel,
    KernelJointModel,
    LowRankCovariance,
    Posterior,
    ShrinkageCovariance,
)
from eaip_prob.observation import LinearObservation

SIZES = {"human": 5, "robot": 4, "environment": 3}
HUMAN, ROBOT, SCENE = slice(0, 5), slice(5, 9), slice(9, 12)
LEAST = 1e-12


def weights(num: int = 30, seed: int = 0) -> dict[str, torch.Tensor]:
    """Motions that depend on the squares of the features, which have different units and means."""
    generator = torch.Generator().manual_seed(seed)
    scene = torch.randn(num, 3, generator=generator, dtype=torch.float64)
    causes = torch.cat([scene, scene.square()], -1)
    blocks = {}
    for block in ("human", "robot"):
        mixing = torch.randn(6, SIZES[block], generator=generator, dtype=torch.float64)
        own = 0.4 * torch.randn(num, SIZES[block], generator=generator, dtype=torch.float64)
        blocks[block] = (causes @ mixing + own) * torch.logspace(-1, 2, SIZES[block], dtype=torch.float64) + 7.0
    return blocks | {"environment": scene * torch.tensor([2.0, 40.0, 0.1]) + torch.tensor([1.0, -30.0, 5.0])}


def table(blocks: dict[str, torch.Tensor]) -> np.ndarray:
    return np.concatenate([blocks[name].numpy() for name in SIZES], -1)


def gram() -> torch.Tensor:
    root = torch.randn(4, 6, generator=torch.Generator().manual_seed(9), dtype=torch.float64)
    return root @ root.mT


def scene_seen(batch: tuple[int, ...] = (), seed: int = 3, rows: int = 2, masked: bool = False) -> LinearObservation:
    """Mixtures of the features, with an offset and correlated noise."""
    generator = torch.Generator().manual_seed(seed)
    units = torch.tensor([2.0, 40.0, 0.1], dtype=torch.float64)
    matrix = torch.randn(*batch, rows, 3, generator=generator, dtype=torch.float64) / units
    value = torch.randn(*batch, rows, generator=generator, dtype=torch.float64) + matrix @ torch.tensor(
        [1.0, -30.0, 5.0], dtype=torch.float64
    )
    root = 0.5 * torch.randn(rows, rows, generator=generator, dtype=torch.float64)
    mask = (torch.arange(rows) != 1).expand(*batch, rows) if masked else None
    return LinearObservation(
        {"environment": matrix}, torch.full((rows,), 0.3), value + 0.3, root @ root.mT, mask, correlated=True
    )


def human_seen(batch: tuple[int, ...] = (), seed: int = 5) -> LinearObservation:
    generator = torch.Generator().manual_seed(seed)
    matrix = torch.randn(*batch, 3, 5, generator=generator, dtype=torch.float64)
    value = 5.0 * torch.randn(*batch, 3, generator=generator, dtype=torch.float64) + 7.0
    return LinearObservation({"human": matrix}, torch.zeros(3), value, torch.tensor([0.5, 0.7, 1.1]))


def slow_weights(
    values: np.ndarray, seen: LinearObservation, at: tuple[int, ...], bandwidth: float, floor: float
) -> np.ndarray:
    features = values[:, SCENE]
    rows = np.ones(seen.value.shape[-1], dtype=bool) if seen.mask is None else seen.mask[at].numpy()
    design = seen.matrices["environment"][at].numpy()[rows]
    noise = seen.noise.expand(*seen.value.shape, seen.value.shape[-1])[at].numpy()[np.ix_(rows, rows)]
    value, offset = seen.value[at].numpy()[rows], seen.offset.expand(seen.value.shape)[at].numpy()[rows]
    spread = np.diag(((features - features.mean(0)) ** 2).mean(0))
    inverse = np.linalg.inv(noise + bandwidth**2 * design @ spread @ design.T)
    misfits = [value - design @ phi - offset for phi in features]
    weight = np.array([np.exp(-0.5 * misfit @ inverse @ misfit) + floor for misfit in misfits])
    return weight / weight.sum()


def slow_joint(
    values: np.ndarray, weight: np.ndarray, amount: float, forward: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Weighted regression on the features by least squares, its residuals shrunk in the coordinates."""
    num = len(values)
    mean = sum(w * row for w, row in zip(weight, values, strict=True))
    factor = (1 - 1 / num) / (1 - (weight**2).sum())
    centred = np.sqrt(factor * weight)[:, None] * (values - mean) @ forward.T
    inputs = centred[:, SCENE]
    explained = inputs @ np.linalg.lstsq(inputs, centred, rcond=1e-10)[0]
    rest = (centred - explained).T @ (centred - explained)
    inner = explained.T @ explained + (1 - amount) * rest + amount * np.diag(np.diag(rest))
    back = np.linalg.inv(forward)
    return mean, back @ inner @ back.T


def slow_posterior(
    mean: np.ndarray, cov: np.ndarray, parts: list[tuple[slice, LinearObservation]], at: tuple[int, ...]
) -> tuple[np.ndarray, np.ndarray, float]:
    designs, residuals, noises = [], [], []
    for where, seen in parts:
        rows = np.ones(seen.value.shape[-1], dtype=bool) if seen.mask is None else seen.mask[at].numpy()
        (matrix,) = seen.matrices.values()
        design = np.zeros((len(rows), 12))
        design[:, where] = matrix[at]
        residual = (seen.value - seen.offset).numpy()[at] - design @ mean
        noise = seen.noise.numpy() if seen.correlated else np.diag(seen.noise.numpy())
        designs, residuals = [*designs, design[rows]], [*residuals, residual[rows]]
        noises.append(noise[np.ix_(rows, rows)])
    design, residual = np.concatenate(designs), np.concatenate(residuals)
    innovation = design @ cov @ design.T + block_diag(*noises)
    gain = cov @ design.T @ np.linalg.inv(innovation)
    evidence = multivariate_normal.logpdf(residual, cov=0.5 * (innovation + innovation.T))
    return mean + gain @ residual, cov - gain @ design @ cov, float(evidence)


def assert_same(one: Posterior, other: Posterior, tolerance: float = LEAST) -> None:
    torch.testing.assert_close(one.components.mean, other.components.mean, rtol=tolerance, atol=tolerance)
    scale = other.components.covariance.diagonal(dim1=-2, dim2=-1).sqrt()
    scale = scale[..., :, None] * scale[..., None, :]
    torch.testing.assert_close(
        one.components.covariance / scale, other.components.covariance / scale, rtol=0, atol=tolerance
    )
    torch.testing.assert_close(one.log_evidence, other.log_evidence, rtol=tolerance, atol=tolerance)


@pytest.mark.parametrize("masked", [False, True])
@pytest.mark.parametrize("batch", [(), (4,), (2, 3)])
def test_weights_against_a_loop(batch: tuple[int, ...], masked: bool) -> None:
    model = KernelJointModel(bandwidth=0.7, floor=0.01).fit(weights())
    assert model.fitted is not None
    seen = scene_seen(batch, masked=masked)
    came = model.fitted.weights([seen])
    assert came is not None and came.shape == (*batch, 30)
    for at in np.ndindex(*batch):
        np.testing.assert_allclose(came[at], slow_weights(table(weights()), seen, at, 0.7, 0.01), rtol=1e-9)


def test_weights_of_standardised_features() -> None:
    rows = weights()
    model = KernelJointModel(bandwidth=0.6, floor=0.002).fit(rows)
    assert model.fitted is not None
    scene = rows["environment"]
    seen = LinearObservation({"environment": torch.eye(3)}, torch.zeros(3), scene[4] + 0.01, torch.zeros(3))
    distance = (((scene - scene[4] - 0.01) / scene.std(0, correction=0)) ** 2).sum(-1)
    expected = torch.exp(-distance / 2 / 0.6**2) + 0.002
    torch.testing.assert_close(model.fitted.weights([seen]), expected / expected.sum(), rtol=1e-9, atol=0)


@pytest.mark.parametrize("masked", [False, True])
@pytest.mark.parametrize("with_gram", [False, True])
@pytest.mark.parametrize("amount", [0.0, 0.3])
def test_posterior_against_numpy(amount: float, with_gram: bool, masked: bool) -> None:
    grams = {"robot": gram()} if with_gram else {}
    model = KernelJointModel(ShrinkageCovariance(amount), bandwidth=0.8).fit(weights(), grams=grams)
    assert model.fitted is not None
    forward = model.fitted.coordinates.forward.numpy()
    if with_gram:
        np.testing.assert_allclose(forward[ROBOT, ROBOT].T @ forward[ROBOT, ROBOT], gram(), atol=1e-9)
    scene, human = scene_seen((2, 3), masked=masked), human_seen((2, 3))
    came = model.posterior([human, scene], keep=("robot", "human"))
    assert came.log_weight.shape == (2, 3)
    values = table(weights())
    for at in np.ndindex(2, 3):
        mean, cov = slow_joint(values, slow_weights(values, scene, at, 0.8, 0.002), amount, forward)
        mean, cov, evidence = slow_posterior(mean, cov, [(HUMAN, human), (SCENE, scene)], at)
        order = np.r_[ROBOT, HUMAN]
        np.testing.assert_allclose(came.components.mean[at], mean[order], rtol=1e-7)
        scale = np.sqrt(np.diag(cov)[order])
        np.testing.assert_allclose(
            came.components.covariance[at].numpy() / scale / scale[:, None],
            cov[np.ix_(order, order)] / scale / scale[:, None],
            atol=1e-7,
        )
        single = model.posterior([pick(human, at), pick(scene, at)])
        assert float(single.log_evidence) == pytest.approx(evidence, rel=1e-8)


def pick(seen: LinearObservation, at: tuple[int, ...]) -> LinearObservation:
    mask = None if seen.mask is None else seen.mask[at]
    matrices = {block: matrix[at] for block, matrix in seen.matrices.items()}
    return LinearObservation(matrices, seen.offset, seen.value[at], seen.noise, mask, seen.correlated)


NOTHING = {
    "no scene": [],
    "all masked": [
        LinearObservation(
            {"environment": torch.eye(3)}, torch.zeros(3), torch.ones(3), torch.ones(3), torch.zeros(3).bool()
        )
    ],
    "gate closed": [
        LinearObservation({"environment": torch.zeros(3, 3)}, torch.ones(3), 5 * torch.ones(3), torch.ones(3))
    ],
    "far from everything": [
        LinearObservation({"environment": torch.eye(3)}, torch.zeros(3), torch.full((3,), 1e4), torch.ones(3))
    ],
    "another block too": [
        LinearObservation(
            {"environment": torch.ones(1, 3), "robot": torch.ones(1, 4)}, torch.zeros(1), torch.ones(1), torch.ones(1)
        )
    ],
}


@pytest.mark.parametrize("with_gram", [False, True])
@pytest.mark.parametrize("estimator", [ShrinkageCovariance(0.2), EmpiricalCovariance(), ShrinkageCovariance()])
@pytest.mark.parametrize("case", NOTHING)
def test_what_says_nothing_about_the_scene_leaves_the_gaussian_model(
    case: str, estimator: ShrinkageCovariance | EmpiricalCovariance, with_gram: bool
) -> None:
    grams = {"robot": gram()} if with_gram else {}
    kernel, plain = (
        model.fit(weights(), grams=grams) for model in (KernelJointModel(estimator), GaussianJointModel(estimator))
    )
    seen = [human_seen((2, 3)), *NOTHING[case]]
    assert_same(kernel.posterior(seen), plain.posterior(seen))
    assert torch.equal(kernel.prior.covariance, plain.prior.covariance)
    assert torch.equal(kernel.prior.mean, plain.prior.mean)


@pytest.mark.parametrize("bandwidth", [float("inf"), 1e9])
def test_a_wide_kernel_is_the_gaussian_model(bandwidth: float) -> None:
    kernel = KernelJointModel(ShrinkageCovariance(0.2), bandwidth, floor=1.0).fit(weights())
    plain = GaussianJointModel(ShrinkageCovariance(0.2)).fit(weights())
    seen = [human_seen((2, 3)), scene_seen((2, 3))]
    assert_same(kernel.posterior(seen), plain.posterior(seen))
    assert_same(kernel.posterior(seen[1:]), plain.posterior(seen[1:]))


def test_batch_is_a_loop_and_members_may_share_the_scene() -> None:
    model = KernelJointModel(ShrinkageCovariance(0.1), 0.8).fit(weights(), grams={"robot": gram()})
    human, scene = human_seen((2, 3)), scene_seen((2, 1))
    log_weight = torch.log_softmax(torch.tensor([0.1, 0.9, 0.4], dtype=torch.float64), -1)
    together = model.posterior([human, scene], log_weight)
    for i in range(2):
        alone = model.posterior([pick(human, (i,)), pick(scene, (i,))], log_weight)
        torch.testing.assert_close(together.mean("robot")[i], alone.mean("robot"), rtol=1e-10, atol=1e-10)
        torch.testing.assert_close(together.covariance("robot")[i], alone.covariance("robot"), rtol=1e-8, atol=1e-10)
    same = scene_seen((1,))
    many = LinearObservation(
        {"environment": same.matrices["environment"].expand(2, 1, 2, 3)},
        same.offset,
        same.value.expand(2, 1, 2),
        same.noise,
        correlated=True,
    )
    assert_same(model.posterior([human, many]), model.posterior([human, same]), 1e-10)


def test_two_observations_of_the_scene_are_one() -> None:
    model = KernelJointModel(ShrinkageCovariance(0.1), 0.5).fit(weights())
    assert model.fitted is not None
    value, noise = torch.tensor([2.0, 10.0, 5.1], dtype=torch.float64), torch.tensor([0.5, 30.0, 0.01])
    eye, zero = torch.eye(3), torch.zeros(3)
    whole = LinearObservation({"environment": eye}, zero, value, noise)
    parts = [
        LinearObservation({"environment": eye[i]}, zero[i], value[i].expand(2, len(i)), noise[i])
        for i in (torch.tensor([2, 0]), torch.tensor([1]))
    ]
    expected, came = model.fitted.weights([whole]), model.fitted.weights(parts)
    assert expected is not None and came is not None and came.shape == (1, 30)
    torch.testing.assert_close(came[0], expected, rtol=1e-10, atol=0)


def test_a_feature_that_never_varied_weighs_nothing() -> None:
    rows = weights()
    rows["environment"][:, 1] = 4.0
    model = KernelJointModel(bandwidth=0.7).fit(rows)
    assert model.fitted is not None
    weight = []
    for value in (4.0, 900.0):
        given = torch.tensor([1.2, value, 5.0])
        seen = LinearObservation({"environment": torch.eye(3)}, torch.zeros(3), given, torch.zeros(3))
        weight.append(model.fitted.weights([seen]))
    assert weight[0] is not None and float(weight[0].max() / weight[0].min()) > 2
    assert torch.equal(weight[0], weight[1])


def test_a_feature_that_never_varied_is_left_out_of_correlated_noise() -> None:
    rows = weights()
    rows["environment"][:, 1] = 4.0
    model = KernelJointModel(bandwidth=0.7).fit(rows)
    assert model.fitted is not None
    value, root = torch.tensor([1.2, 4.3, 5.0]), torch.tensor([[1.0, 0, 0], [2.0, 0.1, 0], [0.1, 0.05, 0.1]])
    noise, kept = root @ root.mT, torch.tensor([0, 2])
    whole = LinearObservation({"environment": torch.eye(3)}, torch.zeros(3), value, noise, correlated=True)
    rest = LinearObservation(
        {"environment": torch.eye(3)[kept]}, torch.zeros(2), value[kept], noise[kept[:, None], kept], correlated=True
    )
    one, other = model.fitted.weights([whole]), model.fitted.weights([rest])
    assert one is not None and other is not None
    torch.testing.assert_close(one, other, rtol=1e-10, atol=0)


def test_noise_widens_the_kernel() -> None:
    model = KernelJointModel(bandwidth=0.3).fit(weights())
    assert model.fitted is not None
    effective = []
    for noise in (0.0, 1.0, 1e6):
        variance = noise * torch.tensor([4.0, 1600.0, 0.01])
        seen = LinearObservation(
            {"environment": torch.eye(3)}, torch.zeros(3), torch.tensor([1.0, -30.0, 5.0]), variance
        )
        weight = model.fitted.weights([seen])
        assert weight is not None
        effective.append(float(1.0 / weight.square().sum()))
    assert effective[0] < 5 < effective[1] < effective[2] <= 30.0
    assert effective[2] == pytest.approx(30.0, rel=1e-3)


def test_few_neighbours_spread_as_much_as_the_motions_do() -> None:
    num, draws = 12, 400
    generator = torch.Generator().manual_seed(1)
    ratio = []
    for _ in range(draws):
        human = 3.0 * torch.randn(num, 2, generator=generator, dtype=torch.float64) + 5.0
        scene = torch.linspace(0, 1, num, dtype=torch.float64)[:, None]
        model = KernelJointModel(EmpiricalCovariance(), 0.3).fit({"human": human, "environment": scene}, target="human")
        seen = LinearObservation({"environment": torch.eye(1)}, torch.zeros(1), torch.tensor([0.45]), torch.zeros(1))
        assert model.fitted is not None
        weight = model.fitted.weights([seen])
        assert weight is not None and float(1 / weight.square().sum()) < 6
        ratio.append(model.fitted.near([seen]).block_covariance("human").diagonal())
    spread = torch.cat(ratio)
    expected = 9.0 * (1 - 1 / num)
    # Both weights of a draw are independent, so that the error is that of 2 x 400 values.
    assert abs(float(spread.mean()) - expected) < 4 * float(spread.std()) / (2 * draws) ** 0.5


def test_units_change_nothing_but_the_units() -> None:
    rows, factors = weights(), {"human": 1e-3, "robot": 1.0, "environment": 1e3}
    model = KernelJointModel(ShrinkageCovariance(0.3), 0.8)
    before = model.fit(rows)
    after = model.fit({name: part * factors[name] for name, part in rows.items()})
    value = torch.tensor([2.0, 10.0, 5.1], dtype=torch.float64)
    noise = torch.tensor([0.5, 30.0, 0.01], dtype=torch.float64)
    one = LinearObservation({"environment": torch.eye(3)}, torch.zeros(3), value, noise)
    other = LinearObservation({"environment": torch.eye(3)}, torch.zeros(3), 1e3 * value, 1e6 * noise)
    first, second = before.posterior([one]), after.posterior([other])
    torch.testing.assert_close(second.mean("robot"), first.mean("robot"), rtol=1e-7, atol=0)
    torch.testing.assert_close(second.mean("human"), 1e-3 * first.mean("human"), rtol=1e-7, atol=0)
    torch.testing.assert_close(second.covariance("robot"), first.covariance("robot"), rtol=1e-6, atol=1e-8)


def test_what_no_regression_on_the_features_shows() -> None:
    generator = torch.Generator().manual_seed(2)
    scene = 2 * torch.rand(80, 1, generator=generator, dtype=torch.float64) - 1
    human = scene.abs() + 0.02 * torch.randn(80, 1, generator=generator, dtype=torch.float64)
    rows = {"human": human, "environment": scene}
    kernel, plain = (
        model.fit(rows, target="human")
        for model in (KernelJointModel(ShrinkageCovariance(0.1), 0.3), GaussianJointModel(ShrinkageCovariance(0.1)))
    )
    at = torch.tensor([-0.8, 0.0, 0.7])[:, None, None]
    seen = LinearObservation({"environment": torch.eye(1)}, torch.zeros(1), at, torch.full((1,), 1e-6))
    errors = [(model.posterior([seen]).mean("human") - at[:, 0].abs()).abs().max() for model in (kernel, plain)]
    assert errors[0] < 0.15 < 0.3 < errors[1]


def test_the_amount_is_chosen_once_with_equal_weights() -> None:
    rows, groups = weights(20), [i // 4 for i in range(20)]
    model = KernelJointModel().fit(rows, groups=groups)
    assert model.fitted is not None
    folds = [torch.arange(4 * i, 4 * i + 4) for i in range(5)]
    chosen = ShrinkageCovariance.chosen_amount(
        torch.from_numpy(table(rows)), folds, torch.arange(5, 9), torch.arange(9, 12)
    )
    assert model.fitted.covariance == ShrinkageCovariance(chosen)
    assert model.fitted.bandwidth == 1.5


def test_candidates() -> None:
    amounts = KernelJointModel(floor=0.1).candidates()
    expected = [(None, ShrinkageCovariance(amount)) for amount in (0.001, 0.01, 0.1, 0.3, 0.6)]
    assert [(model.bandwidth, model.covariance) for model in amounts] == expected
    models = amounts[3].candidates()
    assert [(model.bandwidth, model.covariance) for model in models] == [(h, expected[3][1]) for h in (1.0, 1.5, 3.0)]
    assert {model.floor for model in (*amounts, *models)} == {0.1}
    assert len(models[1].candidates()) == 1
    given = KernelJointModel(EmpiricalCovariance(), 2.0)
    assert [(m.bandwidth, m.covariance) for m in given.candidates()] == [(2.0, EmpiricalCovariance())]


def test_without_an_environment_block() -> None:
    rows = {name: part for name, part in weights().items() if name != "environment"}
    kernel, plain = KernelJointModel().fit(rows), GaussianJointModel().fit(rows)
    assert_same(kernel.posterior([human_seen()]), plain.posterior([human_seen()]))
    with pytest.raises(InputError, match="environment"):
        kernel.posterior([scene_seen()])


def test_features_that_do_not_fit_the_block() -> None:
    seen = LinearObservation({"environment": torch.eye(2)}, torch.zeros(2), torch.zeros(2), torch.ones(2))
    with pytest.raises(ShapeError, match="3 columns"):
        KernelJointModel().fit(weights()).posterior([seen])


def test_features_that_were_not_observed_are_completed() -> None:
    rows, mask = weights(), torch.ones(30, 3, dtype=torch.bool)
    mask[::5, 1] = False
    hidden = dict(rows, environment=torch.where(mask, rows["environment"], torch.nan))
    came = KernelJointModel(ShrinkageCovariance(0.1)).fit(hidden, {"environment": mask}).posterior([scene_seen()])
    assert bool(torch.isfinite(came.components.covariance).all())


def test_nothing_given_is_changed() -> None:
    rows = weights()
    before = {name: part.clone() for name, part in rows.items()}
    model = KernelJointModel()
    fitted = model.fit(rows)
    fitted.posterior([scene_seen((2,))])
    assert model.fitted is None
    assert all(torch.equal(rows[name], before[name]) for name in rows)


def test_input_that_cannot_be_used() -> None:
    with pytest.raises(NotFittedError, match="fitted joint model"):
        KernelJointModel().posterior([])
    with pytest.raises(InputError, match="takes moments, got LowRankCovariance"):
        KernelJointModel(LowRankCovariance())
    with pytest.raises(InputError, match="takes moments, got LowRankCovariance"):
        LowRankCovariance().from_moments(torch.eye(2), torch.tensor([0]))
    for bandwidth in (0.0, -1.0, float("nan")):
        with pytest.raises(InputError, match="bandwidth above 0"):
            KernelJointModel(bandwidth=bandwidth)
    for floor in (0.0, 1e-9, 2.0, float("nan")):
        with pytest.raises(InputError, match="floor from"):
            KernelJointModel(floor=floor)


@pytest.mark.parametrize(
    ("option", "model"),
    [("kernel", KernelJointModel()), ("low_rank", GaussianJointModel(LowRankCovariance()))],
)
def test_options_of_the_configuration(option: str, model: AbstractJointModel) -> None:
    from hydra import compose, initialize_config_dir

    with initialize_config_dir(str(conf_dir()), version_base=None):
        cfg = compose("passing_over", [f"model={option}"])
        built = build(cfg.predictor.model)
    assert type(built) is type(model)
    assert built.candidates()[0].covariance == model.candidates()[0].covariance


def test_the_scene_first_and_the_motion_later() -> None:
    model = KernelJointModel(ShrinkageCovariance(0.1), 0.8).fit(weights())
    scene, human = scene_seen((1,)), human_seen((3,))
    later = model.posterior([scene]).components.condition([human])
    once = model.posterior([scene, human]).components
    torch.testing.assert_close(later.mean, once.mean, rtol=1e-9, atol=1e-9)
    scale = once.covariance.diagonal(dim1=-2, dim2=-1).sqrt()
    scale = scale[..., :, None] * scale[..., None, :]
    torch.testing.assert_close(later.covariance / scale, once.covariance / scale, rtol=0, atol=1e-8)

from __future__ import annotations

import itertools
import warnings

import numpy as np
import pytest
import torch
from scipy.stats import multivariate_normal
from torch import Tensor

from eaip_prob import conditioning
from eaip_prob.errors import InputError, NotPositiveDefiniteError, ShapeError
from eaip_prob.gaussian import BlockGaussian, BlockLayout
from eaip_prob.observation import LinearObservation, SharedDesignObservation

D, T, B = 2, 9, 3
LAYOUT = BlockLayout({"human": D * B, "robot": 4, "environment": 2})
UNITS = torch.cat([torch.full((6,), 100.0), torch.full((4,), 0.01), torch.ones(2)]).double()
NAN = float("nan")


def randn(*shape: int, seed: int = 0) -> Tensor:
    return torch.randn(*shape, generator=torch.Generator().manual_seed(seed), dtype=torch.float64)


def prior(*batch: int, rank: int = 40, covariance_batch: bool = True) -> BlockGaussian:
    rows = randn(*(batch if covariance_batch else ()), rank, LAYOUT.total)
    rows = (rows + 0.5 * rows[..., :1]) * UNITS
    return BlockGaussian((3.0 + randn(*batch, LAYOUT.total, seed=1)) * UNITS, rows.mT @ rows / rank, LAYOUT)


def motion(*batch: int, noise: float = 4.0, correlated: bool = False, hide: bool = True) -> SharedDesignObservation:
    mask = torch.rand(*batch, D, T, generator=torch.Generator().manual_seed(2)) > (0.3 if hide else -1.0)
    variance = torch.full((D, 1), noise, dtype=torch.float64)
    if correlated:
        steps = randn(D, T, 2 * T, seed=3)
        variance = noise * (steps @ steps.mT / T + torch.eye(T))
    value, design = 30 + 100 * randn(*batch, D, T, seed=4), randn(T, B, seed=5)
    return SharedDesignObservation("human", design, 5 * randn(D, T, seed=6), value, variance, mask, correlated)


def relation(*batch: int, noise: float = 0.5) -> LinearObservation:
    matrices = {"robot": 100 * randn(3, 4, seed=7), "human": 0.01 * randn(3, 6, seed=8)}
    mask = torch.tensor([True, False, True])
    value = randn(*batch, 3, seed=9)
    return LinearObservation(matrices, randn(3, seed=10), value, torch.full((3,), noise), mask)


def scene(*batch: int, noise: float = 0.2) -> LinearObservation:
    covariance = noise * torch.tensor([[2.0, 0.5], [0.5, 1.0]])
    return LinearObservation({"environment": torch.eye(2)}, torch.zeros(2), randn(*batch, 2), covariance, None, True)


def textbook(belief: BlockGaussian, observations) -> tuple[np.ndarray, np.ndarray, float]:
    """Seen rows only, dense, by numpy and scipy, for one member of a batch."""
    mean, covariance = belief.mean.numpy(), belief.covariance.numpy()
    matrices, residuals, noises = [], [], []
    for observation in observations:
        rows = observation.dense()
        seen = np.ones(rows.value.shape[-1], bool) if rows.mask is None else rows.mask.numpy()
        matrix = np.zeros((len(seen), belief.layout.total))
        for block, part in rows.matrices.items():
            matrix[:, belief.layout.slice(block)] = part
        noise = rows.noise.numpy() if rows.correlated else np.diag(rows.noise)
        matrices.append(matrix[seen])
        residuals.append((rows.value - rows.offset).numpy()[seen])
        noises.append(noise[np.ix_(seen, seen)])
    matrix, value = np.concatenate(matrices), np.concatenate(residuals)
    noise = torch.block_diag(*map(torch.as_tensor, noises)).numpy()
    innovation = matrix @ covariance @ matrix.T + noise
    gain = np.linalg.solve(innovation, matrix @ covariance).T
    evidence = multivariate_normal(matrix @ mean, innovation, allow_singular=True).logpdf(value)
    return mean + gain @ (value - matrix @ mean), covariance - gain @ matrix @ covariance, evidence


def assert_same(belief: BlockGaussian, mean, covariance, tolerance: float = 1e-9) -> None:
    """In units of the prior's standard deviations."""
    units = torch.cat([UNITS[LAYOUT.slice(block)] for block in belief.layout.names])
    got = belief.covariance.expand(*belief.mean.shape, belief.mean.shape[-1])
    covariance = torch.as_tensor(covariance).expand_as(got)
    scale = units[:, None] * units
    torch.testing.assert_close(belief.mean / units, torch.as_tensor(mean) / units, rtol=0, atol=tolerance)
    torch.testing.assert_close(got / scale, covariance / scale, rtol=0, atol=tolerance)


CASES = {
    "motion": [motion()],
    "all samples": [motion(hide=False)],
    "correlated": [motion(correlated=True)],
    "scene": [scene()],
    "several blocks": [relation()],
    "together": [scene(), motion(), relation()],
    "twice": [motion(), motion(noise=9.0)],
    "little noise": [relation(noise=1e-13), scene()],
    "mixed forms": [relation(noise=0.0), motion(), scene()],
}


@pytest.mark.parametrize(("case", "rank"), [(case, rank) for case in CASES for rank in (40, 5)] + [("together", 1)])
def test_conditioning_matches_the_textbook(case: str, rank: int) -> None:
    belief = prior(rank=rank)
    posterior, evidence = belief.update(CASES[case])
    mean, covariance, expected = textbook(belief, CASES[case])
    assert_same(posterior, mean, covariance, 1e-8)
    if rank == 40:
        assert float(evidence) == pytest.approx(expected, rel=1e-8)
        assert float(belief.log_evidence(CASES[case])) == pytest.approx(expected, rel=1e-8)


@pytest.mark.parametrize("batched", ["prior", "mean", "observations", "both"])
@pytest.mark.parametrize("noise", [0.5, 0.0])
def test_a_batch_equals_a_loop(batched: str, noise: float) -> None:
    before, after = (2, 3) if batched != "observations" else (), (2, 3) if batched in ("observations", "both") else ()
    belief = prior(*before, covariance_batch=batched != "mean")
    observations = [motion(*after), relation(*after, noise=noise), scene(*after)]
    posterior, evidence = belief.update(observations, keep=("environment", "robot"))
    covariances = posterior.covariance.expand(2, 3, 6, 6)
    assert posterior.mean.shape == (2, 3, 6) and evidence.shape == (2, 3)
    whole = belief.covariance.expand(2, 3, 12, 12)
    for index in itertools.product(range(2), range(3)):
        one = BlockGaussian(belief.mean.expand(2, 3, 12)[index], whole[index], LAYOUT)
        seen = [motion(2, 3), relation(2, 3, noise=noise), scene(2, 3)] if after else observations
        if after:
            moved = seen[0]
            assert isinstance(moved, SharedDesignObservation) and moved.mask is not None
            seen[0] = SharedDesignObservation(
                "human", moved.design, moved.offset, moved.value[index], moved.noise, moved.mask[index]
            )
            for place in (1, 2):
                rows = seen[place].dense()
                value = rows.value[index]
                seen[place] = LinearObservation(
                    rows.matrices, rows.offset, value, rows.noise, rows.mask, rows.correlated
                )
        mean, covariance, expected = textbook(one, seen)
        keep = LAYOUT.indices(("environment", "robot")).numpy()
        part = BlockGaussian(posterior.mean[index], covariances[index], posterior.layout)
        assert_same(part, mean[keep], covariance[np.ix_(keep, keep)], 1e-8)
        assert float(evidence[index]) == pytest.approx(expected, rel=1e-8)


@pytest.mark.parametrize("keep", [("robot",), ("human",), ("environment", "human"), ("robot", "environment")])
@pytest.mark.parametrize("rank", [40, 5])
@pytest.mark.parametrize("noise", [0.5, 0.0])
def test_fewer_blocks_are_the_marginal_of_all(keep: tuple[str, ...], rank: int, noise: float) -> None:
    belief, observations = prior(rank=rank), [motion(), relation(noise=noise), scene()]
    part, evidence = belief.update(observations, keep)
    whole, expected = belief.update(observations)
    marginal = whole.marginal(keep)
    assert part.layout.names == keep
    assert_same(part, marginal.mean, marginal.covariance)
    if rank == 40 or noise:
        assert float(evidence) == pytest.approx(float(expected), rel=1e-9)


@pytest.mark.parametrize("rank", [40, 5])
def test_shared_design_conditions_like_its_rows(rank: int) -> None:
    belief = prior(rank=rank)
    for observation in (motion(), motion(correlated=True)):
        shared, rows = belief.update([observation]), belief.update([observation.dense()])
        assert_same(shared[0], rows[0].mean, rows[0].covariance)
        assert float(shared[1]) == pytest.approx(float(rows[1]), rel=1e-10)


def test_vanishing_noise_meets_no_noise() -> None:
    belief = prior()
    exact, evidence = belief.update([relation(noise=0.0)])
    for noise in (1e-6, 1e-9, 1e-12, 1e-15):
        posterior, log_evidence = belief.update([relation(noise=noise)])
        assert_same(posterior, exact.mean, exact.covariance, 10 * noise + 1e-9)
        assert float(log_evidence) == pytest.approx(float(evidence), abs=1e4 * noise + 1e-7)


def via(value: float, noise: float = 0.0) -> LinearObservation:
    matrix = torch.tensor([[0.0, 1.0, 0.5, -2.0]], dtype=torch.float64)
    return LinearObservation(
        {"robot": matrix}, torch.ones(1), torch.tensor([value], dtype=torch.float64), torch.full((1,), noise)
    )


@pytest.mark.parametrize("rank", [40, 5, 3])
@pytest.mark.parametrize("repeats", [1, 2, 5])
def test_via_points_are_hit_however_often_they_are_given(rank: int, repeats: int) -> None:
    belief = once = prior(rank=rank).condition([via(1.1)])
    for _ in range(repeats):
        belief = belief.condition([via(1.1)])
    # Once a row is known, round-off of 1e-16 in the covariance is a deviation of 1e-8.
    assert_same(belief, once.mean, once.covariance, 1e-7)
    matrix = via(1.1).matrices["robot"]
    hit = belief.affine("robot", matrix, torch.ones(1))
    assert float(hit.mean) == pytest.approx(1.1, abs=1e-9)
    assert abs(float(hit.covariance)) < 1e-15
    draws = belief.sample(50, torch.Generator().manual_seed(0))[:, LAYOUT.slice("robot")] @ matrix[0] + 1.0
    torch.testing.assert_close(draws, torch.full_like(draws, 1.1), rtol=0, atol=1e-7)


def test_a_weight_that_is_known_exactly_stays_known() -> None:
    first = LinearObservation({"robot": torch.eye(4)[:2]}, torch.zeros(2), torch.ones(2), torch.zeros(2))
    belief = prior().condition([first])
    again = belief.condition([first, motion(), first])
    expected = prior().condition([motion(), first])
    assert_same(again, expected.mean, expected.covariance)
    assert float(again.covariance.diagonal().amin()) >= 0.0


@pytest.mark.parametrize("rank", [40, 3])
def test_the_same_via_point_twice_in_one_observation(rank: int) -> None:
    one = via(1.1)
    two = LinearObservation(
        {"robot": one.matrices["robot"].expand(2, 4)},
        torch.ones(2),
        torch.full((2,), 1.1, dtype=torch.float64),
        torch.zeros(2),
    )
    belief = prior(rank=rank)
    assert_same(belief.condition([two]), *(lambda b: (b.mean, b.covariance))(belief.condition([one])), 1e-8)


def test_log_prob_and_marginal_match_scipy() -> None:
    belief, value = prior(2, 3), (3 + randn(2, 3, 12, seed=11)) * UNITS
    # scipy is given unit scales: its pseudo-inverse loses digits where blocks have different units.
    covariance, deviation = belief.covariance / UNITS[:, None] / UNITS, (value - belief.mean) / UNITS
    for index in itertools.product(range(2), range(3)):
        expected = multivariate_normal(np.zeros(12), covariance[index].numpy()).logpdf(deviation[index].numpy())
        assert float(belief.log_prob(value)[index] + UNITS.log().sum()) == pytest.approx(expected, rel=1e-9)
    part = belief.marginal(["environment", "human"])
    order = [10, 11, 0, 1, 2, 3, 4, 5]
    assert part.layout.names == ("environment", "human") and belief.marginal(LAYOUT.names) is belief
    assert torch.equal(part.mean, belief.mean[..., order])
    assert torch.equal(part.covariance, belief.covariance[..., order, :][..., order])
    assert torch.equal(belief.block_covariance("robot"), belief.covariance[..., 6:10, 6:10])


@pytest.mark.parametrize("batch", [(), (2, 3)])
@pytest.mark.parametrize("rank", [40, 3])
def test_samples_have_the_moments(batch: tuple[int, ...], rank: int) -> None:
    belief, num = prior(*batch, rank=rank), 20_000
    draws = (belief.sample(num, torch.Generator().manual_seed(3)) - belief.mean) / UNITS
    covariance = belief.covariance / UNITS[:, None] / UNITS
    variance = covariance.diagonal(dim1=-2, dim2=-1)
    assert draws.shape == (num, *batch, 12)
    # Five standard errors: sqrt(var / n) for a mean, sqrt((var var' + cov^2) / n) for a covariance.
    assert bool((draws.mean(0).abs() <= 5 * (variance / num).sqrt()).all())
    error = torch.einsum("n...i,n...j->...ij", draws, draws) / num - covariance
    spread = (variance[..., :, None] * variance[..., None, :] + covariance.square()) / num
    assert bool((error.abs() <= 5 * spread.sqrt()).all())


def test_conditioning_agrees_with_weighted_samples() -> None:
    """Importance sampling from the prior: weights are the likelihood, errors follow from the effective number."""
    belief = BlockGaussian(
        torch.tensor([1.0, -2.0]), torch.tensor([[4.0, 1.5], [1.5, 2.0]]), BlockLayout({"a": 1, "b": 1})
    )
    seen = LinearObservation({"a": 2 * torch.ones(1, 1)}, torch.ones(1), torch.tensor([6.0]), torch.tensor([9.0]))
    num = 200_000
    draws = belief.sample(num, torch.Generator().manual_seed(4))
    log_weight = -0.5 * ((6.0 - 1.0 - 2 * draws[:, 0]) ** 2 / 9.0 + np.log(2 * np.pi * 9.0))
    weight = log_weight.exp()
    posterior, evidence = belief.update([seen])
    share = weight / weight.sum()
    mean, effective = share @ draws, float(1 / share.square().sum())
    error = (posterior.covariance.diagonal() / effective).sqrt()
    assert bool(((mean - posterior.mean).abs() <= 5 * error).all())
    relative = float(weight.std() / weight.mean() / num**0.5)
    assert float(evidence.exp()) == pytest.approx(float(weight.mean()), rel=5 * relative)


@pytest.mark.parametrize("batch", [(), (2, 3)])
def test_affine_is_the_distribution_of_the_image(batch: tuple[int, ...]) -> None:
    belief, matrix, offset = prior(*batch), randn(5, 4), randn(5, seed=1)
    image = belief.affine("robot", matrix, offset, "position")
    expected = matrix.numpy() @ belief.covariance.numpy()[..., 6:10, 6:10] @ matrix.numpy().T
    np.testing.assert_allclose(image.mean, belief.mean[..., 6:10] @ matrix.T + offset, rtol=1e-12)
    np.testing.assert_allclose(image.covariance, expected, rtol=1e-9, atol=1e-15)
    assert image.layout.names == ("position",)


def test_pyro_has_the_same_density() -> None:
    belief, value = prior(2), (3 + randn(2, 12, seed=12)) * UNITS
    torch.testing.assert_close(belief.to_pyro().log_prob(value), belief.log_prob(value), rtol=1e-10, atol=0)


def test_nothing_is_written_into_the_arguments() -> None:
    belief, observations = prior(), [motion(), relation(noise=0.0), scene()]
    before = belief.mean.clone(), belief.covariance.clone(), observations[0].value.clone()
    first, _ = belief.update(observations)
    second, _ = belief.update(observations)
    assert torch.equal(belief.mean, before[0]) and torch.equal(belief.covariance, before[1])
    assert torch.equal(observations[0].value, before[2])
    assert torch.equal(first.mean, second.mean) and torch.equal(first.covariance, second.covariance)


def test_layout_positions() -> None:
    assert (LAYOUT.total, LAYOUT.names) == (12, ("human", "robot", "environment"))
    assert LAYOUT.indices(["environment", "human"]).tolist() == [10, 11, 0, 1, 2, 3, 4, 5]
    assert LAYOUT.positions(["human", "robot"]) == slice(0, 10)
    assert torch.equal(LAYOUT.positions(["environment", "robot"]), torch.tensor([10, 11, 6, 7, 8, 9]))  # type: ignore[arg-type]
    assert dict(LAYOUT.select(["robot"]).sizes) == {"robot": 4}


def wide(block: str = "human", columns: int = 5) -> LinearObservation:
    return LinearObservation({block: torch.ones(1, columns)}, torch.zeros(1), torch.ones(1), torch.ones(1))


BAD = {
    "unknown observed block": (lambda: prior().condition([wide("horse")]), InputError, r"among \('human'.*horse"),
    "unknown kept block": (lambda: prior().condition([scene()], keep=["horse"]), InputError, "among.*horse"),
    "kept twice": (lambda: prior().condition([scene()], keep=["robot", "robot"]), InputError, "different blocks"),
    "unknown marginal": (lambda: prior().marginal(["horse"]), InputError, "among.*horse"),
    "columns": (lambda: prior().condition([scene(), wide()]), ShapeError, "block 'human' with 6 columns, got 5"),
    "empty layout": (lambda: BlockLayout({}), InputError, "at least one block"),
    "empty block": (lambda: BlockLayout({"a": 0}), InputError, "sizes of at least 1"),
    "mean": (lambda: BlockGaussian(randn(3), torch.eye(12), LAYOUT), ShapeError, "mean with shape"),
    "covariance": (lambda: BlockGaussian(randn(12), torch.eye(3), LAYOUT), ShapeError, "covariance with shape"),
    "batch": (
        lambda: BlockGaussian(randn(12), torch.eye(12).expand(2, 12, 12), LAYOUT),
        ShapeError,
        "batch axes of the mean or fewer",
    ),
    "NaN mean": (lambda: BlockGaussian(NAN * randn(12), torch.eye(12), LAYOUT), InputError, "finite numbers in mean"),
    "NaN covariance": (
        lambda: BlockGaussian(randn(12), NAN * torch.eye(12), LAYOUT),
        InputError,
        "finite numbers in covariance",
    ),
    "negative covariance": (
        lambda: BlockGaussian(randn(12), -torch.eye(12), LAYOUT).condition([scene()]),
        NotPositiveDefiniteError,
        "semi-definite",
    ),
    "affine columns": (lambda: prior().affine("robot", randn(5, 3), randn(5)), ShapeError, "matrix with shape"),
    "affine offset": (lambda: prior().affine("robot", randn(5, 4), randn(4)), ShapeError, "offset with shape"),
    "value": (lambda: prior().log_prob(randn(3)), ShapeError, "value with shape"),
}


@pytest.mark.parametrize("case", BAD)
def test_bad_input_is_refused_by_name(case: str) -> None:
    call, error, match = BAD[case]
    with pytest.raises(error, match=match):
        call()


def test_no_matrix_grows_with_the_length(monkeypatch: pytest.MonkeyPatch) -> None:
    sizes: list[int] = []
    for name in ("safe_cholesky", "lapack_cholesky"):
        plain = getattr(conditioning, name)

        def recorded(matrix: Any, *args: str, plain: Any = plain) -> Any:
            sizes.append(matrix.shape[-1])
            return plain(matrix, *args)

        monkeypatch.setattr(conditioning, name, recorded)
    for batch in ((), (2,)):
        value, noise = randn(*batch, D, 500), torch.ones(D, 1)
        seen = SharedDesignObservation("human", randn(500, B), torch.zeros(1, 1), value, noise)
        prior().update([seen], keep=("robot",))
    assert sizes == [D * B, D * B]


@pytest.mark.parametrize("noise", [0.5, 0.0])
def test_a_prior_without_variance_learns_nothing(noise: float) -> None:
    sure = BlockGaussian(prior().mean, torch.zeros(12, 12), LAYOUT)
    posterior, evidence = sure.update([via(1.1, noise), scene()])
    assert_same(posterior, sure.mean, sure.covariance, 1e-12)
    assert bool(torch.isfinite(evidence))


def test_ordinary_rank_deficient_priors_do_not_warn() -> None:
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        prior(rank=2).condition([motion(), scene(), via(1.2)])

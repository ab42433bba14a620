from __future__ import annotations

import math

import pytest
import torch
from torch import Tensor

from eaip_prob import evaluation
from eaip_prob.data.trajectory import Trajectory, stack
from eaip_prob.errors import InputError, NotPositiveDefiniteError, ShapeError
from eaip_prob.evaluation.scoring import scored_mask

BATCHES = [(), (4,), (2, 3)]
FIELDS = ("mean", "variance", "truth", "mask")


def motions(batch: tuple[int, ...], seed: int = 0, num_samples: int = 7, num_signals: int = 2) -> dict[str, Tensor]:
    g = torch.Generator().manual_seed(seed)
    shape = (*batch, num_samples, num_signals)
    mean, truth = (torch.randn(shape, generator=g, dtype=torch.float64) * 3.0 + 40.0 for _ in range(2))
    variance = torch.rand(shape, generator=g, dtype=torch.float64) * 9.0 + 0.5
    mask = torch.rand(shape, generator=g) < 0.5
    mask[..., -1, 0] = True
    return {"mean": mean, "variance": variance, "truth": truth, "mask": mask}


def mixture(batch: tuple[int, ...], num_components: int = 3, seed: int = 5) -> dict[str, Tensor]:
    g = torch.Generator().manual_seed(seed)
    shape = (*batch, num_components, 7, 2)
    return {
        "means": torch.randn(shape, generator=g, dtype=torch.float64) * 4.0 + 40.0,
        "variances": torch.rand(shape, generator=g, dtype=torch.float64) * 5.0 + 0.3,
        "log_weight": torch.randn(shape[:-2], generator=g, dtype=torch.float64) - 700.0,
    }


def each_motion(batch: tuple[int, ...]) -> list[tuple[int, ...]]:
    return [tuple(int(i) for i in index) for index in torch.ones(batch).nonzero()] if batch else [()]


@pytest.mark.parametrize("batch", BATCHES)
def test_scores_equal_slow_loop(batch: tuple[int, ...]) -> None:
    m = motions(batch)
    error = evaluation.squared_error(m["mean"], m["truth"], m["mask"])
    density = evaluation.nll(**m)
    assert error.shape == density.shape == batch
    for index in each_motion(batch):
        squares, logs = [], []
        for t in range(7):
            for d in range(2):
                if m["mask"][(*index, t, d)]:
                    mean, variance, y = (float(m[key][(*index, t, d)]) for key in FIELDS[:3])
                    squares.append((y - mean) ** 2)
                    logs.append((y - mean) ** 2 / (2 * variance) + math.log(math.sqrt(2 * math.pi * variance)))
        assert float(error[index]) == pytest.approx(sum(squares) / len(squares), rel=1e-12)
        assert float(density[index]) == pytest.approx(sum(logs) / len(logs), rel=1e-12)


def test_nll_equals_torch_distributions() -> None:
    m = motions((2, 3))
    normal = torch.distributions.Normal(m["mean"], m["variance"].sqrt())
    everything = torch.ones_like(m["mask"])
    expected = -normal.log_prob(m["truth"]).mean((-2, -1))
    torch.testing.assert_close(evaluation.nll(**{**m, "mask": everything}), expected, rtol=1e-12, atol=0.0)


def test_nll_expectation_is_gaussian_entropy() -> None:
    g = torch.Generator().manual_seed(1)
    mean, variance = torch.full((1, 40_000, 1), 12.0, dtype=torch.float64), torch.tensor(6.25, dtype=torch.float64)
    truth = mean + variance.sqrt() * torch.randn(mean.shape, generator=g, dtype=torch.float64)
    score = evaluation.nll(mean, variance.expand_as(mean), truth, truth > -math.inf)
    entropy = 0.5 * math.log(2 * math.pi * math.e * 6.25)
    assert abs(float(score) - entropy) < 4 * math.sqrt(0.5 / 40_000)


@pytest.mark.parametrize("batch", BATCHES)
def test_mixture_nll_equals_torch_distributions(batch: tuple[int, ...]) -> None:
    m, mix = motions(batch), mixture(batch)
    components = torch.distributions.Normal(mix["means"].movedim(-3, -1), mix["variances"].movedim(-3, -1).sqrt())
    weights = torch.distributions.Categorical(logits=mix["log_weight"][..., None, None, :].expand(*batch, 7, 2, 3))
    log_prob = torch.distributions.MixtureSameFamily(weights, components).log_prob(m["truth"])
    expected = -torch.where(m["mask"], log_prob, 0.0).sum((-2, -1)) / m["mask"].sum((-2, -1))
    score = evaluation.gaussian_mixture_nll(**mix, truth=m["truth"], mask=m["mask"])
    torch.testing.assert_close(score, expected, rtol=1e-11, atol=0.0)


def test_mixture_of_one_or_of_equals_is_the_gaussian() -> None:
    m = motions((2, 3))
    expected = evaluation.nll(**m)
    for count in (1, 4):
        repeated = {key: m[key][..., None, :, :].expand(2, 3, count, 7, 2) for key in ("mean", "variance")}
        weight = torch.randn(2, 3, count, generator=torch.Generator().manual_seed(3), dtype=torch.float64)
        score = evaluation.gaussian_mixture_nll(repeated["mean"], repeated["variance"], weight, m["truth"], m["mask"])
        torch.testing.assert_close(score, expected)


def test_component_of_no_weight_is_left_out() -> None:
    m, mix = motions((4,)), mixture((4,))
    weight = mix["log_weight"].clone()
    weight[:, 2] = -math.inf
    both = evaluation.gaussian_mixture_nll(mix["means"], mix["variances"], weight, m["truth"], m["mask"])
    kept = evaluation.gaussian_mixture_nll(
        mix["means"][:, :2], mix["variances"][:, :2], weight[:, :2], m["truth"], m["mask"]
    )
    torch.testing.assert_close(both, kept)


def test_pooled_rmse_counts_motions_alike() -> None:
    truth = torch.zeros(2, 5, 1, dtype=torch.float64)
    mean = torch.tensor([3.0, 1.0], dtype=torch.float64)[:, None, None].expand(2, 5, 1)
    mask = torch.tensor([[False] * 4 + [True], [True] * 5])
    assert float(evaluation.rmse(mean, truth, mask)) == pytest.approx(math.sqrt(5.0))
    assert evaluation.motion_rmse(mean, truth, mask).tolist() == [3.0, 1.0]


@pytest.mark.parametrize("poison", [float("nan"), float("inf"), 1e300])
def test_unscored_samples_are_never_read(poison: float) -> None:
    m, mix = motions((2, 3)), mixture((2, 3))
    hidden = ~m["mask"]
    bad = {key: m[key].masked_fill(hidden, poison) for key in FIELDS[:3]}
    bad_mix = {key: mix[key].masked_fill(hidden[..., None, :, :], poison) for key in ("means", "variances")}
    assert torch.equal(evaluation.nll(**m), evaluation.nll(**bad, mask=m["mask"]))
    assert torch.equal(
        evaluation.squared_error(m["mean"], m["truth"], m["mask"]),
        evaluation.squared_error(bad["mean"], bad["truth"], m["mask"]),
    )
    clean = evaluation.gaussian_mixture_nll(**mix, truth=m["truth"], mask=m["mask"])
    poisoned = evaluation.gaussian_mixture_nll(
        **bad_mix, log_weight=mix["log_weight"], truth=bad["truth"], mask=m["mask"]
    )
    assert torch.equal(clean, poisoned)


def test_mask_per_sample_and_shared_truth() -> None:
    m = motions((4,))
    per_sample = torch.arange(7).expand(4, 7) >= torch.tensor([[0], [2], [3], [6]])
    full = per_sample[..., None].expand(4, 7, 2)
    by_sample = evaluation.nll(m["mean"], m["variance"], m["truth"], per_sample)
    assert torch.equal(by_sample, evaluation.nll(m["mean"], m["variance"], m["truth"], full))
    shared = evaluation.squared_error(m["mean"], m["truth"][0], full[2])
    expected = evaluation.squared_error(m["mean"], m["truth"][:1].expand(4, 7, 2), full[2].expand(4, 7, 2))
    assert torch.equal(shared, expected)


def test_inputs_unchanged_and_float32_accepted() -> None:
    m = motions((4,))
    kept = {key: value.clone() for key, value in m.items()}
    score = evaluation.nll(**{key: value.float() if key != "mask" else value for key, value in m.items()})
    assert score.dtype == torch.float64
    torch.testing.assert_close(score, evaluation.nll(**m), rtol=1e-5, atol=1e-5)
    assert all(torch.equal(m[key], kept[key]) for key in m)


def test_bad_input_is_refused_by_name() -> None:
    m = motions((4,))
    empty = m["mask"].clone()
    empty[2] = False
    with pytest.raises(InputError, match="motion 2 has none"):
        evaluation.nll(m["mean"], m["variance"], m["truth"], empty)
    with pytest.raises(InputError, match="the motion has none"):
        evaluation.squared_error(m["mean"][0], m["truth"][0], empty[2])
    with pytest.raises(InputError, match="finite numbers in mean"):
        evaluation.squared_error(m["mean"].masked_fill(m["mask"], math.nan), m["truth"], m["mask"])
    with pytest.raises(InputError, match="variance above zero"):
        evaluation.nll(m["mean"], 0.0 * m["variance"], m["truth"], m["mask"])
    with pytest.raises(ShapeError, match="mask with the shape of truth"):
        evaluation.squared_error(m["mean"], m["truth"], m["mask"][:, :5])
    with pytest.raises(InputError, match="booleans"):
        scored_mask(m["mask"].double(), m["truth"])
    with pytest.raises(InputError, match="log_weight without NaN"):
        evaluation.gaussian_mixture_nll(
            **{**mixture((4,)), "log_weight": torch.full((4, 3), -math.inf)}, truth=m["truth"], mask=m["mask"]
        )


def test_future_mask_uses_time_not_index() -> None:
    truth = stack(
        [
            Trajectory([0.0, 0.4, 0.9, 1.5], [[1.0], [2.0], [3.0], [4.0]]),
            Trajectory([0.0, 0.1, 0.2], [[1.0], [2.0], [3.0]]),
        ]
    )
    mask = evaluation.future_mask(truth, torch.tensor([0.4, 0.1], dtype=torch.float64))
    assert mask.squeeze(-1).tolist() == [[False, False, True, True], [False, False, True, False]]
    assert evaluation.future_mask(truth, 0.3).any((-2, -1)).tolist() == [True, False]


def covariances(batch: tuple[int, ...], entries: int, seed: int = 2) -> Tensor:
    root = torch.randn(*batch, entries, entries + 2, generator=torch.Generator().manual_seed(seed), dtype=torch.float64)
    scale = torch.logspace(-4, 2, entries, dtype=torch.float64)
    return scale[:, None] * (root @ root.mT) * scale


@pytest.mark.parametrize("batch", BATCHES)
def test_mahalanobis_equals_selected_inverse(batch: tuple[int, ...]) -> None:
    g = torch.Generator().manual_seed(8)
    covariance = covariances(batch, 5)
    truth = covariance.diagonal(dim1=-2, dim2=-1).sqrt() * torch.randn(*batch, 5, generator=g, dtype=torch.float64)
    mask = torch.rand(*batch, 5, generator=g) < 0.6
    mask[..., 3] = True
    score = evaluation.mahalanobis(torch.zeros_like(truth), covariance, truth, mask)
    assert score.shape == batch
    for index in each_motion(batch):
        keep = mask[index]
        y, c = truth[index][keep], covariance[index][keep][:, keep]
        assert float(score[index]) == pytest.approx(float(y @ torch.linalg.inv(c) @ y) / len(y), rel=1e-6)


def test_mahalanobis_of_draws_is_one() -> None:
    covariance, count = covariances((), 6), 4_000
    normal = torch.randn(count, 6, generator=torch.Generator().manual_seed(9), dtype=torch.float64)
    mean = torch.linspace(-5.0, 30.0, 6, dtype=torch.float64)
    truth = mean + normal @ torch.linalg.cholesky(covariance).mT
    score = evaluation.mahalanobis(mean, covariance, truth)
    assert abs(float(score.mean()) - 1.0) < 4 * math.sqrt(2.0 / (6 * count))
    assert float(score.var()) == pytest.approx(2.0 / 6, rel=0.15)


def test_mahalanobis_ignores_unscored_entries() -> None:
    covariance, truth = covariances((), 4), torch.ones(4, dtype=torch.float64)
    mask = torch.tensor([True, False, True, True])
    clean = evaluation.mahalanobis(0.0 * truth, covariance, truth, mask)
    bad = covariance.clone()
    bad[1] = bad[:, 1] = math.nan
    assert torch.equal(clean, evaluation.mahalanobis(0.0 * truth, bad, truth.masked_fill(~mask, math.nan), mask))
    with pytest.raises(NotPositiveDefiniteError):
        evaluation.mahalanobis(0.0 * truth, -covariance, truth)


def test_unscored_entries_leave_the_scale_of_the_jitter() -> None:
    covariance = torch.eye(3, dtype=torch.float64) * 1e6
    covariance[:2, :2] = 2.0**-34  # its second pivot is exactly zero, so that jitter is needed
    truth = torch.tensor([2.0**-17, 2.0**-17, 0.0], dtype=torch.float64)
    score = evaluation.mahalanobis(0.0 * truth, covariance, truth, torch.tensor([True, True, False]))
    assert float(score) == pytest.approx(0.5, rel=1e-6)


def slow_dtw(a: Tensor, b: Tensor) -> float:
    cost = torch.full((len(a) + 1, len(b) + 1), math.inf, dtype=torch.float64)
    cost[0, 0] = 0.0
    for i in range(len(a)):
        for j in range(len(b)):
            least = torch.stack([cost[i, j], cost[i, j + 1], cost[i + 1, j]]).min()
            cost[i + 1, j + 1] = (a[i] - b[j]).norm() + least
    return float(cost[-1, -1])


@pytest.mark.parametrize("batch", [(), (2, 3)])
def test_dtw_to_motions_equals_slow_loop(batch: tuple[int, ...]) -> None:
    g = torch.Generator().manual_seed(4)
    training = [torch.randn(n, 2, generator=g, dtype=torch.float64) * 50.0 for n in (5, 8, 3)]
    references = stack([Trajectory(0.3 * torch.arange(len(values)), values) for values in training])
    plans = torch.randn(*batch, 6, 2, generator=g, dtype=torch.float64) * 50.0
    score = evaluation.dtw_to_motions(plans, references)
    assert score.shape == batch
    for index in each_motion(batch):
        expected = sum(slow_dtw(plans[index], values) for values in training) / 3
        assert float(score[index]) == pytest.approx(expected, rel=1e-10)


def test_dtw_refuses_gaps_and_singles() -> None:
    single = Trajectory([0.0, 1.0, 2.0], [[0.0], [1.0], [2.0]])
    gap = Trajectory([0.0, 1.0, 2.0], [[0.0], [1.0], [2.0]], mask=[[True], [False], [True]])
    plan = torch.zeros(4, 1, dtype=torch.float64)
    with pytest.raises(InputError, match="one batch"):
        evaluation.dtw_to_motions(plan, single)
    with pytest.raises(InputError, match="Fill gaps"):
        evaluation.dtw_to_motions(plan, stack([single, gap]))
    with pytest.raises(ShapeError, match="plans"):
        evaluation.dtw_to_motions(torch.zeros(4, 2, dtype=torch.float64), stack([single]))

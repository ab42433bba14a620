from __future__ import annotations

import numpy as np
import pytest
import torch
from torch import Tensor

from eaip_prob.errors import InputError
from eaip_prob.gaussian import BlockGaussian, BlockLayout
from eaip_prob.models import Posterior
from eaip_prob.observation import LinearObservation
from eaip_prob.slope import Slope
from eaip_prob.trust import Trust, tempered

LAYOUT = BlockLayout({"human": 2, "robot": 3})


def test_between_the_shares_it_is_interpolated_and_outside_held() -> None:
    shares, values = (0.1, 0.35, 0.8), (0.2, 0.9, 0.4)
    trust = Trust(shares, tuple(Slope(value) for value in values))
    asked = torch.tensor([[0.0, 0.1, 0.2], [0.6, 0.8, 3.0]], dtype=torch.float64)
    expected = []
    for share in asked.flatten().tolist():
        if share <= shares[0]:
            expected.append(values[0])
        elif share >= shares[-1]:
            expected.append(values[-1])
        else:
            left = max(place for place in range(3) if shares[place] <= share)
            step = (share - shares[left]) / (shares[left + 1] - shares[left])
            expected.append(values[left] + step * (values[left + 1] - values[left]))
    came = trust.at(asked)
    assert came.dtype == torch.float64 and came.shape == (2, 3)
    np.testing.assert_allclose(came.flatten(), expected, rtol=1e-12)
    assert float(trust.at(torch.tensor(0.35))) == pytest.approx(0.9)


def test_without_shares_everything_is_believed() -> None:
    asked = torch.tensor([[0.0, 0.5]])
    assert torch.equal(Trust().at(asked), torch.ones(1, 2, dtype=torch.float64))
    assert Trust().is_full and Trust((0.1,), (Slope(1.0),)).is_full
    assert not Trust((0.1, 0.2), (Slope(1.0), Slope(0.99))).is_full


@pytest.mark.parametrize("shares", [(0.1,), (0.2, 0.1), (0.1, 0.1), (0.1, 0.2, 0.3)])
def test_slopes_and_shares_that_do_not_fit_are_refused(shares: tuple[float, ...]) -> None:
    with pytest.raises(InputError, match="one slope for each of different, increasing shares"):
        Trust(shares, (Slope(), Slope()))


def update(batch: tuple[int, ...], components: int, shared: bool, seed: int = 0) -> tuple[Posterior, Posterior]:
    """(before, after) an observation of the human under several hypotheses."""
    draw = torch.Generator().manual_seed(seed)

    def normal(*shape: int) -> Tensor:
        return torch.randn(*shape, generator=draw, dtype=torch.float64)

    root = torch.tensor([3.0, 0.2, 1.0, 40.0, 0.7])[:, None] * normal(5, 5)
    mean = 5.0 + normal(5) if shared else 5.0 + normal(*batch, components, 5)
    prior = Posterior(BlockGaussian(mean.expand(*mean.shape[:-1] or (1,), 5), root @ root.mT, LAYOUT), *nothing(mean))
    log_weight = torch.log_softmax(normal(*batch, components), -1)
    if not shared:
        prior = Posterior(prior.components, log_weight, prior.log_evidence)
    seen = LinearObservation(
        {"human": normal(*batch, components, 3, 2)},
        normal(*batch, components, 3),
        2.0 + normal(*batch, components, 3),
        torch.tensor([0.3, 0.1, 0.7], dtype=torch.float64),
    )
    given = log_weight if shared else None
    before, after = (prior.condition(observed, given) for observed in ([], [seen]))
    return before, after


def nothing(mean: Tensor) -> tuple[Tensor, Tensor]:
    batch = mean.shape[:-1] or (1,)
    return torch.log_softmax(torch.zeros(batch, dtype=torch.float64), -1), torch.zeros(batch[:-1], dtype=torch.float64)


@pytest.mark.parametrize("shared", [True, False])
@pytest.mark.parametrize("components", [1, 3])
@pytest.mark.parametrize("batch", [(), (2, 3)])
def test_every_component_by_the_formulas(batch: tuple[int, ...], components: int, shared: bool) -> None:
    before, after = update(batch, components, shared)
    share = torch.linspace(0.15, 0.85, max(1, int(np.prod(batch))), dtype=torch.float64).reshape(batch)
    came = tempered(before, after, share)
    assert came.components.mean.shape == (*batch, components, 5)
    assert torch.equal(came.log_evidence, after.log_evidence) and came.components.layout == LAYOUT
    covariances = [part.components.covariance.expand(*batch, components, 5, 5) for part in (before, after)]
    for member in np.ndindex(*batch):
        g = float(share[member])
        ratio = np.zeros(components)
        for j in range(components):
            m, m_seen = (part.components.mean.expand(*batch, components, 5)[member][j] for part in (before, after))
            c, c_seen = (part[member][j] for part in covariances)
            np.testing.assert_allclose(came.components.mean[member][j], (1 - g) * m + g * m_seen, rtol=1e-9)
            expected = (1 - g) ** 2 * c + (1 - (1 - g) ** 2) * c_seen
            np.testing.assert_allclose(came.components.covariance[member][j], expected, rtol=1e-8, atol=1e-9)
            assert np.linalg.eigvalsh(came.components.covariance[member][j]).min() > 0
            old, new = (part.log_weight.expand(*batch, components)[member][j] for part in (before, after))
            ratio[j] = float(old) + g * float(new - old)
        np.testing.assert_allclose(came.log_weight[member], ratio - np.log(np.exp(ratio).sum()), rtol=1e-9, atol=1e-12)


@pytest.mark.parametrize("components", [1, 3])
def test_no_share_is_before_and_all_of_it_after(components: int) -> None:
    before, after = update((2, 3), components, shared=True)
    none, everything = (tempered(before, after, torch.full((2, 3), share)) for share in (0.0, 1.0))
    shape = (2, 3, components, 5)
    assert torch.equal(none.components.mean, before.components.mean.expand(shape))
    assert torch.equal(none.components.covariance, before.components.covariance.expand(*shape, 5))
    torch.testing.assert_close(none.log_weight, before.log_weight, rtol=1e-12, atol=1e-14)
    torch.testing.assert_close(everything.components.mean, after.components.mean, rtol=1e-12, atol=1e-12)
    covariance = after.components.covariance.expand(*shape, 5)
    torch.testing.assert_close(everything.components.covariance, covariance, rtol=1e-9, atol=1e-9)
    torch.testing.assert_close(everything.log_weight, after.log_weight, rtol=1e-12, atol=1e-14)


@pytest.mark.parametrize("components", [1, 3])
def test_batch_equals_loop(components: int) -> None:
    before, after = update((4,), components, shared=False)
    share = torch.tensor([0.0, 0.3, 0.8, 1.0], dtype=torch.float64)
    came = tempered(before, after, share)
    for member in range(4):
        parts = [
            Posterior(
                BlockGaussian(
                    part.components.mean[member],
                    part.components.covariance.expand(4, components, 5, 5)[member],
                    LAYOUT,
                ),
                part.log_weight[member],
                part.log_evidence[member],
            )
            for part in (before, after)
        ]
        alone = tempered(parts[0], parts[1], share[member])
        torch.testing.assert_close(came.components.mean[member], alone.components.mean)
        torch.testing.assert_close(came.components.covariance[member], alone.components.covariance)
        torch.testing.assert_close(came.log_weight[member], alone.log_weight)
        torch.testing.assert_close(came.mean("robot")[member], alone.mean("robot"))


def test_it_is_the_update_with_its_gain_scaled() -> None:
    """x' = x + g K (v - H x - noise): mean and covariance of that estimate, from its errors drawn by hand."""
    draw = torch.Generator().manual_seed(4)
    root = torch.randn(5, 5, generator=draw, dtype=torch.float64)
    design, variance, g = torch.randn(2, 2, generator=draw, dtype=torch.float64), 0.4, 0.35
    prior = Posterior(BlockGaussian(torch.zeros(1, 5), root @ root.mT, LAYOUT), *nothing(torch.zeros(1, 5)))
    seen = LinearObservation({"human": design}, torch.zeros(2), torch.tensor([1.0, -2.0]), torch.full((2,), variance))
    came = tempered(prior, prior.condition([seen]), torch.tensor(g, dtype=torch.float64))
    truth = torch.randn(200_000, 5, generator=draw, dtype=torch.float64) @ root.mT
    value = truth[:, :2] @ design.mT + variance**0.5 * torch.randn(200_000, 2, generator=draw, dtype=torch.float64)
    cross = (root @ root.mT)[:, :2] @ design.mT
    innovation = design @ (root @ root.mT)[:2, :2] @ design.mT + variance * torch.eye(2)
    gain = torch.tensor(np.linalg.solve(innovation.numpy(), cross.numpy().T).T)
    error = truth - g * value @ gain.mT
    expected = error.mT @ error / len(error)
    spread = expected.diagonal().sqrt()
    difference = (came.components.covariance[0] - expected) / (spread[:, None] * spread)
    assert float(difference.abs().max()) < 4 * (2 / len(error)) ** 0.5
    moved = g * gain @ torch.tensor([1.0, -2.0], dtype=torch.float64)
    torch.testing.assert_close(came.components.mean[0], moved, rtol=1e-8, atol=1e-10)

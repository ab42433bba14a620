from __future__ import annotations

import numpy as np
import pytest
import torch

from eaip_prob.errors import InputError
from eaip_prob.models.missing import completed


def gaussian_rows(num: int, seed: int = 0) -> tuple[torch.Tensor, torch.Tensor, torch.Tensor]:
    """(rows, mean, covariance) of a known Gaussian over five weights, in mixed units."""
    generator = torch.Generator().manual_seed(seed)
    mixing = torch.randn(5, 5, generator=generator, dtype=torch.float64) * torch.tensor(
        [[0.1], [1.0], [40.0], [1.0], [5.0]]
    )
    mean = torch.tensor([1.0, -20.0, 300.0, 0.0, 7.0], dtype=torch.float64)
    draws = torch.randn(num, 5, generator=generator, dtype=torch.float64)
    return draws @ mixing.mT + mean, mean, mixing @ mixing.mT


def some_hidden(num: int, seed: int = 1) -> torch.Tensor:
    observed = torch.ones(num, 5, dtype=torch.bool)
    generator = torch.Generator().manual_seed(seed)
    observed[:, 2:4] = torch.rand(num, 2, generator=generator) > 0.3
    return observed


def slow(rows: np.ndarray, observed: np.ndarray, rounds: int) -> np.ndarray:
    filled = rows.copy()
    for j in range(rows.shape[1]):
        filled[~observed[:, j], j] = rows[observed[:, j], j].mean()
    for _ in range(rounds):
        cov, mean = np.cov(filled.T, bias=True), filled.mean(0)
        cov = 0.999 * cov + 0.001 * np.diag(np.diag(cov))
        for i, seen in enumerate(observed):
            if not seen.all():
                gain = cov[np.ix_(~seen, seen)] @ np.linalg.inv(cov[np.ix_(seen, seen)])
                filled[i, ~seen] = mean[~seen] + gain @ (filled[i, seen] - mean[seen])
    return filled


def test_against_a_loop_over_rows() -> None:
    rows, _, _ = gaussian_rows(20)
    observed = some_hidden(20)
    came = completed(torch.where(observed, rows, 0.0), observed, num_rounds=7)
    np.testing.assert_allclose(came, slow(rows.numpy(), observed.numpy(), 7), rtol=1e-7)


def test_large_sample_gives_the_conditional_expectation() -> None:
    rows, mean, covariance = gaussian_rows(4000)
    observed = some_hidden(4000)
    came = completed(torch.where(observed, rows, 0.0), observed)
    both = (~observed[:, 2]) & (~observed[:, 3])
    seen, hidden = [0, 1, 4], [2, 3]
    cov = covariance.numpy()
    gain = np.linalg.solve(cov[np.ix_(seen, seen)], cov[np.ix_(seen, hidden)])
    expected = mean[hidden].numpy() + (rows[both][:, seen] - mean[seen]).numpy() @ gain
    left = cov[np.ix_(hidden, hidden)] - cov[np.ix_(hidden, seen)] @ gain
    error = (came[both][:, hidden].numpy() - expected) / np.sqrt(np.diag(left))
    # Regression on 4000 rows: the fitted plane is off by sqrt(4 / 4000) = 3 % of the residual; the ridge adds a little.
    assert np.sqrt((error**2).mean(0)).max() < 0.12


def test_observed_entries_are_unchanged() -> None:
    rows, _, _ = gaussian_rows(15)
    observed = some_hidden(15)
    given = torch.where(observed, rows, 0.0)
    before = given.clone()
    came = completed(given, observed)
    assert torch.equal(came[observed], rows[observed])
    assert torch.equal(given, before)
    assert torch.isfinite(came).all()


def test_values_of_hidden_entries_are_not_read() -> None:
    rows, _, _ = gaussian_rows(15)
    observed = some_hidden(15)
    one, other = (completed(torch.where(observed, rows, junk), observed) for junk in (0.0, 1e6))
    assert torch.equal(one, other)


def test_nothing_hidden() -> None:
    rows, _, _ = gaussian_rows(6)
    assert torch.equal(completed(rows, torch.ones(6, 5, dtype=torch.bool)), rows)


def test_row_without_anything_observed_takes_the_mean() -> None:
    rows, _, _ = gaussian_rows(9)
    observed = torch.ones(9, 5, dtype=torch.bool)
    observed[4] = False
    keep = [i for i in range(9) if i != 4]
    torch.testing.assert_close(completed(rows, observed)[4], rows[keep].mean(0))


def test_fewer_rows_than_weights() -> None:
    rows, _, _ = gaussian_rows(3)
    observed = torch.ones(3, 5, dtype=torch.bool)
    observed[0, 2] = False
    assert torch.isfinite(completed(rows, observed)).all()


def test_units_change_nothing_but_the_units() -> None:
    rows, _, _ = gaussian_rows(12)
    observed = some_hidden(12)
    factor = torch.tensor([1000.0, 1.0, 1e-3, 50.0, 1.0], dtype=torch.float64)
    torch.testing.assert_close(
        completed(rows * factor, observed), completed(rows, observed) * factor, rtol=1e-6, atol=0
    )


def test_never_observed_is_refused() -> None:
    rows, _, _ = gaussian_rows(4)
    observed = torch.ones(4, 5, dtype=torch.bool)
    observed[:, 3] = False
    with pytest.raises(InputError, match=r"columns \[3\] never were"):
        completed(rows, observed)

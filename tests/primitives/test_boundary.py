from __future__ import annotations

import numpy as np
import pytest
import torch

from eaip_prob.data.trajectory import Trajectory
from eaip_prob.primitives import initial_boundary


def draw(seed, *shape):
    return torch.randn(*shape, generator=torch.Generator().manual_seed(seed), dtype=torch.float64)


@pytest.mark.parametrize("batch", [(), (2, 3)])
@pytest.mark.parametrize("shared_time", [True, False])
@pytest.mark.parametrize("num_samples", [2, 5])
def test_start_and_slope_equal_a_straight_line_through_the_first_seen_samples(batch, shared_time, num_samples):
    time = 10.0 + (0.02 + draw(0, *(() if shared_time else batch), 12).abs()).cumsum(-1)
    values, mask = 300.0 + draw(1, *batch, 12, 2), draw(2, *batch, 12, 2) > -0.5
    got = initial_boundary(Trajectory(time, values, mask=mask), num_samples)
    for index in np.ndindex(*batch):
        for d in range(2):
            seen = mask[index][:, d].numpy()
            t = time.expand(*batch, 12)[index].numpy()[seen][:num_samples]
            y = values[index][:, d].numpy()[seen][:num_samples]
            assert float(got.start[index][d]) == y[0]
            assert float(got.velocity[index][d]) == pytest.approx(np.polyfit(t - t[0], y, 1)[0], rel=1e-8)


def test_one_sample_is_at_rest_and_none_starts_at_zero():
    mask = torch.tensor([[False, False], [True, False], [False, False]])
    got = initial_boundary(Trajectory([0.0, 0.7, 1.4], torch.full((3, 2), 5.0), mask=mask))
    assert got.start.tolist() == [5.0, 0.0]
    assert got.velocity.tolist() == [0.0, 0.0]


def test_slope_carries_less_noise_than_a_difference_of_two_samples():
    time = torch.arange(8, dtype=torch.float64) * 0.01
    noisy = Trajectory(time, 0.01 * draw(3, 2000, 8, 1))
    spread = initial_boundary(noisy).velocity.std()
    expected = 0.01 / float((time[:5] - time[:5].mean()).square().sum().sqrt())
    assert float(spread) == pytest.approx(expected, rel=4 / np.sqrt(2 * 2000))

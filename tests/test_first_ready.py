from __future__ import annotations

import math

import numpy as np
import pytest
import torch

from eaip_prob.errors import InputError, ShapeError
from eaip_prob.readiness import first_ready

INF = math.inf


def slow_first(deviation: np.ndarray, time: np.ndarray, threshold: np.ndarray, hold: float) -> float:
    for k in range(len(time)):
        start = k
        while start > 0 and (deviation[start - 1] < threshold).all():
            start -= 1
        if (deviation[k:] < threshold).all() and time[k] - time[start] >= hold:
            return float(time[k])
    return INF


@pytest.mark.parametrize("hold", [0.0, 0.61, 1.4])
@pytest.mark.parametrize("own_times", [False, True])
def test_record_of_a_batch_equals_the_loop(hold: float, own_times: bool) -> None:
    generator = np.random.default_rng(3)
    deviation = generator.uniform(0, 1, (2, 40, 7, 2)) * [1.0, 500.0] * np.linspace(1.5, 0.63, 7)[:, None]
    time = generator.uniform(0.1, 0.9, (2, 40, 7) if own_times else 7).cumsum(-1) + 3.0
    threshold = np.array([0.6, 400.0])
    came = first_ready(torch.as_tensor(deviation), torch.as_tensor(time), threshold.tolist(), hold)
    times = np.broadcast_to(time, (2, 40, 7))
    expected = [[slow_first(deviation[i, j], times[i, j], threshold, hold) for j in range(40)] for i in range(2)]
    assert came.tolist() == expected
    assert len({*came.flatten().tolist()}) >= 3 and INF in came


def test_threshold_of_one_number_is_for_all_signals() -> None:
    deviation = torch.tensor([[1.0, 5.0], [1.0, 2.0], [2.9, 0.0]])
    time = torch.tensor([1.0, 2.0, 4.0])
    assert first_ready(deviation, time, 3.0) == 2.0
    assert first_ready(deviation, time, [3.0, 1.0]) == 4.0
    assert first_ready(deviation, time, [3.0, 6.0]) == 1.0
    assert first_ready(deviation, time, 2.9) == INF


def test_empty_batch() -> None:
    assert first_ready(torch.zeros(0, 3, 2), torch.arange(3.0), 1.0).shape == (0,)


def test_record_that_cannot_be_used() -> None:
    deviation, time = torch.ones(4, 3, 2), torch.tensor([0.0, 1.0, 2.0])
    with pytest.raises(ShapeError, match="Expected deviation"):
        first_ready(deviation, time[:2], 1.0)
    with pytest.raises(ShapeError, match="Expected deviation"):
        first_ready(deviation[..., 0], time, 1.0)
    with pytest.raises(ShapeError, match="time with a batch"):
        first_ready(deviation, time.expand(5, 3), 1.0)
    with pytest.raises(ShapeError, match="T at least 1"):
        first_ready(deviation, torch.zeros(0), 1.0)
    with pytest.raises(ShapeError, match="one threshold or 2"):
        first_ready(deviation, time, [1.0, 2.0, 3.0])
    for order in ([0, 2, 1], [0, 1, 1]):
        with pytest.raises(InputError, match="strictly increasing"):
            first_ready(deviation, time[order], 1.0)
    with pytest.raises(InputError, match="deviations of at least 0"):
        first_ready(-deviation, time, 1.0)
    for bad in (math.nan, INF):
        with pytest.raises(InputError, match="finite numbers in deviation"):
            first_ready(deviation * bad, time, 1.0)

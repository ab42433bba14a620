from __future__ import annotations

import dataclasses
import math
from typing import Any

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st

from eaip_prob.errors import InputError, ShapeError
from eaip_prob.forecast import Prediction
from eaip_prob.gaussian import BlockGaussian, BlockLayout
from eaip_prob.models import Posterior
from eaip_prob.phase import PhaseEstimate
from eaip_prob.primitives import ProMP
from eaip_prob.readiness import Readiness, ReadinessState, first_ready, remaining_deviation

INF = math.inf
TIME = torch.tensor([0.5, 0.9, 1.6, 2.0, 3.1, 4.5], dtype=torch.float64)
PRIMITIVE = ProMP(num_basis=4, limit=1.3)


def forecast(batch: tuple[int, ...] = (), time: torch.Tensor = TIME, seed: int = 0) -> Prediction:
    """A mixture over two durations of a motion with two signals in other units."""
    generator = torch.Generator().manual_seed(seed)
    mean = 5.0 + torch.randn(*batch, 2, 8, generator=generator, dtype=torch.float64)
    root = torch.randn(*batch, 2, 8, 8, generator=generator, dtype=torch.float64)
    root[..., 4:, :] *= 30.0
    components = BlockGaussian(mean, root @ root.mT, BlockLayout({"robot": 8}))
    log_weight = torch.log(torch.tensor([0.3, 0.7], dtype=torch.float64)).expand(*batch, 2)
    durations = torch.tensor([2.5, 3.5], dtype=torch.float64)
    seen = torch.tensor([0.5, 0.9], dtype=torch.float64)
    phase = PhaseEstimate(seen, (seen - 0.5) / durations[:, None], torch.full((2,), 0.5).double().log(), durations)
    posterior = Posterior(components, log_weight, torch.zeros(batch, dtype=torch.float64))
    residual = torch.tensor([0.01, 0.4], dtype=torch.float64)
    return Prediction(time, posterior, phase, PRIMITIVE, "robot", ("u", "v"), residual, 1.7)


@dataclasses.dataclass
class Given:
    """A prediction whose remaining variance is the same at all times."""

    variance: torch.Tensor
    time: torch.Tensor


def given_deviation(*deviation: float | list[float]) -> Any:
    values = torch.tensor(deviation, dtype=torch.float64)
    return Given(values.square()[..., None, :].expand(*values.shape[:-1], 2, -1), torch.tensor([0.0, 99.0]).double())


def slow_deviation(prediction: Prediction, now: float, at: tuple[int, ...] = ()) -> list[float]:
    variance, result = prediction.variance.numpy()[at], []
    time = np.broadcast_to(prediction.time.numpy(), (*prediction.variance.shape[:-2], len(TIME)))[at]
    for signal in range(2):
        left = [variance[i, signal] for i in range(len(time)) if time[i] > now]
        if not left:
            left = [variance[list(time).index(max(time)), signal]]
        result.append(math.sqrt(sum(left) / len(left)))
    return result


@pytest.mark.parametrize("now", [-3.0, 0.5, 1.0, 1.6, 3.0, 3.2, 4.5, 100.0])
def test_deviation_is_the_root_mean_variance_of_what_remains(now: float) -> None:
    prediction = forecast()
    np.testing.assert_allclose(remaining_deviation(prediction, now), slow_deviation(prediction, now), rtol=1e-12)


def test_deviation_of_draws() -> None:
    prediction = forecast()
    draws = prediction.sample(20_000, torch.Generator().manual_seed(1))
    noise = torch.randn(draws.shape, generator=torch.Generator().manual_seed(2), dtype=torch.float64)
    left = (draws + noise * (1.7 * prediction.residual).sqrt())[:, TIME > 1.6]
    squares = (left - prediction.mean[TIME > 1.6]).square().mean(1)
    standard_error = squares.std(0) / 20_000**0.5
    assert bool(((squares.mean(0) - remaining_deviation(prediction, 1.6).square()).abs() < 4 * standard_error).all())


@pytest.mark.parametrize("own_times", [False, True])
@pytest.mark.parametrize("own_now", [False, True])
def test_deviation_of_a_batch_equals_the_loop(own_times: bool, own_now: bool) -> None:
    shift = torch.arange(6.0).reshape(2, 3, 1).double()
    prediction = forecast((2, 3), TIME + 0.3 * shift if own_times else TIME)
    now = torch.tensor([[0.0, 0.9, 2.5], [1.0, 4.6, 9.0]]).double() if own_now else torch.tensor(2.5).double()
    came = remaining_deviation(prediction, now)
    assert came.shape == (2, 3, 2)
    for i in range(2):
        for j in range(3):
            expected = slow_deviation(prediction, float(now.expand(2, 3)[i, j]), (i, j))
            np.testing.assert_allclose(came[i, j], expected, rtol=1e-12)


def test_one_prediction_at_many_times() -> None:
    prediction = forecast()
    now = torch.tensor([0.0, 1.0, 2.5], dtype=torch.float64)
    each = torch.stack([remaining_deviation(prediction, float(one)) for one in now])
    torch.testing.assert_close(remaining_deviation(prediction, now), each)


def test_last_sample_is_the_latest_whatever_the_order() -> None:
    order = torch.tensor([3, 5, 0, 2, 4, 1])
    prediction = forecast()
    shuffled = prediction.at(TIME[order])
    for now in (1.7, 50.0):
        torch.testing.assert_close(remaining_deviation(shuffled, now), remaining_deviation(prediction, now))


def test_ready_while_held_and_taken_back() -> None:
    rule, answers = Readiness(threshold=[2.0, 10.0], hold=0.5), []
    state = rule.init()
    steps = [(0.0, 1.0, 9.0), (0.4, 1.0, 10.0), (0.6, 1.9, 9.9), (1.0, 1.0, 1.0), (1.1, 1.0, 1.0), (1.2, 2.0, 1.0)]
    for now, *deviation in steps:
        ready, state = rule.step(given_deviation(*deviation), now, state)
        answers.append((bool(ready), float(state.since), float(state.time)))
    assert answers == [
        (False, 0.0, 0.0),
        (False, INF, 0.4),
        (False, 0.6, 0.6),
        (False, 0.6, 1.0),
        (True, 0.6, 1.1),
        (False, INF, 1.2),
    ]


def test_no_hold_is_ready_at_once_and_state_is_not_written_to() -> None:
    rule = Readiness(2.0)
    start = rule.init()
    ready, state = rule.step(given_deviation(1.0), 0.3, start)
    assert bool(ready) and float(start.since) == INF and float(start.time) == -INF
    again, _ = rule.step(given_deviation(1.0), 0.3, state)
    assert bool(again)


@pytest.mark.parametrize("start", [0.0, -0.3, 1.7e9])
def test_round_off_does_not_delay(start: float) -> None:
    rule = Readiness(1.0, hold=0.3)
    for first in range(20):
        since, time = (torch.tensor(start + tick / 10, dtype=torch.float64) for tick in (first, first + 3))
        assert bool(rule.is_held(since, time))
        assert not bool(rule.is_held(since, time - 1e-5))


def test_step_judges_what_remains_of_a_real_prediction() -> None:
    prediction, rule = forecast(), Readiness(1.0)
    deviation = remaining_deviation(prediction, 2.5)
    for factor, expected in ((1.001, True), (1.0, False), (0.999, False)):
        ready, _ = Readiness(deviation * factor).step(prediction, 2.5, rule.init())
        assert bool(ready) is expected


@settings(max_examples=40, deadline=None)
@given(st.data())
def test_step_by_step_equals_the_record(data: st.DataObject) -> None:
    num, hold = data.draw(st.integers(1, 9)), data.draw(st.sampled_from([0.0, 0.2, 0.5, 1.1]))
    gaps = data.draw(st.lists(st.integers(1, 8), min_size=num, max_size=num))
    levels = st.lists(st.sampled_from([0.5, 1.0, 3.0]), min_size=6 * num, max_size=6 * num)
    deviation = torch.tensor(data.draw(levels), dtype=torch.float64).reshape(3, num, 2)
    time = torch.tensor(gaps).cumsum(0).double() / 10 - 1.3
    rule = Readiness([1.0, 3.5], hold)
    state, answers = rule.init(), []
    for k in range(num):
        ready, state = rule.step(given_deviation(*deviation[:, k].tolist()), float(time[k]), state)
        answers.append(ready.tolist())
    expected = [INF] * 3
    for i in range(3):
        for k in reversed(range(num)):
            if not answers[k][i]:
                break
            expected[i] = float(time[k])
    assert first_ready(deviation, time, [1.0, 3.5], hold).tolist() == expected


def test_empty_batch() -> None:
    prediction: Any = Given(torch.ones(0, 2, 2).double(), torch.tensor([0.0, 1.0]).double())
    ready, state = Readiness(2.0).step(prediction, 0.5, Readiness(2.0).init())
    assert ready.shape == state.since.shape == state.time.shape == (0,)


@pytest.mark.parametrize("threshold", [0.0, -1.0, math.nan, INF, [1.0, 0.0], []])
def test_threshold_out_of_range(threshold: Any) -> None:
    if threshold == []:
        with pytest.raises(ShapeError, match="one threshold or 2 of them"):
            Readiness(threshold).step(forecast(), 1.0, Readiness(1.0).init())
    else:
        with pytest.raises(InputError, match="threshold above zero and finite"):
            Readiness(threshold)


def test_rule_that_cannot_be_used() -> None:
    with pytest.raises(ShapeError, match="one number or"):
        Readiness([[1.0]])  # pyright: ignore[reportArgumentType]
    with pytest.raises(InputError, match="threshold as numbers"):
        Readiness("narrow")
    for hold in (-0.1, INF, math.nan, [0.1, 0.2]):
        with pytest.raises(InputError, match="hold as one finite number"):
            Readiness(1.0, hold)  # pyright: ignore[reportArgumentType]
    with pytest.raises(ShapeError, match="one threshold or 2 of them, one for each signal, got 3"):
        Readiness([1.0, 2.0, 3.0]).step(forecast(), 1.0, Readiness(1.0).init())


def test_step_that_cannot_be_used() -> None:
    rule = Readiness(1.0)
    _, state = rule.step(forecast((3,)), torch.tensor([1.0, 2.0, 3.0]), rule.init())
    with pytest.raises(InputError, match=r"not before the last step, got 0\.5 s before it"):
        rule.step(forecast((3,)), torch.tensor([1.0, 1.5, 3.5]), state)
    for now in (math.nan, INF):
        with pytest.raises(InputError, match="finite numbers in now"):
            rule.step(forecast(), now, rule.init())
    with pytest.raises(ShapeError, match=r"now with a batch that fits the prediction, \(3,\), got \(2,\)"):
        rule.step(forecast((3,)), torch.zeros(2), rule.init())
    with pytest.raises(ShapeError, match=r"state with a batch that fits the prediction and now, \(2,\), got \(3,\)"):
        rule.step(forecast((2,)), 4.0, state)


@pytest.mark.parametrize("bad", [math.nan, -1.0])
def test_variances_that_cannot_be(bad: float) -> None:
    prediction: Any = Given(torch.tensor([[5.0, 5.0], [5.0, bad]]).double(), torch.tensor([0.0, 1.0]).double())
    with pytest.raises(InputError, match="variances of at least 0"):
        remaining_deviation(prediction, 0.5)


def test_variance_of_the_past_does_not_matter() -> None:
    prediction: Any = Given(torch.tensor([[INF, 7.0], [9.0, 4.0]]).double(), torch.tensor([0.0, 1.0]).double())
    assert remaining_deviation(prediction, 0.0).tolist() == [3.0, 2.0]


def test_state_can_be_made_by_hand() -> None:
    state = ReadinessState(torch.tensor([0.0, INF]), torch.tensor([1.0, 1.0]))
    ready, after = Readiness(2.0, hold=1.0).step(given_deviation([1.0], [1.0]), 1.0, state)
    assert ready.tolist() == [True, False] and after.since.tolist() == [0.0, 1.0]

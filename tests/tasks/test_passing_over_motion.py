from __future__ import annotations

import numpy as np
import pytest
import torch
from scipy.interpolate import BPoly

from eaip_prob.errors import InputError, ShapeError
from eaip_prob.tasks.passing_over.motion import minimum_jerk_states, quintic_positions, tremor


def _random(batch: tuple[int, ...], num_knots: int, seed: int = 0) -> tuple[torch.Tensor, torch.Tensor]:
    generator = torch.Generator().manual_seed(seed)
    points = 200.0 * torch.randn(*batch, num_knots, 2, generator=generator, dtype=torch.float64) + 70.0
    durations = 0.3 + torch.rand(*batch, num_knots - 1, generator=generator, dtype=torch.float64)
    return points, durations


def _coefficient_rows(length: float, order: int, at: float) -> np.ndarray:
    falling = [np.prod([j - i for i in range(order)]) if j >= order else 0.0 for j in range(6)]
    return np.array([falling[j] * (at * length) ** max(j - order, 0) for j in range(6)], dtype=float)


def _dense_spline(points: np.ndarray, durations: np.ndarray) -> np.ndarray:
    # The conditions of optimality themselves: values at knots, rest at ends, continuity up to the fourth derivative.
    segments = len(durations)
    rows, right = [], []

    def add(parts: list[tuple[int, np.ndarray]], value: np.ndarray) -> None:
        row = np.zeros(6 * segments)
        for number, part in parts:
            row[6 * number : 6 * number + 6] += part
        rows.append(row)
        right.append(value)

    zero = np.zeros(points.shape[1])
    for k, h in enumerate(durations):
        add([(k, _coefficient_rows(h, 0, 0.0))], points[k])
        add([(k, _coefficient_rows(h, 0, 1.0))], points[k + 1])
    for order in (1, 2):
        add([(0, _coefficient_rows(durations[0], order, 0.0))], zero)
        add([(segments - 1, _coefficient_rows(durations[-1], order, 1.0))], zero)
    for k in range(segments - 1):
        for order in (1, 2, 3, 4):
            before, after = _coefficient_rows(durations[k], order, 1.0), _coefficient_rows(durations[k + 1], order, 0.0)
            add([(k, before), (k + 1, -after)], zero)
    return np.linalg.solve(np.array(rows), np.array(right)).reshape(segments, 6, -1)


def _spline(points: torch.Tensor, durations: torch.Tensor, states: torch.Tensor) -> BPoly:
    knots = np.concatenate([[0.0], durations.cumsum(-1).numpy()])
    return BPoly.from_derivatives(knots, list(states.numpy()))


def _jerk_integral(spline: BPoly) -> float:
    jerk = spline.derivative(3)
    nodes, weights = np.polynomial.legendre.leggauss(6)
    total = 0.0
    for low, high in zip(spline.x[:-1], spline.x[1:], strict=True):
        at = 0.5 * (high - low) * nodes + 0.5 * (high + low)
        total += 0.5 * (high - low) * float((weights[:, None] * jerk(at) ** 2).sum())
    return total


@pytest.mark.parametrize("num_knots", [3, 4, 6])
def test_states_solve_the_optimality_conditions(num_knots: int) -> None:
    points, durations = _random((), num_knots)
    dense = _dense_spline(points.numpy(), durations.numpy())
    states = minimum_jerk_states(points, durations)
    for order, factor in ((0, 1.0), (1, 1.0), (2, 2.0)):
        np.testing.assert_allclose(states[:-1, order].numpy(), factor * dense[:, order], rtol=1e-8, atol=1e-6)
    assert states[[0, -1], 1:].abs().max() == 0.0


def test_without_via_points_it_is_the_classical_polynomial() -> None:
    points = torch.tensor([[3.0, -7.0], [11.0, 40.0]], dtype=torch.float64)
    duration = torch.tensor([2.7], dtype=torch.float64)
    time = torch.linspace(0.0, 2.7, 41, dtype=torch.float64)
    s = time / 2.7
    share = 10 * s**3 - 15 * s**4 + 6 * s**5
    path = quintic_positions(minimum_jerk_states(points, duration), duration, time)
    torch.testing.assert_close(path, points[0] + share[:, None] * (points[1] - points[0]))


@pytest.mark.parametrize("batch", [(), (2, 3)])
def test_positions_agree_with_scipy(batch: tuple[int, ...]) -> None:
    points, durations = _random(batch, 5, seed=3)
    states = minimum_jerk_states(points, durations)
    time = torch.linspace(0.0, 1.0, 57, dtype=torch.float64) * durations.sum(-1, keepdim=True)
    path = quintic_positions(states, durations, time)
    assert path.shape == (*batch, 57, 2)
    for index in np.ndindex(*batch):
        expected = _spline(points[index], durations[index], states[index])(time[index].numpy())
        np.testing.assert_allclose(path[index].numpy(), expected, rtol=1e-9, atol=1e-8)


def test_positions_pass_the_points_and_hold_the_end() -> None:
    points, durations = _random((2,), 4)
    knots = torch.nn.functional.pad(durations.cumsum(-1), (1, 1), value=9.0)
    knots[..., 0] = 0.0
    path = quintic_positions(minimum_jerk_states(points, durations), durations, knots)
    torch.testing.assert_close(path[..., :4, :], points)
    torch.testing.assert_close(path[..., 4, :], points[..., 3, :])


def test_perturbed_motion_has_more_jerk() -> None:
    points, durations = _random((), 4, seed=5)
    states = minimum_jerk_states(points, durations)
    least = _jerk_integral(_spline(points, durations, states))
    generator = torch.Generator().manual_seed(1)
    for scale in (1e-3, 0.1):
        for _ in range(10):
            other = states.clone()
            free = other[1:-1, 1:]
            free += scale * free.abs() * torch.randn(free.shape, generator=generator, dtype=torch.float64)
            assert _jerk_integral(_spline(points, durations, other)) > least


def test_inputs_stay_unchanged() -> None:
    points, durations = _random((), 4)
    before = points.clone(), durations.clone()
    time = torch.linspace(0.0, 5.0, 9, dtype=torch.float64)
    quintic_positions(minimum_jerk_states(points, durations), durations, time)
    torch.testing.assert_close((points, durations), before, rtol=0.0, atol=0.0)
    assert time[-1] == 5.0


def test_bad_knots_are_refused() -> None:
    points, durations = _random((), 4)
    with pytest.raises(ShapeError, match=r"Expected durations with shape \(\*batch, 3\), got \(2,\)"):
        minimum_jerk_states(points, durations[:2])
    with pytest.raises(InputError, match="durations above zero"):
        minimum_jerk_states(points, durations * torch.tensor([1.0, 0.0, 1.0], dtype=torch.float64))
    with pytest.raises(InputError, match="finite numbers in points"):
        minimum_jerk_states(points * torch.nan, durations)


def test_tremor_has_its_rms_and_band() -> None:
    num, count, rms = 400, 400, 1.7
    time = torch.arange(count, dtype=torch.float64) / 100.0
    shake = tremor(num, time, rms, (8.0, 12.0), torch.Generator().manual_seed(0))
    # 17 frequencies, 2 phases, 2 axes: 68 independent squares a motion, each with a relative variance of 2.
    error = rms**2 * (2.0 / (num * 68)) ** 0.5
    assert abs(float(shake.square().mean()) - rms**2) < 4 * error
    power = torch.fft.rfft(shake, dim=1).abs().square().mean((0, 2))
    frequency = torch.fft.rfftfreq(count, 0.01)
    inside = (frequency >= 8.0) & (frequency <= 12.0)
    assert power[inside].sum() / power.sum() > 1.0 - 1e-9
    assert power[inside].min() > 0.6 * power[inside].mean()
    assert abs(float((shake[..., 0] * shake[..., 1]).mean())) < 4 * rms**2 * (1.0 / (num * 34)) ** 0.5
    # Stationary: the first sample varies as much as all others.
    assert abs(float(shake[:, 0].square().mean()) - rms**2) < 4 * rms**2 * (2.0 / (2 * num)) ** 0.5


def test_bad_tremor_is_refused() -> None:
    time = torch.arange(5, dtype=torch.float64)
    with pytest.raises(InputError, match="tremor band"):
        tremor(1, time, 1.0, (12.0, 8.0), torch.Generator())
    with pytest.raises(InputError, match="rms of at least zero"):
        tremor(1, time, -1.0, (8.0, 12.0), torch.Generator())

from __future__ import annotations

import numpy as np
import pytest
import torch
from scipy.stats import norm

from eaip_prob.data.demonstrations import Demonstration, DemonstrationSet
from eaip_prob.data.trajectory import Trajectory
from eaip_prob.errors import InputError, NotFittedError
from eaip_prob.phase import MarginalClock


def motion(duration: float, num: int = 9) -> Trajectory:
    time = 2.0 + torch.linspace(0.0, duration, num, dtype=torch.float64)
    return Trajectory(time, torch.arange(2.0 * num).reshape(num, 2))


def demonstrations(*durations: float, robot: float = 1.0) -> DemonstrationSet:
    return DemonstrationSet([Demonstration(motion(T), motion(robot * T)) for T in durations])


def test_the_logarithm_of_the_duration_is_normal_as_demonstrated() -> None:
    clock = MarginalClock(num_durations=9).fit(demonstrations(0.7, 2.0, 2.7), "human")
    logs = np.log([0.7, 2.0, 2.7])
    assert clock.mean == pytest.approx(logs.mean()) and clock.deviation == pytest.approx(logs.std(ddof=1))
    phase = clock.estimate(motion(1.3))
    assert phase.duration.shape == phase.log_weight.shape == (9,)
    got, weight = phase.duration.log().numpy(), phase.log_weight.exp().numpy()
    density = norm.pdf(got, logs.mean(), logs.std(ddof=1))
    np.testing.assert_allclose(np.diff(got), np.full(8, got[1] - got[0]), rtol=1e-9)
    np.testing.assert_allclose(weight, density / density.sum(), rtol=1e-9)
    assert weight.sum() == pytest.approx(1.0, rel=1e-12)
    reach = norm.cdf((got[[0, -1]] - logs.mean()) / logs.std(ddof=1))
    assert reach[0] < 0.01 and reach[1] > 0.99


def test_many_durations_have_the_moments_of_the_normal() -> None:
    clock = MarginalClock(num_durations=81, mean=0.4, deviation=0.2)
    phase = clock.estimate(motion(1.3))
    weight, logs = phase.log_weight.exp(), phase.duration.log()
    mean = float((weight * logs).sum())
    assert mean == pytest.approx(0.4, rel=1e-9)
    # The normal is cut at 2.4 standard deviations, which leaves 95 % of its standard deviation.
    assert float((weight * (logs - mean).square()).sum().sqrt()) == pytest.approx(0.2, rel=0.06)


def test_the_agent_named_is_the_one_timed() -> None:
    clock = MarginalClock().fit(demonstrations(0.7, 2.8, robot=3.0), "robot")
    assert clock.mean == pytest.approx(np.log([2.1, 8.4]).mean())


def test_demonstrations_are_encoded_with_their_own_duration() -> None:
    demos = demonstrations(0.7, 2.7)
    phase = MarginalClock().fit(demos, "human").encoding(demos.trajectories("human"))
    assert torch.allclose(phase.paths[:, 0, -1], torch.ones(2, dtype=torch.float64))
    assert phase.duration[:, 0].tolist() == pytest.approx([0.7, 2.7])


@pytest.mark.parametrize("batch", [(), (2, 3)])
def test_phase_is_elapsed_time_over_each_duration(batch: tuple[int, ...]) -> None:
    clock = MarginalClock(num_durations=5).fit(demonstrations(0.7, 2.7), "human")
    time = torch.tensor([1.0, 1.5, 2.5], dtype=torch.float64)
    shift = torch.randn(*batch, 1, generator=torch.Generator().manual_seed(0), dtype=torch.float64)
    phase = clock.estimate(Trajectory(time + shift, torch.zeros(*batch, 3, 2)))
    assert phase.paths.shape == (*batch, 5, 3)
    for at in np.ndindex(*batch):
        for j in range(5):
            np.testing.assert_allclose(
                phase.paths[(*at, j)], np.array([0.0, 0.5, 1.5]) / float(phase.duration[j]), rtol=1e-9, atol=1e-12
            )


@pytest.mark.parametrize("durations", [(1.7,), (1.7, 1.7, 1.7)])
def test_without_spread_every_hypothesis_has_the_one_duration(durations: tuple[float, ...]) -> None:
    clock = MarginalClock(num_durations=4).fit(demonstrations(*durations), "human")
    phase = clock.estimate(motion(0.9))
    np.testing.assert_allclose(phase.duration, [1.7] * 4, rtol=1e-12)
    assert float(phase.log_weight.exp().sum()) == pytest.approx(1.0) and bool(torch.isfinite(phase.paths).all())


def test_fitting_changes_nothing_in_place() -> None:
    clock = MarginalClock()
    assert clock.fit(demonstrations(2.0, 3.0), "human") is not clock
    assert clock.mean is None and clock.deviation is None


@pytest.mark.parametrize("num", [2, 0, -1])
def test_too_few_durations_are_refused(num: int) -> None:
    with pytest.raises(InputError, match=f"at least 3 durations, got {num}"):
        MarginalClock(num_durations=num)


def test_use_before_fit_and_motions_without_duration_are_refused() -> None:
    with pytest.raises(NotFittedError, match="fitted MarginalClock"):
        MarginalClock().estimate(motion(1.0))
    still = Trajectory(torch.tensor([2.0]), torch.zeros(1, 2))
    with pytest.raises(InputError, match="duration of 0 s"):
        MarginalClock().fit(DemonstrationSet([Demonstration(still, still)]), "human")

from __future__ import annotations

import math

import pytest
import torch

from eaip_prob.data.demonstrations import Demonstration, DemonstrationSet
from eaip_prob.data.trajectory import Trajectory
from eaip_prob.errors import InputError, NotFittedError
from eaip_prob.phase import ElapsedClock, KnownPhase, known_phase


def motion(duration, num=9, seen=None):
    mask = (torch.arange(num) < (seen or num))[:, None].expand(num, 2)
    return Trajectory(2.0 + torch.linspace(0.0, duration, num), torch.arange(2.0 * num).reshape(num, 2), mask=mask)


def demonstrations(*durations, robot=1.0):
    return DemonstrationSet([Demonstration(motion(T), motion(robot * T)) for T in durations])


def test_the_constant_is_the_geometric_mean_and_the_limit_the_longest():
    clock = ElapsedClock().fit(demonstrations(0.7, 2.0, 2.7), "human")
    mean = (0.7 * 2.0 * 2.7) ** (1 / 3)
    assert clock.duration == pytest.approx(mean)
    assert clock.limit == pytest.approx(2.7 / mean)


def test_the_agent_named_is_the_one_timed():
    clock = ElapsedClock().fit(demonstrations(0.7, 2.8, robot=3.0), "robot")
    assert clock.duration == pytest.approx(3.0 * math.sqrt(0.7 * 2.8))


def test_fitting_changes_nothing_in_place_and_a_given_constant_is_kept():
    clock = ElapsedClock()
    assert clock.fit(demonstrations(2.0), "human") is not clock
    assert clock.duration is None and clock.limit == 1.0
    given = ElapsedClock(duration=0.5).fit(demonstrations(0.7, 2.0), "human")
    assert given.duration == 0.5 and given.limit == pytest.approx(4.0)


def test_a_limit_is_never_under_one():
    assert ElapsedClock(duration=5.0).fit(demonstrations(0.7, 2.0), "human").limit == 1.0


@pytest.mark.parametrize("batch", [(), (3,)])
def test_encoding_and_estimate_are_the_same_clock(batch):
    clock = ElapsedClock().fit(demonstrations(0.7, 2.7), "human")
    seen = Trajectory([1.0, 1.5, 2.5], torch.zeros(*batch, 3, 2))
    expected = torch.tensor([[0.0, 0.5, 1.5]], dtype=torch.float64) / math.sqrt(0.7 * 2.7)
    for phase in (clock.encoding(seen), clock.estimate(seen)):
        assert torch.allclose(phase.paths, expected)
        assert float(phase.duration) == pytest.approx(math.sqrt(0.7 * 2.7))


def test_own_time_vectors_have_own_paths():
    time = torch.tensor([[1.0, 2.0], [5.0, 8.0]], dtype=torch.float64)
    phase = ElapsedClock(duration=2.0).estimate(Trajectory(time, torch.zeros(2, 2, 1)))
    assert phase.paths.tolist() == [[[0.0, 0.5]], [[0.0, 1.5]]]


def test_without_a_constant_the_clock_says_that_it_is_not_fitted():
    with pytest.raises(NotFittedError, match="fitted ElapsedClock"):
        ElapsedClock().estimate(motion(1.0))


@pytest.mark.parametrize("duration", [0.0, -2.0, float("nan")])
def test_an_impossible_constant_is_refused(duration):
    with pytest.raises(InputError, match="duration above zero"):
        ElapsedClock(duration=duration)


@pytest.mark.parametrize("clock", [ElapsedClock(), KnownPhase()])
def test_a_demonstration_without_duration_is_refused_by_number(clock):
    demos = DemonstrationSet([Demonstration(motion(2.0)), Demonstration(motion(2.0, seen=1))])
    with pytest.raises(InputError, match=r"duration of 0 s for motion \(1,\)"):
        clock.fit(demos, "human")


def test_known_phase_encodes_each_motion_by_its_own_duration():
    demos = demonstrations(0.7, 2.7)
    clock = KnownPhase().fit(demos, "human")
    phase = clock.encoding(demos.trajectories("human"))
    assert torch.allclose(phase.paths[:, 0, -1], torch.ones(2, dtype=torch.float64))
    assert phase.duration[:, 0].tolist() == pytest.approx([0.7, 2.7])
    assert clock.limit == 1.0


def test_known_phase_of_a_padded_batch_is_one_at_the_last_seen_sample():
    motions = DemonstrationSet([Demonstration(motion(2.0, 5)), Demonstration(motion(4.0, 9))]).trajectories("human")
    assert KnownPhase().encoding(motions).paths[:, 0, [4, 8]].tolist() == [[1.0, 2.0], [0.5, 1.0]]


def test_known_phase_refuses_to_estimate_and_is_told_instead():
    with pytest.raises(InputError, match=r"known_phase\(observed, duration\)"):
        KnownPhase().estimate(motion(1.0))
    phase = known_phase(Trajectory([1.0, 2.0], torch.zeros(3, 2, 1)), torch.tensor([0.5, 1.0, 4.0]))
    assert phase.paths[:, 0, 1].tolist() == [2.0, 1.0, 0.25]
    with pytest.raises(InputError, match="above zero"):
        known_phase(motion(1.0), 0.0)

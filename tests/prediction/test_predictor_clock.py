from __future__ import annotations

import dataclasses

import pytest
import torch
from prediction_world import DURATION, SAMPLES, changed, demonstrations, observation, predictor

from eaip_prob.data.demonstrations import Demonstration
from eaip_prob.data.trajectory import Trajectory
from eaip_prob.errors import HeldOutWarning, InputError
from eaip_prob.phase import ElapsedClock, KnownPhase, MarginalClock, known_phase
from eaip_prob.prediction import InteractionPredictor


def test_unknown_duration() -> None:
    fixed = {"noise": 0.05, "environment_noise": 0.5, "recalibrate": False}
    model = predictor(phase=MarginalClock(num_durations=9), **fixed).fit(demonstrations(24, ragged=True))
    motions = demonstrations(6, seed=9, ragged=True)
    humans, robots = motions.trajectories("human"), motions.trajectories("robot")
    assert model.fitted is not None and isinstance(model.fitted.phase, MarginalClock)
    durations = model.fitted.phase.estimate(humans).duration
    for seen in (3, 20):
        came = model.predict(humans.first(seen), motions.environments, time=robots.time)
        log_weight = model.fitted.phase.estimate(humans).log_weight
        parts = [
            model.predict(
                humans.first(seen), motions.environments, robots.time, known_phase(humans.first(seen), d.expand(6))
            )
            for d in durations
        ]
        weight = torch.softmax(log_weight + torch.stack([part.log_evidence for part in parts], -1), -1)
        mean = sum(weight[:, j, None, None] * part.mean for j, part in enumerate(parts))
        torch.testing.assert_close(came.mean, mean, rtol=1e-7, atol=1e-7)
        torch.testing.assert_close(came.posterior.weight, weight, rtol=1e-6, atol=1e-9)


def test_start_of_the_clock_does_not_matter(ragged: InteractionPredictor) -> None:
    seen, scene = observation()
    later = dataclasses.replace(seen, time=seen.time + 40.0)
    one, other = ragged.predict(seen, scene), ragged.predict(later, scene)
    torch.testing.assert_close(other.time, one.time + 40.0)
    torch.testing.assert_close(other.mean, one.mean, rtol=1e-8, atol=1e-8)


def test_known_phase() -> None:
    fixed = {"noise": 0.05, "environment_noise": 0.5, "recalibrate": False}
    elapsed = predictor(**fixed).fit(demonstrations(24))
    known = predictor(phase=KnownPhase(), **fixed).fit(demonstrations(24, ragged=True))
    alike, other = demonstrations(4, seed=9), demonstrations(4, seed=9, ragged=True)
    seen, longer = alike.trajectories("human").first(9), other.trajectories("human")
    one = elapsed.predict(seen, alike.environments, time=alike.trajectories("robot").time)
    told = known_phase(longer.first(9), longer.duration)
    two = known.predict(longer.first(9), other.environments, other.trajectories("robot").time, told)
    assert (longer.duration / DURATION - 1).abs().max() > 0.05
    torch.testing.assert_close(two.mean, one.mean, rtol=1e-6, atol=1e-6)
    torch.testing.assert_close(two.variance, one.variance, rtol=1e-5, atol=1e-8)
    with pytest.raises(InputError, match="true durations"):
        known.predict(seen)


def test_known_phase_with_chosen_noise() -> None:
    model = predictor(phase=KnownPhase()).fit(demonstrations(10, ragged=True, groups=2))
    assert model.fitted is not None and float(model.fitted.noise) > 0


def test_phase_that_replaces_the_clock(ragged: InteractionPredictor) -> None:
    seen, scene = observation()
    clock = ragged.fitted
    assert clock is not None and isinstance(clock.phase, ElapsedClock) and clock.phase.duration is not None
    one = ragged.predict(seen, scene)
    same = ragged.predict(seen, scene, phase=known_phase(seen, clock.phase.duration))
    other = ragged.predict(seen, scene, phase=known_phase(seen, 2 * clock.phase.duration))
    assert torch.equal(one.mean, same.mean)
    assert other.time[-1] > 1.5 * one.time[-1]


def test_read_at_other_times(ragged: InteractionPredictor) -> None:
    seen, scene = observation()
    came = ragged.predict(seen, scene)
    came.mean  # noqa: B018  # what is kept must not outlive the times
    other = came.at([0.3, 1.7])
    expected = ragged.predict(seen, scene, time=torch.tensor([0.3, 1.7], dtype=torch.float64))
    assert torch.equal(other.mean, expected.mean)
    assert torch.equal(other.variance, expected.variance)


def test_goal_is_held_after_the_end(ragged: InteractionPredictor) -> None:
    clock = ragged.fitted
    assert clock is not None and isinstance(clock.phase, ElapsedClock) and clock.phase.duration is not None
    assert clock.phase.limit > 1.05
    end = clock.phase.limit * clock.phase.duration
    came = ragged.predict(*observation(), time=torch.tensor([end, end + 0.5, end + 100.0], dtype=torch.float64))
    torch.testing.assert_close(came.mean[1:], came.mean[:1].expand(2, -1), rtol=1e-9, atol=1e-9)
    torch.testing.assert_close(came.variance[1:], came.variance[:1].expand(2, -1), rtol=1e-9, atol=1e-9)


def test_default_times(fitted: InteractionPredictor) -> None:
    seen, scene = observation(seen=7)
    time = fitted.predict(seen, scene).time
    torch.testing.assert_close(time, torch.linspace(0, DURATION, SAMPLES, dtype=torch.float64))
    overdue = Trajectory(torch.linspace(0, 4.0, 9), torch.zeros(9, 1), ("x",))
    assert 4.0 <= float(fitted.predict(overdue).time[-1]) < 4.0 + DURATION / (SAMPLES - 1)


@pytest.mark.parametrize("duration", [0.7, 1.3, 1.9, 3.3, 4.7])
def test_default_times_take_no_step_for_round_off(duration: float) -> None:
    def retimed(trajectory: Trajectory | None) -> Trajectory:
        assert trajectory is not None
        return dataclasses.replace(trajectory, time=torch.linspace(0, duration, SAMPLES, dtype=torch.float64))

    def both(one: Demonstration) -> Demonstration:
        return dataclasses.replace(one, human=retimed(one.human), robot=retimed(one.robot))

    motions = changed(demonstrations(4, groups=1), both)
    with pytest.warns(HeldOutWarning, match=r"All 4 demonstrations are of one group \(0\)"):
        model = predictor().fit(motions)
    assert motions[0].human is not None
    for seen in range(1, SAMPLES):
        assert model.predict(motions[0].human.first(seen)).time.shape == (SAMPLES,)

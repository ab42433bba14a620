from __future__ import annotations

import math

import pytest
import torch

from eaip_prob.data.demonstrations import Demonstration, DemonstrationSet
from eaip_prob.data.trajectory import Trajectory
from eaip_prob.errors import InputError, NotFittedError, ShapeError
from eaip_prob.phase import DTWClock
from eaip_prob.phase.alignment import open_end

NUM = 101


def grid(end, num):
    return torch.linspace(0.0, end, num, dtype=torch.float64)


def path(scale, num=NUM):
    s = grid(1.0, num)
    return 300.0 + scale * torch.stack([40.0 * s, 15.0 * torch.sin(3.0 * s)], -1)


def demonstrations(durations=(0.7, 2.7, 1.5), scales=(1.0, 1.2, 0.5), hidden=()):
    demos = []
    for n, (duration, scale) in enumerate(zip(durations, scales, strict=True)):
        mask = torch.ones(NUM, 2, dtype=torch.bool)
        for motion, samples, signal in hidden:
            if motion == n:
                mask[samples, signal] = False
        demos.append(Demonstration(Trajectory(1.0 + grid(duration, NUM), path(scale), mask=mask)))
    return DemonstrationSet(demos)


def clock(**keywords):
    return DTWClock(num_samples=NUM, **keywords).fit(demonstrations(), "human")


def test_the_mean_reference_is_the_mean_of_the_time_normalised_motions():
    fitted = clock()
    assert torch.allclose(fitted.path, path((1.0 + 1.2 + 0.5) / 3), rtol=1e-12)
    assert fitted.duration == pytest.approx((0.7 * 2.7 * 1.5) ** (1 / 3))
    assert fitted.limit == 1.0


def test_missing_samples_have_no_part_in_the_mean():
    fitted = DTWClock(num_samples=NUM).fit(demonstrations(hidden=[(1, slice(30, 40), 1)]), "human")
    assert torch.allclose(fitted.path[:, 0], path(0.9)[:, 0], rtol=1e-12)
    assert torch.allclose(fitted.path[30:40, 1], path(0.75)[30:40, 1], rtol=1e-12)
    assert torch.allclose(fitted.path[60:, 1], path(0.9)[60:, 1], rtol=1e-12)


def test_a_phase_that_nobody_saw_has_no_mean():
    hidden = [(n, slice(30, 40), 1) for n in range(3)]
    with pytest.raises(InputError, match="each phase of each signal.*medoid"):
        DTWClock(num_samples=NUM).fit(demonstrations(hidden=hidden), "human")


def test_the_medoid_is_the_complete_demonstration_nearest_to_the_others():
    assert torch.allclose(clock(reference="medoid").path, path(1.0), rtol=1e-12)
    demos = demonstrations((1.0, 2.0, 1.0, 3.0), (1.2, 1.0, 0.5, 1.3), [(0, slice(30, 40), 1)])
    fitted = DTWClock("medoid", NUM).fit(demos, "human")
    assert torch.allclose(fitted.path, path(1.0), rtol=1e-12)
    hidden = [(n, slice(30, 40), 0) for n in range(3)]
    with pytest.raises(InputError, match="at least one demonstration without missing samples"):
        DTWClock("medoid", NUM).fit(demonstrations(hidden=hidden), "human")


def test_fit_leaves_the_clock_unchanged():
    unfitted = DTWClock(num_samples=NUM)
    unfitted.fit(demonstrations(), "human")
    assert unfitted.path is None and unfitted.duration is None


@pytest.mark.parametrize("batch", [(), (2, 3)])
def test_the_first_part_of_the_reference_has_its_phase_now_and_the_rate_that_this_implies(batch):
    fitted = clock()
    time = 5.0 + grid(0.9, 41)
    phase = fitted.estimate(Trajectory(time, fitted.path[:41].expand(*batch, 41, 2)))
    assert torch.allclose(phase.paths[..., 0, :], grid(0.4, 41).expand(*batch, 41), atol=1e-12)
    assert torch.allclose(phase.duration[..., 0], torch.full(batch, 0.9 / 0.4).double())
    assert torch.allclose(phase.at(torch.tensor([5.0 + 2.25])), torch.ones(*batch, 1, 1).double())


def test_the_estimate_follows_the_alignment_of_other_motions():
    fitted, seen = clock(), Trajectory(0.03 * torch.arange(30), path(1.1)[:60:2])
    index = int(open_end(seen.values, fitted.path)[0][-1])
    assert float(fitted.estimate(seen).paths[0, -1]) == pytest.approx(index / (NUM - 1))
    assert float(fitted.from_index(torch.tensor(50), seen).paths[0, -1]) == pytest.approx(0.5)


def test_hidden_signals_do_not_count():
    fitted = clock()
    values = fitted.path[:41].clone()
    values[:, 1] = -1e3
    seen = Trajectory(0.02 * torch.arange(41), values, names=["x", "y"]).hide(["y"])
    assert float(fitted.estimate(seen).paths[0, -1]) == pytest.approx(0.4)


@pytest.mark.parametrize("shared_time", [True, False])
def test_a_padded_tail_moves_neither_the_phase_nor_now(shared_time):
    fitted, num_seen = clock(), torch.tensor([21, 41, 60])
    time = grid(1.8, 61)
    mask = (torch.arange(61) < num_seen[:, None])[..., None].expand(3, 61, 2)
    values = torch.where(mask, fitted.path[:61], 1e3)
    times = time if shared_time else time * torch.tensor([[1.0], [0.5], [2.0]], dtype=torch.float64)
    batch = fitted.estimate(Trajectory(times, values, mask=mask))
    for n, num in enumerate(num_seen.tolist()):
        own = times.expand(3, 61)[n]
        alone = fitted.estimate(Trajectory(own[:num], fitted.path[:num]))
        assert torch.allclose(batch.duration[n], alone.duration)
        assert float(batch.paths[n, 0, num - 1]) == pytest.approx((num - 1) / 100)
        assert torch.allclose(batch.at(own)[n], alone.at(own))


def test_a_motion_that_has_not_left_the_start_goes_on_at_the_mean_duration():
    fitted = clock()
    still = Trajectory([0.0, 0.5], fitted.path[:1].expand(2, 2))
    one = Trajectory([3.0], fitted.path[40:41])
    for seen in (still, one, still.hide(["0", "1"])):
        phase = fitted.estimate(seen)
        assert float(phase.duration) == pytest.approx(fitted.duration)
        assert phase.paths[0, 0] == 0.0


def test_demonstrations_are_encoded_by_their_own_duration():
    demos = demonstrations()
    phase = clock().encoding(demos.trajectories("human"))
    assert phase.duration[:, 0].tolist() == pytest.approx([0.7, 2.7, 1.5])
    assert torch.allclose(phase.paths[:, 0], grid(1.0, NUM).expand(3, NUM), atol=1e-12)


def test_one_sample_at_a_time_equals_the_whole():
    fitted, seen = clock(), path(1.1)[:60:2]
    alignment = fitted.alignment()
    state = alignment.initial
    for sample in seen.numpy():
        index, _, state = alignment.step(sample, sample < math.inf, state)
    assert index == int(open_end(seen, fitted.path)[0][-1])


@pytest.mark.parametrize(
    "ask", [lambda c, t: c.estimate(t), lambda c, t: c.alignment(), lambda c, t: c.from_index(torch.tensor(1), t)]
)
def test_before_fit_the_clock_says_so(ask):
    with pytest.raises(NotFittedError, match="fitted DTWClock"):
        ask(DTWClock(), Trajectory([0.0, 1.0], [[0.0], [1.0]]))


def test_bad_arguments_are_refused_by_name():
    with pytest.raises(InputError, match="'mean' or 'medoid'.*got 'best' and 200"):
        DTWClock(reference="best")
    with pytest.raises(InputError, match="num_samples of at least 2.*and 1"):
        DTWClock(num_samples=1)
    with pytest.raises(ShapeError, match=r"2 signals, as fitted, got 1\. Mark signals"):
        clock().estimate(Trajectory([0.0, 1.0], [[0.0], [1.0]]))
    still = Trajectory([0.0, 1.0], [[0.0], [1.0]], mask=[[True], [False]])
    with pytest.raises(InputError, match="duration of 0 s"):
        DTWClock().fit(DemonstrationSet([Demonstration(still)]), "human")

from __future__ import annotations

import numpy as np
import pytest
import torch

from eaip_prob.data.trajectory import Trajectory
from eaip_prob.errors import InputError, NotFittedError
from eaip_prob.phase import PhaseEstimate
from eaip_prob.phase.base import check_durations, require_fitted


def row(*values):
    return torch.tensor(values, dtype=torch.float64)


def draw(seed, *shape):
    return torch.rand(shape, generator=torch.Generator().manual_seed(seed), dtype=torch.float64)


@pytest.mark.parametrize("time_batch", [(), (2, 3)])
@pytest.mark.parametrize("duration_batch", [(), (2, 3)])
def test_linear_is_time_since_the_first_sample_over_the_duration(time_batch, duration_batch):
    time, duration = 5.0 + (0.1 + draw(0, *time_batch, 6)).cumsum(-1), 0.5 + draw(1, *duration_batch)
    estimate = PhaseEstimate.linear(time, duration)
    paths = estimate.paths.expand(2, 3, 1, 6)
    for i, j in np.ndindex(2, 3):
        t, T = time.expand(2, 3, 6)[i, j], duration.expand(2, 3)[i, j]
        assert torch.allclose(paths[i, j, 0], (t - t[0]) / T, rtol=1e-14)
    assert estimate.log_weight.shape == estimate.duration.shape == (*duration_batch, 1)
    assert not estimate.log_weight.any()


@pytest.mark.parametrize("duration", [0.0, -1.0, float("nan"), float("inf")])
def test_impossible_durations_are_refused(duration):
    with pytest.raises(InputError, match="durations? ?"):
        PhaseEstimate.linear(row(0.0, 1.0), row(1.0, duration))


def curved(batch, shared_time):
    """Two hypotheses that are not linear in time, over irregular samples."""
    time = 3.0 + (0.1 + draw(0, *(() if shared_time else batch), 7)).cumsum(-1)
    paths = (0.01 + 0.1 * draw(1, *batch, 2, 7)).cumsum(-1)
    return PhaseEstimate(time, paths, torch.log(row(0.3, 0.7)).expand(*batch, 2), 0.5 + draw(2, *batch, 2))


@pytest.mark.parametrize("batch", [(), (2, 3)])
@pytest.mark.parametrize("shared_time", [True, False])
@pytest.mark.parametrize("shared_question", [True, False])
def test_at_interpolates_inside_and_goes_on_at_the_rate_outside(batch, shared_time, shared_question):
    estimate = curved(batch, shared_time)
    asked = 2.0 + 8.0 * draw(3, *(() if shared_question else batch), 40)
    got = estimate.at(asked)
    assert got.shape == (*batch, 2, 40)
    for index in np.ndindex(*batch):
        time = estimate.time.expand(*batch, 7)[index].numpy()
        question = asked.expand(*batch, 40)[index].numpy()
        for j in range(2):
            path, rate = estimate.paths[index][j].numpy(), 1.0 / float(estimate.duration[index][j])
            expected = np.interp(question, time, path)
            expected += rate * (np.maximum(question - time[-1], 0.0) + np.minimum(question - time[0], 0.0))
            assert np.allclose(got[index][j].numpy(), expected, rtol=1e-12)
    assert (asked < 3.0).any() and (asked > estimate.time.max()).any()


def test_at_the_samples_themselves_the_path_is_returned():
    estimate = curved((2, 3), shared_time=False)
    assert torch.allclose(estimate.at(estimate.time), estimate.paths, rtol=1e-13)


def test_a_linear_phase_is_linear_everywhere():
    estimate = PhaseEstimate.linear(row(1.0, 1.5, 3.0), row(0.7, 2.7))
    asked = row(0.0, 1.2, 2.9, 50.0)
    assert torch.allclose(estimate.at(asked)[:, 0], (asked - 1.0) / row(0.7, 2.7)[:, None], rtol=1e-13)


@pytest.mark.parametrize("batch", [(), (2,)])
def test_a_single_sample_goes_on_at_its_rate_in_both_directions(batch):
    estimate = PhaseEstimate(row(4.0), row(0.25).expand(*batch, 1, 1), row(0.0), row(2.0).expand(*batch, 1))
    assert torch.allclose(estimate.at(row(3.0, 4.0, 6.0)), row(-0.25, 0.25, 1.25).expand(*batch, 1, 3))


def test_durations_run_to_the_last_seen_sample_and_zero_is_refused():
    mask = torch.ones(2, 4, 1, dtype=torch.bool)
    mask[0, 2:] = False
    motions = Trajectory(row(1.0, 1.5, 3.0, 7.0), draw(0, 2, 4, 1), mask=mask)
    assert check_durations(motions).tolist() == [0.5, 6.0]
    mask[1, 1:] = False
    with pytest.raises(InputError, match=r"at least two seen samples.*motion \(1,\)"):
        check_durations(Trajectory(motions.time, motions.values, mask=mask))
    with pytest.raises(InputError, match=r"motion \(\)"):
        check_durations(Trajectory([0.0], [[1.0]]))


def test_what_was_fitted_is_returned_and_nothing_is_refused():
    assert require_fitted(0.0, "Clock") == 0.0
    with pytest.raises(NotFittedError, match=r"fitted Clock. Call fit\(demonstrations, agent\)"):
        require_fitted(None, "Clock")

from __future__ import annotations

import math

import numpy as np
import pytest
import torch

from eaip_prob.data import Trajectory, stack
from eaip_prob.errors import InputError, ShapeError


def make(batch=(), num_samples=7, num_signals=3, step=0.4, start=-0.6, seed=0, noise=False):
    generator = torch.Generator().manual_seed(seed)
    values = torch.randn(*batch, num_samples, num_signals, generator=generator, dtype=torch.float64) * 40 + 150
    mask = torch.rand(*batch, num_samples, num_signals, generator=generator) > 0.3
    time = start + step * torch.arange(num_samples, dtype=torch.float64)
    root = torch.randn(*batch, num_samples, num_signals, num_signals, generator=generator, dtype=torch.float64)
    names = [f"s{i}" for i in range(num_signals)]
    return Trajectory(time, values, names, mask, root @ root.mT if noise else None)


@pytest.mark.parametrize(
    ("arguments", "error", "message"),
    [
        ({"time": [0.0, 1.0], "values": [1.0, 2.0]}, ShapeError, r"values with shape \(\*batch, T, D\), got \(2,\)"),
        ({"time": [0.0, 1.0], "values": [[1.0], [2.0], [3.0]]}, ShapeError, r"time with shape \(\*batch, 3\)"),
        ({"time": [], "values": torch.zeros(0, 2)}, ShapeError, "at least one sample"),
        ({"time": [0.0, 0.0], "values": [[1.0], [2.0]]}, InputError, r"strictly increasing time, got a step of 0 s"),
        ({"time": [0.0, math.nan], "values": [[1.0], [2.0]]}, InputError, "finite numbers in time"),
        ({"time": [0.0, 1.0], "values": [[1.0], [math.nan]]}, InputError, r"values, got nan at index \(1, 0\)"),
        ({"time": [0.0, 1.0], "values": [["a"], ["b"]]}, InputError, "values as numbers"),
        ({"time": [0.0, 1.0], "values": [[1.0], [2.0]], "names": ["x", "y"]}, InputError, "1 different names"),
        ({"time": [0.0, 1.0], "values": [[1.0, 1.0]] * 2, "names": ["x", "x"]}, InputError, "2 different names"),
        ({"time": [0.0, 1.0], "values": [[1.0], [2.0]], "mask": [[1], [0]]}, InputError, "mask as booleans"),
        ({"time": [0.0, 1.0], "values": [[1.0], [2.0]], "mask": [[True]]}, ShapeError, "mask with the shape of values"),
        ({"time": [0.0, 1.0], "values": [[1.0], [2.0]], "noise": [[1.0], [1.0]]}, ShapeError, "Expected noise"),
        ({"time": [0.0, 1.0], "values": [[1.0], [2.0]], "noise": [[[-1.0]]] * 2}, InputError, "negative variance"),
        ({"time": [[0.0, 1.0]] * 3, "values": torch.zeros(2, 2, 1)}, ShapeError, "time with the batch axes of values"),
        ({"time": [[0.0, 1.0]] * 3, "values": torch.zeros(2, 1)}, ShapeError, "time with the batch axes of values"),
        (
            {"time": [0.0, 1.0], "values": torch.zeros(2, 2, 1), "noise": torch.ones(3, 2, 1, 1)},
            ShapeError,
            "noise with the batch axes of values",
        ),
    ],
)
def test_bad_input(arguments, error, message):
    with pytest.raises(error, match=message):
        Trajectory(**arguments)


def test_nan_is_accepted_only_where_unseen():
    values = [[1.0, math.nan], [2.0, 5.0]]
    trajectory = Trajectory([0.0, 0.5], values, mask=[[True, False], [True, True]])
    assert trajectory.values.tolist() == [[1.0, 0.0], [2.0, 5.0]]


def test_float32_becomes_float64():
    trajectory = Trajectory(torch.arange(2.0), torch.ones(2, 1))
    assert trajectory.time.dtype == trajectory.values.dtype == torch.float64


@pytest.mark.parametrize("batch", [(), (2, 3)])
def test_shapes_and_times(batch):
    trajectory = make(batch)
    assert trajectory.batch_shape == torch.Size(batch)
    assert (trajectory.num_samples, trajectory.num_signals) == (7, 3)
    seen = trajectory.mask.any(-1).reshape(-1, 7)
    ends = [trajectory.time[row.nonzero()[-1, 0]] for row in seen]
    assert trajectory.end.flatten().tolist() == [float(end) for end in ends]
    torch.testing.assert_close(trajectory.duration, trajectory.end + 0.6)


def test_end_where_nothing_was_seen():
    trajectory = Trajectory([-2.0, 1.0], [[1.0], [2.0]], mask=[[False], [False]])
    assert float(trajectory.end) == -2.0
    assert float(trajectory.duration) == 0.0


@pytest.mark.parametrize("batch", [(), (2, 3)])
def test_first_select_hide(batch):
    trajectory = make(batch, noise=True)
    first = trajectory.first(4)
    assert torch.equal(first.values, trajectory.values[..., :4, :])
    assert torch.equal(first.noise, trajectory.noise[..., :4, :, :])
    selected = trajectory.select(["s2", "s0"])
    assert selected.names == ("s2", "s0")
    assert torch.equal(selected.values, trajectory.values[..., [2, 0]])
    assert torch.equal(selected.mask, trajectory.mask[..., [2, 0]])
    assert torch.equal(selected.noise[..., 0, 1], trajectory.noise[..., 2, 0])
    before = trajectory.mask.clone()
    hidden = trajectory.hide(["s1"])
    assert not hidden.mask[..., 1].any()
    assert not hidden.values[..., 1].any()
    assert torch.equal(hidden.mask[..., [0, 2]], before[..., [0, 2]])
    assert torch.equal(trajectory.mask, before)


def test_bad_questions():
    trajectory = make()
    with pytest.raises(InputError, match=r"num_samples from 1 to 7, got 8"):
        trajectory.first(8)
    with pytest.raises(InputError, match=r"signals among \('s0', 's1', 's2'\), got \('z',\)"):
        trajectory.select(["s0", "z"])
    with pytest.raises(InputError, match="this one is single"):
        trajectory[0]


def test_index_of_a_batch():
    trajectory = make((2, 3), noise=True)
    member = trajectory[1, 2]
    assert member.batch_shape == ()
    assert torch.equal(member.values, trajectory.values[1, 2])
    assert torch.equal(member.noise, trajectory.noise[1, 2])
    assert torch.equal(trajectory[1].values, trajectory.values[1])


def test_noise_shared_by_a_batch_is_indexable():
    noise = torch.eye(2, dtype=torch.float64).expand(3, 2, 2) * 0.25
    trajectory = Trajectory([0.0, 1.0, 3.0], torch.zeros(4, 3, 2), noise=noise)
    assert torch.equal(trajectory[3].noise, noise)


def test_stack_pads_ragged_motions():
    short = make(num_samples=3, step=0.5, start=0.25, noise=True)
    long = make(num_samples=5, step=0.2, start=-0.1, seed=1, noise=True)
    batch = stack([short, long])
    assert batch.values.shape == (2, 5, 3)
    np.testing.assert_allclose(batch.time[0], [0.25, 0.75, 1.25, 1.75, 2.25])
    assert torch.equal(batch.mask[0, :3], short.mask)
    assert not batch.mask[0, 3:].any()
    assert torch.equal(batch.noise[0, :3], short.noise)
    assert torch.equal(batch.values[1], long.values)
    torch.testing.assert_close(batch.end, torch.stack([short.end, long.end]))


def test_stack_keeps_shared_time_unbatched():
    batch = stack([make(num_samples=4), make(num_samples=7, seed=1), make(num_samples=2, seed=2)])
    assert batch.time.shape == (7,)
    assert batch.values.shape == (3, 7, 3)


def test_stack_of_single_samples():
    batch = stack([Trajectory([2.0], [[1.0]]), Trajectory([0.0, 0.5], [[1.0], [2.0]])])
    assert batch.time[0].tolist() == [2.0, 3.0]


def test_stack_refuses():
    with pytest.raises(InputError, match="at least one trajectory"):
        stack([])
    with pytest.raises(InputError, match=r"single trajectories with signals \('s0', 's1', 's2'\), got \('s0', 's1'\)"):
        stack([make(), make(num_signals=2)])
    with pytest.raises(InputError, match=r"with batch \(2,\)"):
        stack([make(), make((2,))])
    with pytest.raises(InputError, match="noise for all trajectories or for none"):
        stack([make(), make(noise=True)])

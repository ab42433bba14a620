from __future__ import annotations

import pytest
import torch

from eaip_prob.data import Demonstration, DemonstrationSet, EnvironmentFeatures, Trajectory, stack
from eaip_prob.errors import InputError

LENGTHS = (6, 3, 9, 4, 7)


def single(length: int, seed: int, step: float = 0.3, noise: bool = False, start: float = -0.6) -> Trajectory:
    draw = torch.Generator().manual_seed(seed)
    values = 150.0 + 40.0 * torch.randn(length, 2, generator=draw, dtype=torch.float64)
    mask = torch.rand(length, 2, generator=draw) > 0.3
    mask[-1, seed % 2] = True
    root = torch.randn(length, 2, 2, generator=draw, dtype=torch.float64)
    time = start + step * torch.arange(length, dtype=torch.float64)
    return Trajectory(time, values, ("x", "y"), mask, root @ root.mT if noise else None)


def several(shared_time: bool, noise: bool = False) -> list[Trajectory]:
    steps = [0.3 if shared_time else 0.2 + 0.05 * number for number in range(len(LENGTHS))]
    return [single(length, seed, steps[seed], noise) for seed, length in enumerate(LENGTHS)]


def assert_same(came: Trajectory, expected: Trajectory) -> None:
    assert came.names == expected.names and came.values.shape == expected.values.shape
    assert torch.equal(came.mask, expected.mask) and torch.equal(came.values, expected.values)
    torch.testing.assert_close(
        came.time.expand(came.values.shape[:-1]), expected.time.expand(came.values.shape[:-1]), rtol=0, atol=1e-12
    )
    assert (came.noise is None) == (expected.noise is None)
    if came.noise is not None and expected.noise is not None:
        assert torch.equal(came.noise, expected.noise)


@pytest.mark.parametrize("noise", [False, True])
@pytest.mark.parametrize("num", [1, 2, 6])
def test_last_samples(num: int, noise: bool) -> None:
    motion = single(6, 1, noise=noise)
    came = motion.last(num)
    places = range(6 - num, 6)
    expected = Trajectory(
        [float(motion.time[i]) for i in places],
        torch.stack([motion.values[i] for i in places]),
        motion.names,
        torch.stack([motion.mask[i] for i in places]),
        torch.stack([motion.noise[i] for i in places]) if motion.noise is not None else None,
    )
    assert_same(came, expected)


def test_last_samples_of_a_batch_with_its_own_times() -> None:
    batch = stack(several(shared_time=False, noise=True))
    came = batch.last(2)
    assert came.values.shape == (5, 2, 2)
    for member in range(5):
        assert_same(came[member], batch[member].last(2))


@pytest.mark.parametrize("num", [0, 7, -1, 2.5])
def test_last_samples_that_are_not_there(num: int) -> None:
    with pytest.raises(InputError, match=f"num_samples from 1 to 6, got {num}"):
        single(6, 1).last(num)


@pytest.mark.parametrize("noise", [False, True])
@pytest.mark.parametrize("shared_time", [True, False])
@pytest.mark.parametrize("places", [[2], [1], [1, 3], [4, 0, 4], [3, 2, 1, 0]])
def test_members_are_those_motions_stacked_anew(places: list[int], shared_time: bool, noise: bool) -> None:
    motions = several(shared_time, noise)
    assert_same(stack(motions).members(places), stack([motions[place] for place in places]))


def test_members_keep_a_shared_time_shared() -> None:
    assert stack(several(shared_time=True)).members([1, 3]).time.shape == (4,)
    assert stack(several(shared_time=False)).members([1, 3]).time.shape == (2, 4)


def test_members_of_whom_nothing_was_seen() -> None:
    motions = [motion.hide(("x", "y")) for motion in several(shared_time=True)]
    came = stack(motions).members([1, 2])
    assert came.batch_shape == (2,) and not bool(came.mask.any())


def demonstrations(shared_time: bool) -> DemonstrationSet:
    robots = [single(length + 2, seed + 50, 0.17, start=0.1) for seed, length in enumerate(LENGTHS)]
    members = [
        Demonstration(human, robot, EnvironmentFeatures(("width",), [100.0 + number]))
        for number, (human, robot) in enumerate(zip(several(shared_time), robots, strict=True))
    ]
    return DemonstrationSet(members, ["ann", "ben", "ann", "cem", "ben"])


@pytest.mark.parametrize("shared_time", [True, False])
@pytest.mark.parametrize("places", [[0, 3], [2, 1], [4]])
def test_a_subset_is_as_built_anew(places: list[int], shared_time: bool) -> None:
    motions = demonstrations(shared_time)
    for agent in motions.agents:
        motions.trajectories(agent)
    came = motions.subset(places)
    anew = DemonstrationSet([motions[place] for place in places], [motions.groups[place] for place in places])
    assert came.groups == anew.groups and len(came) == len(places)
    for agent in ("human", "robot"):
        assert_same(came.trajectories(agent), anew.trajectories(agent))
        assert_same(came.subset([0]).trajectories(agent), anew.subset([0]).trajectories(agent))
    assert came.environments is not None and anew.environments is not None
    assert torch.equal(came.environments.value, anew.environments.value)


@pytest.mark.parametrize("asked_first", [True, False])
def test_without_the_environment_the_motions_are_as_built_anew(asked_first: bool) -> None:
    motions = demonstrations(shared_time=False)
    if asked_first:
        motions.trajectories("human")
    came = motions.without_environment()
    anew = DemonstrationSet([Demonstration(one.human, one.robot) for one in motions], motions.groups)
    assert came.environments is None and came.groups == motions.groups and motions.environments is not None
    for agent in ("human", "robot"):
        assert_same(came.trajectories(agent), anew.trajectories(agent))
        assert_same(came.subset([3, 1]).trajectories(agent), anew.subset([3, 1]).trajectories(agent))


def test_what_a_part_learns_later_stays_its_own() -> None:
    motions = demonstrations(shared_time=False)
    part, alone = motions.subset([1, 3]), motions.without_environment()
    assert part.trajectories("human").batch_shape == (2,) and alone.trajectories("robot").batch_shape == (5,)
    assert motions.trajectories("human").batch_shape == motions.trajectories("robot").batch_shape == (5,)

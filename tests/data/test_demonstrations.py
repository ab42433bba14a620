from __future__ import annotations

import pytest
import torch

from eaip_prob.data import Demonstration, DemonstrationSet, EnvironmentFeatures, Trajectory
from eaip_prob.errors import InputError


def motion(num_samples=4, names=("x", "y"), scale=1.0):
    time = 0.3 * torch.arange(num_samples, dtype=torch.float64)
    return Trajectory(time, scale * torch.arange(num_samples * len(names)).reshape(num_samples, -1), names)


def demonstration(number=0, features=("w", "h")):
    environment = EnvironmentFeatures(features, [10.0 + number, 20.0 + number])
    return Demonstration(motion(4 + number), motion(4 + number, ("grip",), 7.0), environment)


def make(groups=None, count=6):
    return DemonstrationSet([demonstration(i) for i in range(count)], groups)


def test_demonstration_refuses():
    with pytest.raises(InputError, match="human or a robot trajectory in a demonstration, got neither"):
        Demonstration()
    batch = Trajectory([0.0, 1.0], torch.zeros(2, 2, 1))
    with pytest.raises(InputError, match=r"single \(unbatched\) parts"):
        Demonstration(human=batch)
    with pytest.raises(InputError, match=r"single \(unbatched\) parts"):
        Demonstration(human=motion(), environment=EnvironmentFeatures(["a"], [[1.0], [2.0]]))


def test_agents():
    assert demonstration().agents == ("human", "robot")
    assert Demonstration(robot=motion()).agents == ("robot",)


@pytest.mark.parametrize(
    ("other", "message"),
    [
        (Demonstration(human=motion()), "an environment in all demonstrations or in none"),
        (Demonstration(motion(), motion(names=("grip",))), "number 1 differs"),
        (
            Demonstration(motion(names=("a", "b")), motion(names=("grip",)), EnvironmentFeatures(["w", "h"], [1, 2])),
            r"human signals \('x', 'y'\) in all demonstrations, number 1 has \('a', 'b'\)",
        ),
        (demonstration(features=("w", "other")), "Expected environment features"),
    ],
)
def test_set_refuses_others(other, message):
    with pytest.raises(InputError, match=message):
        DemonstrationSet([demonstration(), other])


def test_set_refuses_empty_and_wrong_groups():
    with pytest.raises(InputError, match="at least one demonstration"):
        DemonstrationSet([])
    with pytest.raises(InputError, match="Expected 6 groups, one per demonstration, got 2"):
        make(groups=["a", "b"])


def test_sequence():
    demonstrations = make(groups=[5, 5, 5, "a", "a", "b"])
    assert len(demonstrations) == 6
    assert list(demonstrations)[2] is demonstrations[2]
    part = demonstrations[2:5]
    assert isinstance(part, DemonstrationSet)
    assert part.groups == (5, "a", "a")
    assert "6 of ('human', 'robot'), 3 groups" in repr(demonstrations)
    assert make().groups == (0, 1, 2, 3, 4, 5)


def test_trajectories_are_padded():
    demonstrations = make()
    batch = demonstrations.trajectories("robot")
    assert batch.values.shape == (6, 9, 1)
    assert batch.time.shape == (9,)
    assert batch.mask.sum(1).flatten().tolist() == [4, 5, 6, 7, 8, 9]
    with pytest.raises(InputError, match=r"agent among \('human', 'robot'\), got 'nobody'"):
        demonstrations.trajectories("nobody")


def test_environments_follow_the_first_names():
    swapped = demonstration(1).environment.ordered_as(("h", "w"))
    second = Demonstration(motion(), motion(names=("grip",)), swapped)
    environments = DemonstrationSet([demonstration(), second]).environments
    assert environments.value.tolist() == [[10.0, 20.0], [11.0, 21.0]]
    assert DemonstrationSet([Demonstration(human=motion())]).environments is None


def test_subset_and_split_leave_groups_whole():
    demonstrations = make(groups=["a", "b", "a", "c", "b", "c"])
    subset = demonstrations.subset([4, 0])
    assert subset.groups == ("b", "a")
    assert subset[0] is demonstrations[4]
    train, test = demonstrations.split(["a", "c"])
    assert train.groups == ("b", "b")
    assert test.groups == ("a", "a", "c", "c")
    assert [d.human.num_samples for d in train] == [5, 8]
    assert [d.human.num_samples for d in test] == [4, 6, 7, 9]


@pytest.mark.parametrize("held_out", [["z"], ["a", "b", "c"], []])
def test_split_refuses(held_out):
    with pytest.raises(InputError, match="some but not all of the groups"):
        make(groups=["a", "b", "a", "c", "b", "c"]).split(held_out)


def test_split_names_an_unknown_group():
    with pytest.raises(InputError, match="z"):
        make(groups=["a", "b", "a", "c", "b", "c"]).split(["a", "z"])

"""Demonstrations of one or two agents, and sets of them with groups for held-out choices."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import overload

from eaip_prob.checks import check_type
from eaip_prob.data.environment import EnvironmentFeatures, stack_environments
from eaip_prob.data.trajectory import Trajectory, stack
from eaip_prob.errors import InputError

AGENTS = ("human", "robot")


@dataclass(frozen=True, eq=False)
class Demonstration:
    """One recorded motion: the partner watched, the robot (or whoever plays it), and the scene.

    Either agent may be absent; a single agent is the `human`.

    Args:
        human: single trajectory of the agent that is observed online, or None.
        robot: single trajectory of the agent whose motion is predicted, or None.
        environment: single set of features, or None where the task has none.

    Raises:
        InputError: no agent at all, or batched parts.

    Example:
        >>> reach = Trajectory(time=[0.0, 0.5], values=[[0.0], [1.0]], names=["x"])
        >>> box = EnvironmentFeatures(("width",), [0.2])
        >>> Demonstration(human=reach, environment=box).agents
        ('human',)
    """

    human: Trajectory | None = None
    robot: Trajectory | None = None
    environment: EnvironmentFeatures | None = None

    def __post_init__(self) -> None:
        agents = [agent for agent in (self.human, self.robot) if agent is not None]
        for agent in agents:
            check_type("human and robot", agent, Trajectory, "Make one with Trajectory(time, values, names).")
        if self.environment is not None:
            advice = "Make one with EnvironmentFeatures(names, value)."
            check_type("environment", self.environment, EnvironmentFeatures, advice)
        if not agents:
            raise InputError("Expected a human or a robot trajectory in a demonstration, got neither.")
        if any(agent.batch_shape for agent in agents) or (
            self.environment is not None and self.environment.value.ndim > 1
        ):
            raise InputError(
                "Expected single (unbatched) parts in a demonstration. Build one demonstration for each motion."
            )

    @property
    def agents(self) -> tuple[str, ...]:
        """Names of the agents present, `human` first."""
        return tuple(name for name in AGENTS if getattr(self, name) is not None)


class DemonstrationSet(Sequence[Demonstration]):
    """An immutable sequence of demonstrations that share agents, signals and features.

    Args:
        demonstrations: at least one.
        groups: N integers or strings (person, session, object); held-out choices leave whole groups out.
            Default: every demonstration is its own group.

    Raises:
        InputError: no demonstration, other agents or signals in one of them, or a wrong number of groups.

    Example:
        >>> reach = Trajectory(time=[0.0, 0.5], values=[[0.0], [1.0]], names=["x"])
        >>> motions = DemonstrationSet([Demonstration(human=reach)] * 3, groups=["anna", "ben", "anna"])
        >>> training, held_out = motions.split(["anna"])
        >>> training.groups, held_out.groups
        (('ben',), ('anna', 'anna'))
    """

    def __init__(self, demonstrations: Sequence[Demonstration], groups: Sequence[int | str] | None = None) -> None:
        self._demonstrations = tuple(demonstrations)
        if not self._demonstrations:
            raise InputError("Expected at least one demonstration, got none.")
        self.groups: tuple[int | str, ...] = tuple(range(len(self._demonstrations)) if groups is None else groups)
        if len(self.groups) != len(self._demonstrations):
            raise InputError(
                f"Expected {len(self._demonstrations)} groups, one per demonstration, got {len(self.groups)}."
            )
        self._stacked: dict[str, Trajectory] = {}
        for number, demonstration in enumerate(self._demonstrations):
            self._check_alike(number, demonstration)

    def _check_alike(self, number: int, demonstration: Demonstration) -> None:
        advice = "Make one with Demonstration(human, robot, environment)."
        check_type(f"member number {number} of the set", demonstration, Demonstration, advice)
        first = self._demonstrations[0]
        if demonstration.agents != first.agents or (demonstration.environment is None) != (first.environment is None):
            raise InputError(
                f"Expected agents {first.agents} and an environment in all demonstrations or in none; "
                f"number {number} differs."
            )
        for agent in first.agents:
            expected, came = getattr(first, agent).names, getattr(demonstration, agent).names
            if came != expected:
                raise InputError(
                    f"Expected {agent} signals {expected} in all demonstrations, number {number} has {came}."
                )
        if first.environment is not None and demonstration.environment is not None:
            demonstration.environment.ordered_as(first.environment.names)

    @overload
    def __getitem__(self, index: int) -> Demonstration: ...
    @overload
    def __getitem__(self, index: slice) -> DemonstrationSet: ...
    def __getitem__(self, index: int | slice) -> Demonstration | DemonstrationSet:
        if isinstance(index, slice):
            return DemonstrationSet(self._demonstrations[index], self.groups[index])
        return self._demonstrations[index]

    def __len__(self) -> int:
        return len(self._demonstrations)

    def __iter__(self) -> Iterator[Demonstration]:
        return iter(self._demonstrations)

    def __repr__(self) -> str:
        return f"DemonstrationSet({len(self)} of {self.agents}, {len(set(self.groups))} groups)"

    @property
    def agents(self) -> tuple[str, ...]:
        """Names of the agents present in every demonstration."""
        return self._demonstrations[0].agents

    def signals(self, agent: str) -> tuple[str, ...]:
        """Names of the signals of one agent."""
        return getattr(self._demonstrations[0], agent).names

    def trajectories(self, agent: str) -> Trajectory:
        """All motions of one agent as one padded batch (N, T, D).

        Raises:
            InputError: no such agent.
        """
        if agent not in self.agents:
            raise InputError(f"Expected an agent among {self.agents}, got {agent!r}.")
        if agent not in self._stacked:
            self._stacked[agent] = stack([getattr(demonstration, agent) for demonstration in self])
        return self._stacked[agent]

    @property
    def environments(self) -> EnvironmentFeatures | None:
        """All features as one batch (N, E), or None where the demonstrations have none."""
        features = [demonstration.environment for demonstration in self if demonstration.environment is not None]
        return stack_environments(features) if features else None

    def subset(self, indices: Sequence[int]) -> DemonstrationSet:
        """The demonstrations at the given places, in that order."""
        places = [int(i) for i in indices]
        subset = DemonstrationSet([self[i] for i in places], [self.groups[i] for i in places])
        # Padding hundreds of motions anew would cost more than fitting to them.
        subset._stacked |= {agent: motions.members(places) for agent, motions in self._stacked.items()}
        return subset

    def split(self, held_out: Sequence[int | str]) -> tuple[DemonstrationSet, DemonstrationSet]:
        """(the rest, the demonstrations of the groups named).

        Raises:
            InputError: a group that does not occur, or nothing left on one side.
        """
        unknown = set(held_out) - set(self.groups)
        inside = [i for i, group in enumerate(self.groups) if group in set(held_out)]
        outside = [i for i in range(len(self)) if i not in set(inside)]
        if unknown or not inside or not outside:
            raise InputError(
                f"Expected held_out to name some but not all of the groups {sorted(set(self.groups), key=str)}, "
                f"got {tuple(held_out)}."
            )
        return self.subset(outside), self.subset(inside)

    def without_environment(self) -> DemonstrationSet:
        """The same motions, nothing known of the scene."""
        alone = DemonstrationSet([Demonstration(motion.human, motion.robot) for motion in self], self.groups)
        alone._stacked |= self._stacked
        return alone

    def save(self, path: str | Path) -> Path:
        """Writes the set to one .npz file without pickled objects; see `data.storage`."""
        from eaip_prob.data.storage import save

        return save(self, Path(path))

    @classmethod
    def load(cls, path: str | Path) -> DemonstrationSet:
        """Reads a set that `save` wrote; nothing is unpickled."""
        from eaip_prob.data.storage import load

        return load(Path(path))

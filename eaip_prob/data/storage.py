"""Demonstration sets in one .npz file.

Ragged motions are concatenated: sample rows `offsets[i]:offsets[i + 1]` belong to demonstration i. All strings
(signal names, feature names, groups) are in one JSON header, which keeps integer and string groups apart.
"""

from __future__ import annotations

import json
import numbers
from pathlib import Path
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray

from eaip_prob.data.archive import (
    BOOLEANS,
    INTEGERS,
    NUMBERS,
    STRINGS,
    check_arrays,
    check_offsets,
    read_arrays,
    write_arrays,
)
from eaip_prob.data.demonstrations import AGENTS, Demonstration, DemonstrationSet
from eaip_prob.data.environment import EnvironmentFeatures
from eaip_prob.data.trajectory import Trajectory
from eaip_prob.errors import DataFileError, InputError, MissingDataError

FORMAT = "eaip_prob.demonstrations"
VERSION = 1

_AGENT_ARRAYS = {
    "offsets": (INTEGERS, 1),
    "time": (NUMBERS, 1),
    "values": (NUMBERS, 2),
    "mask": (BOOLEANS, 2),
    "has_noise": (BOOLEANS, 1),
    "noise": (NUMBERS, 3),
}
_ENVIRONMENT_ARRAYS = {"value": (NUMBERS, 2), "covariance": (NUMBERS, 3), "observed": (BOOLEANS, 2)}


def save(demonstrations: DemonstrationSet, path: str | Path) -> Path:
    """Writes a set to one .npz file without pickled objects; an existing file is replaced whole or not at all.

    Features of the scene are written in the order of the first demonstration's names. The same set gives the
    same bytes.

    Args:
        demonstrations: the set; not altered.
        path: where to write; missing folders are made.

    Returns:
        the path.

    Raises:
        InputError: a group that is neither an integer nor a string, or a path that is a folder.

    Example:
        >>> import tempfile
        >>> reach = Trajectory(time=[0.0, 0.5], values=[[0.0], [1.0]], names=["x"])
        >>> with tempfile.TemporaryDirectory() as folder:
        ...     load(save(DemonstrationSet([Demonstration(human=reach)], groups=["anna"]), f"{folder}/set.npz")).groups
        ('anna',)
    """
    first = demonstrations[0]
    features = first.environment.names if first.environment is not None else None
    header = {
        "format": FORMAT,
        "version": VERSION,
        "signals": {agent: getattr(first, agent).names for agent in demonstrations.agents},
        "features": features,
        "groups": [_plain_group(group) for group in demonstrations.groups],
    }
    arrays = {"header": np.array(json.dumps(header, sort_keys=True))}
    for agent in demonstrations.agents:
        parts = _agent_arrays([getattr(demonstration, agent) for demonstration in demonstrations])
        arrays |= {f"{agent}.{name}": array for name, array in parts.items()}
    environments = demonstrations.environments
    if environments is not None:
        arrays |= {f"environment.{name}": _numpy(getattr(environments, name)) for name in _ENVIRONMENT_ARRAYS}
    return write_arrays(Path(path), arrays)


def _plain_group(group: Any) -> int | str:
    if isinstance(group, str):
        return str(group)
    if isinstance(group, numbers.Integral):
        return int(group)
    raise InputError(f"Expected groups as integers or strings, got {group!r} of type {type(group).__name__}.")


def _agent_arrays(trajectories: list[Trajectory]) -> dict[str, NDArray]:
    size = trajectories[0].num_signals
    noise = [_numpy(trajectory.noise) for trajectory in trajectories if trajectory.noise is not None]
    return {
        "offsets": np.cumsum([0, *(trajectory.num_samples for trajectory in trajectories)]),
        "time": np.concatenate([_numpy(trajectory.time) for trajectory in trajectories]),
        "values": np.concatenate([_numpy(trajectory.values) for trajectory in trajectories]),
        "mask": np.concatenate([_numpy(trajectory.mask) for trajectory in trajectories]),
        "has_noise": np.array([trajectory.noise is not None for trajectory in trajectories]),
        "noise": np.concatenate([np.zeros((0, size, size)), *noise]),
    }


def _numpy(tensor: torch.Tensor) -> NDArray:
    return tensor.detach().cpu().numpy()


def load(path: str | Path) -> DemonstrationSet:
    """Reads a set that `save` wrote; nothing is unpickled.

    Args:
        path: the .npz file.

    Returns:
        the set, equal in every value, name and group to the one that was saved.

    Raises:
        MissingDataError: no such file.
        DataFileError: damaged, truncated, of another kind or format version, or arrays that do not fit together.

    Example:
        >>> import tempfile
        >>> reach = Trajectory(time=[0.0, 0.5], values=[[0.0], [0.3]], names=["x"])
        >>> with tempfile.TemporaryDirectory() as folder:
        ...     load(save(DemonstrationSet([Demonstration(human=reach)]), f"{folder}/set.npz"))[0].human.values.tolist()
        [[0.0], [0.3]]
    """
    path = Path(path)
    if not path.exists():
        raise MissingDataError(f"Expected demonstrations at {path}, got no such file. Check the path.")
    arrays = read_arrays(path)
    header = _header(path, arrays)
    expected = {f"{agent}.{name}": kind for agent in header["signals"] for name, kind in _AGENT_ARRAYS.items()}
    if header["features"] is not None:
        expected |= {f"environment.{name}": kind for name, kind in _ENVIRONMENT_ARRAYS.items()}
    check_arrays(path, arrays, expected)
    try:
        return _demonstrations(arrays, header)
    except InputError as error:
        raise DataFileError(f"Expected arrays that fit together in {path}: {error} Make the file again.") from error


def _header(path: Path, arrays: dict[str, NDArray]) -> dict[str, Any]:
    check_arrays(path, arrays, {"header": (STRINGS, 0)})
    text = str(arrays["header"])
    try:
        header = json.loads(text)
    except ValueError as error:
        raise DataFileError(f"Expected a JSON header in {path}, got {text[:40]!r} ({error}).") from error
    if not isinstance(header, dict) or header.get("format") != FORMAT:
        raise DataFileError(f"Expected the format {FORMAT!r} in the header of {path}, got {text[:60]!r}.")
    if header.get("version") != VERSION:
        raise DataFileError(
            f"Expected version {VERSION} of the format {FORMAT!r} in {path}, got {header.get('version')!r}. "
            "Read it with the version of the package that wrote it, or save it again."
        )
    if not _is_complete(header):
        raise DataFileError(f"Expected signals, features and groups in the header of {path}, got {text[:200]!r}.")
    return header


def _is_complete(header: dict[str, Any]) -> bool:
    signals, features, groups = (header.get(key, 0) for key in ("signals", "features", "groups"))
    return (
        isinstance(signals, dict)
        and set(signals) <= set(AGENTS)
        and all(isinstance(names, list) for names in signals.values())
        and (features is None or isinstance(features, list))
        and isinstance(groups, list)
        and all(type(group) in (int, str) for group in groups)
    )


def _demonstrations(arrays: dict[str, NDArray], header: dict[str, Any]) -> DemonstrationSet:
    count = len(header["groups"])
    agents = {agent: _trajectories(arrays, agent, names, count) for agent, names in header["signals"].items()}
    environments: list[EnvironmentFeatures | None] = [None] * count
    if header["features"] is not None:
        environments = list(_environments(arrays, header["features"], count))
    demonstrations = [
        Demonstration(**{agent: motions[i] for agent, motions in agents.items()}, environment=environments[i])
        for i in range(count)
    ]
    return DemonstrationSet(demonstrations, header["groups"])


def _trajectories(arrays: dict[str, NDArray], agent: str, names: list[str], count: int) -> list[Trajectory]:
    part = {name: arrays[f"{agent}.{name}"] for name in _AGENT_ARRAYS}
    offsets, has_noise = part["offsets"].astype(np.int64), part["has_noise"]
    for name in ("time", "values", "mask"):
        check_offsets(f"{agent}.{name}", offsets, count, len(part[name]))
    if len(has_noise) != count:
        raise InputError(f"Expected {count} entries in {agent}.has_noise, got {len(has_noise)}.")
    noise_offsets = np.cumsum([0, *np.where(has_noise, np.diff(offsets), 0)])
    check_offsets(f"{agent}.noise", noise_offsets, count, len(part["noise"]))
    time, values, all_noise = (_tensor(part[name]) for name in ("time", "values", "noise"))
    motions = []
    for i in range(count):
        rows, noise_rows = slice(offsets[i], offsets[i + 1]), slice(noise_offsets[i], noise_offsets[i + 1])
        noise = all_noise[noise_rows] if has_noise[i] else None
        motions.append(Trajectory(time[rows], values[rows], tuple(names), torch.tensor(part["mask"][rows]), noise))
    return motions


def _tensor(array: NDArray) -> torch.Tensor:
    return torch.from_numpy(array.astype(np.float64))


def _environments(arrays: dict[str, NDArray], names: list[str], count: int) -> list[EnvironmentFeatures]:
    value, covariance = _tensor(arrays["environment.value"]), _tensor(arrays["environment.covariance"])
    observed = torch.tensor(arrays["environment.observed"])
    if not len(value) == len(covariance) == len(observed) == count:
        raise InputError(f"Expected environments for {count} demonstrations, got {len(value)}.")
    return [EnvironmentFeatures(tuple(names), value[i], covariance[i], observed[i]) for i in range(count)]

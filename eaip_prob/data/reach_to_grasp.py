"""Reader of recorded reaches towards cubes: elbow and wrist are watched, the hand's opening is predicted.

Layout of `reach_cube_train.npz`: the rows `offsets[i]:offsets[i + 1]` of `xy` (rows, joints, 2; pixels), `prob`
(rows, joints; 0 where the joint was not found) and `time` (rows; seconds, 0 at the onset) are motion i; `joints`
names the joints; `participant` and `cube_edge_cm` have one entry per motion.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Literal

import numpy as np
import torch
from numpy.typing import NDArray

from eaip_prob.data.archive import INTEGERS, NUMBERS, STRINGS, check_arrays, check_offsets, read_recording
from eaip_prob.data.demonstrations import Demonstration, DemonstrationSet
from eaip_prob.data.environment import EnvironmentFeatures
from eaip_prob.data.trajectory import Trajectory
from eaip_prob.errors import DataFileError, InputError

FILE = "reach_cube_train.npz"
TIPS = ("RThumb4FingerTip", "RIndex4FingerTip")

_ARRAYS = {
    "xy": (NUMBERS, 3),
    "prob": (NUMBERS, 2),
    "time": (NUMBERS, 1),
    "offsets": (INTEGERS, 1),
    "participant": (INTEGERS, 1),
    "cube_edge_cm": (NUMBERS, 1),
    "joints": (STRINGS, 1),
}


def read_reach_to_grasp(
    folder: str | Path | None,
    human: Sequence[str] = ("RElbow", "RWrist"),
    robot: Literal["aperture", "tips"] = "aperture",
) -> DemonstrationSet:
    """Reaches to grasp a cube, as demonstrations of a limb (human) and of a grip (robot).

    Time is as recorded (0 at the onset; the first sample lies about 0.3 s before it); motions are ragged. A joint
    whose confidence is 0 was not found and is masked, whatever its position says. Groups are the participants.

    Args:
        folder: where `reach_cube_train.npz` lies (`data_dir` of the configuration).
        human: names of the joints watched; each gives the signals "NAME x" and "NAME y", pixels.
        robot: "aperture", the distance from thumb tip to index tip (one signal, pixels, seen where both tips
            are), or "tips", x and y of both (four signals, pixels).

    Returns:
        one demonstration per motion, with the cube's edge in metres as the feature `cube_edge`.

    Raises:
        MissingDataError: no folder, or no such file in it.
        DataFileError: another layout, or a motion whose time does not increase.
        InputError: a joint that was not recorded, or another `robot`.

    Example:
        >>> read_reach_to_grasp("no/such/folder")
        Traceback (most recent call last):
            ...
        eaip_prob.errors.MissingDataError: Expected the file reach_cube_train.npz in no/such/folder, got no such \
file; set data_dir to the folder that holds it.
    """
    if robot not in ("aperture", "tips"):
        raise InputError(f"Expected robot as 'aperture' or 'tips', got {robot!r}.")
    path, arrays = read_recording(folder, FILE)
    check_arrays(path, arrays, _ARRAYS)
    _check_layout(path, arrays)
    position, seen = arrays["xy"].astype(np.float64), arrays["prob"] > 0
    limb = _joint_signals(position, seen, arrays["joints"], human)
    grip = _joint_signals(position, seen, arrays["joints"], TIPS)
    if robot == "aperture":
        grip = _aperture(*grip[:2])
    motions = [_demonstration(path, arrays, number, limb, grip) for number in range(len(arrays["offsets"]) - 1)]
    return DemonstrationSet(motions, [int(person) for person in arrays["participant"]])


def _check_layout(path: Path, arrays: dict[str, NDArray]) -> None:
    rows, joints, count = len(arrays["time"]), len(arrays["joints"]), len(arrays["participant"])
    check_offsets(f"time in {path}", arrays["offsets"], count, rows)
    expected = {"xy": (rows, joints, 2), "prob": (rows, joints), "cube_edge_cm": (count,)}
    for name, shape in expected.items():
        if arrays[name].shape != shape:
            raise DataFileError(f"Expected array {name!r} in {path} with shape {shape}, got {arrays[name].shape}.")


_Signals = tuple[NDArray, NDArray, tuple[str, ...]]


def _joint_signals(position: NDArray, seen: NDArray, recorded: NDArray, joints: Sequence[str]) -> _Signals:
    """Values and masks (rows, 2 per joint) with the signals' names."""
    names = [str(name) for name in recorded]
    unknown = [joint for joint in joints if joint not in names]
    if unknown or not joints or isinstance(joints, str):
        raise InputError(f"Expected joints among {names}, got {joints!r}.")
    index = [names.index(joint) for joint in joints]
    values = position[:, index].reshape(len(position), -1)
    return values, np.repeat(seen[:, index], 2, axis=1), tuple(f"{joint} {axis}" for joint in joints for axis in "xy")


def _aperture(tips: NDArray, seen: NDArray) -> _Signals:
    between = tips[:, :2] - tips[:, 2:]
    return np.hypot(between[:, :1], between[:, 1:]), seen[:, :1] & seen[:, 2:3], ("aperture",)


def _demonstration(
    path: Path, arrays: dict[str, NDArray], number: int, limb: _Signals, grip: _Signals
) -> Demonstration:
    rows = slice(*arrays["offsets"][number : number + 2])
    time = torch.from_numpy(arrays["time"][rows].astype(np.float64))
    try:
        human, robot = (
            Trajectory(time, torch.from_numpy(values[rows].copy()), names, torch.tensor(seen[rows]))
            for values, seen, names in (limb, grip)
        )
        edge = torch.tensor([float(arrays["cube_edge_cm"][number]) / 100.0], dtype=torch.float64)
        features = EnvironmentFeatures(("cube_edge",), edge)
    except InputError as error:
        raise DataFileError(f"Expected a usable motion number {number} in {path}: {error}") from error
    return Demonstration(human, robot, features)

"""Reader of recorded hand-overs: the taker's hand is watched, the giver's hand is predicted.

Layout of `kth_handover_train.npz`: `giver` and `taker` (recordings, frames, columns) with `columns` naming x, y, z
(metres) among them, `fps`, and `index`, the number of each recording. The giver's pose is that of the baton,
which stands for the giver's hand until the transfer and moves with the taker afterwards.
"""

from __future__ import annotations

import warnings
from pathlib import Path

import numpy as np
import torch
from numpy.typing import NDArray

from eaip_prob.checks import check_positive
from eaip_prob.data.archive import INTEGERS, NUMBERS, STRINGS, check_arrays, read_recording
from eaip_prob.data.demonstrations import Demonstration, DemonstrationSet
from eaip_prob.data.environment import EnvironmentFeatures
from eaip_prob.data.trajectory import Trajectory
from eaip_prob.errors import DataFileError

FILE = "kth_handover_train.npz"
AXES = ("x", "y", "z")

# Seconds over which a line is fitted for the speed: positions are stored to about 0.5 mm and jump between frames,
# so that differences of neighbouring frames exceed the onset's speed at rest.
_SPEED_WINDOW = 0.2
_MEETING_MARGIN = 0.02

_ARRAYS = {
    "giver": (NUMBERS, 3),
    "taker": (NUMBERS, 3),
    "columns": (STRINGS, 1),
    "fps": (NUMBERS, 0),
    "index": (INTEGERS, 1),
}


def read_handover(folder: str | Path | None, onset_speed: float = 0.1) -> DemonstrationSet:
    """Hand-overs from the first movement to the meeting of the hands, as demonstrations.

    A motion runs from the frame where the speed of either hand first exceeds `onset_speed` to the first frame
    whose distance between the hands is within 2 cm of the smallest one of the recording; later frames are the
    taker's and are dropped. The speed is the slope of a line fitted to 0.2 s of positions around a frame (the
    first and last 0.1 s take the slope of the first and last full window). Hands that move in the first frame
    start there. Time is 0 at the motion's first frame and shared by both hands.

    A recording without such a motion of at least 0.2 s is left out and named in a `UserWarning`. Each recording is
    its own group, by its number.

    Args:
        folder: where `kth_handover_train.npz` lies (`data_dir` of the configuration).
        onset_speed: m/s.

    Returns:
        human: the taker's x, y, z; robot: the giver's x, y, z (metres); environment: `giver_x`, `giver_y`,
        `giver_z`, the giver's position at the motion's first frame, which is known when the motion begins.

    Raises:
        MissingDataError: no folder, or no such file in it.
        DataFileError: another layout, positions that are not finite, or no usable recording.

    Example:
        >>> read_handover(None)
        Traceback (most recent call last):
            ...
        eaip_prob.errors.MissingDataError: Expected the folder of the file kth_handover_train.npz, got none; set \
data_dir to the folder that holds it.
    """
    check_positive("onset_speed", onset_speed)
    path, arrays = read_recording(folder, FILE)
    check_arrays(path, arrays, _ARRAYS)
    fps = float(arrays["fps"])
    giver, taker = _positions(path, arrays, "giver"), _positions(path, arrays, "taker")
    _check_layout(path, arrays, giver, taker)
    window = _window(fps)
    first = _onset(giver, taker, window, fps, onset_speed)
    last = _meeting(giver, taker)
    fits = (first < giver.shape[1]) & (last - first + 1 >= window)
    _report_left_out(path, arrays["index"][~fits], int(fits.sum()))
    motions = [
        _demonstration(giver[i, first[i] : last[i] + 1], taker[i, first[i] : last[i] + 1], fps)
        for i in np.flatnonzero(fits)
    ]
    return DemonstrationSet(motions, [int(number) for number in arrays["index"][fits]])


def _positions(path: Path, arrays: dict[str, NDArray], hand: str) -> NDArray:
    columns = [str(name) for name in arrays["columns"]]
    if not set(AXES) <= set(columns) or arrays[hand].shape[2] != len(columns):
        raise DataFileError(
            f"Expected columns {AXES} in {path}, one name per column of {hand!r}, got {columns} for shape "
            f"{arrays[hand].shape}."
        )
    position = arrays[hand][:, :, [columns.index(axis) for axis in AXES]].astype(np.float64)
    if not np.isfinite(position).all():
        recording = arrays["index"][np.argwhere(~np.isfinite(position))[0, 0]]
        raise DataFileError(f"Expected finite positions of {hand!r} in {path}, got others in recording {recording}.")
    return position


def _check_layout(path: Path, arrays: dict[str, NDArray], giver: NDArray, taker: NDArray) -> None:
    fps, count = float(arrays["fps"]), len(arrays["index"])
    if not (np.isfinite(fps) and fps > 0):
        raise DataFileError(f"Expected fps above zero in {path}, got {fps}.")
    if giver.shape != taker.shape or len(giver) != count or giver.shape[1] < _window(fps):
        raise DataFileError(
            f"Expected giver and taker in {path} alike for {count} recordings of at least {_window(fps)} frames, "
            f"got {giver.shape[:2]} and {taker.shape[:2]}."
        )


def _window(fps: float) -> int:
    return 2 * round(0.5 * _SPEED_WINDOW * fps) + 1


def speed(position: NDArray, window: int, fps: float) -> NDArray:
    """Speed (*batch, T) from positions (*batch, T, axes) by least-squares lines over `window` frames (odd)."""
    offset = np.arange(window) - window // 2
    slope = offset * fps / (offset**2).sum()
    views = np.lib.stride_tricks.sliding_window_view(position, window, axis=-2)
    inner = np.linalg.norm(views @ slope, axis=-1)
    return np.pad(inner, [(0, 0)] * (inner.ndim - 1) + [(window // 2, window // 2)], mode="edge")


def _onset(giver: NDArray, taker: NDArray, window: int, fps: float, onset_speed: float) -> NDArray:
    """First frame at which either hand moves; the number of frames where none does."""
    moving = np.maximum(speed(giver, window, fps), speed(taker, window, fps)) > onset_speed
    return np.where(moving.any(axis=1), moving.argmax(axis=1), moving.shape[1])


def _meeting(giver: NDArray, taker: NDArray) -> NDArray:
    distance = np.linalg.norm(giver - taker, axis=-1)
    return (distance <= distance.min(axis=1, keepdims=True) + _MEETING_MARGIN).argmax(axis=1)


def _report_left_out(path: Path, left_out: NDArray, num_kept: int) -> None:
    if num_kept == 0:
        raise DataFileError(f"Expected hand-overs that move before the hands meet in {path}, got none.")
    if len(left_out):
        warnings.warn(
            f"Left out recordings {left_out.tolist()} of {path}: no motion of at least {_SPEED_WINDOW} s before "
            f"the hands meet. {num_kept} are kept.",
            UserWarning,
            stacklevel=3,
        )


def _demonstration(giver: NDArray, taker: NDArray, fps: float) -> Demonstration:
    time = torch.arange(len(giver), dtype=torch.float64) / fps
    giver_values = torch.from_numpy(giver.copy())
    return Demonstration(
        human=Trajectory(time, torch.from_numpy(taker.copy()), AXES),
        robot=Trajectory(time, giver_values, AXES),
        environment=EnvironmentFeatures(tuple(f"giver_{axis}" for axis in AXES), giver_values[0]),
    )

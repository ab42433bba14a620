"""Reading and writing .npz files: nothing is unpickled, nothing that exists is lost, every refusal is typed."""

from __future__ import annotations

import io
import zipfile
import zlib
from collections.abc import Mapping
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from eaip_prob.errors import DataFileError, MissingDataError
from eaip_prob.files import make_folder_of, replacing

_ADVICE = "data_dir to the folder that holds it"
NUMBERS, INTEGERS, BOOLEANS, STRINGS = "fiu", "iu", "b", "U"

# What the zip and zlib modules raise for damaged members: a wrong flag bit reads as encryption or as a method
# that is not implemented.
_DAMAGE = (zipfile.BadZipFile, zlib.error, EOFError, RuntimeError, OSError, ValueError)


def read_arrays(path: Path) -> dict[str, NDArray]:
    """All arrays of a .npz file.

    Raises:
        DataFileError: not a .npz file, damaged, or pickled objects inside.
    """
    return {name.removesuffix(".npy"): _array(path, name, raw) for name, raw in _members(path).items()}


def read_recording(folder: str | Path | None, name: str) -> tuple[Path, dict[str, NDArray]]:
    """Path and arrays of a recording in `data_dir`.

    Raises:
        MissingDataError: no folder, or no such file in it.
        DataFileError: as `read_arrays`.
    """
    if folder is None:
        raise MissingDataError(f"Expected the folder of the file {name}, got none; set {_ADVICE}.")
    path = Path(folder) / name
    if not path.is_file():
        raise MissingDataError(f"Expected the file {name} in {folder}, got no such file; set {_ADVICE}.")
    return path, read_arrays(path)


def check_arrays(path: Path, arrays: Mapping[str, NDArray], expected: Mapping[str, tuple[str, int]]) -> None:
    """Checks that arrays are there, of the kind and with the number of axes expected.

    Args:
        path: where they were read, for the message.
        arrays: what was read; more than is expected may be there.
        expected: name -> (allowed dtype kinds, number of axes).

    Raises:
        DataFileError: an expected array is absent or of another kind.
    """
    missing = sorted(set(expected) - set(arrays))
    if missing:
        raise DataFileError(
            f"Expected arrays {missing} in {path}, got only {sorted(arrays)}. Is it the file that is meant?"
        )
    for name, (kinds, num_axes) in expected.items():
        array = arrays[name]
        if array.dtype.kind not in kinds or array.ndim != num_axes:
            raise DataFileError(
                f"Expected array {name!r} in {path} with {num_axes} axes and a dtype of kind {kinds!r}, got shape "
                f"{array.shape} and dtype {array.dtype}. Make the file again."
            )


def check_offsets(name: str, offsets: NDArray, count: int, num_rows: int) -> None:
    """Checks that offsets cut `num_rows` rows into `count` pieces.

    Raises:
        DataFileError: a wrong number of offsets, or offsets that do not rise from 0 to the last row.
    """
    ends = (offsets[:1].tolist(), offsets[-1:].tolist())
    rising = bool((offsets[1:] >= offsets[:-1]).all())
    if len(offsets) != count + 1 or ends != ([0], [num_rows]) or not rising:
        raise DataFileError(
            f"Expected {count + 1} offsets of {name} rising from 0 to its {num_rows} rows, got {len(offsets)} "
            f"from {ends[0]} to {ends[1]}."
        )


def _members(path: Path) -> dict[str, bytes]:
    """Contents by name; a member read as a whole is compared with its check sum before anything parses it."""
    try:
        with zipfile.ZipFile(path) as archive:
            return {name: archive.read(name) for name in archive.namelist()}
    except _DAMAGE as error:
        raise DataFileError(
            f"Expected a complete .npz file at {path}, got one that is damaged, truncated or of another kind "
            f"({error}). Copy or make it again."
        ) from error


def _array(path: Path, name: str, raw: bytes) -> NDArray:
    try:
        return np.lib.format.read_array(io.BytesIO(raw), allow_pickle=False)
    except (ValueError, EOFError, MemoryError) as error:
        hint = "Pickled objects are never loaded." if "allow_pickle" in str(error) else "Make the file again."
        raise DataFileError(f"Expected plain arrays in {path}, got {name!r} that is none ({error}). {hint}") from error


def write_arrays(path: Path, arrays: Mapping[str, NDArray], compressed: bool = False) -> Path:
    """Writes a .npz file whole or not at all: a file of that name stays as it was if writing fails.

    Missing folders are made. The same arrays give the same bytes.

    Raises:
        InputError: the path is a folder, or lies under a file.
    """
    make_folder_of(path)
    with replacing(path) as file:
        (np.savez_compressed if compressed else np.savez)(file, **dict(arrays))  # pyright: ignore[reportArgumentType]  # the stub types allow_pickle alone
    return path

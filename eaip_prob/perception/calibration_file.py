"""Poses and lenses of cameras in a small text file that people can read, and that is written whole or not at all.

JSON with a check sum over its content, so that no damaged number passes for a pose. A file written by hand may leave
the check sum out.
"""

from __future__ import annotations

import json
import zlib
from collections.abc import Mapping
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np

from eaip_prob.data.frames import Intrinsics
from eaip_prob.errors import DataFileError, InputError, MissingDataError
from eaip_prob.files import make_folder_of, write_text
from eaip_prob.perception.extrinsics import Extrinsics

_KIND = "eaip_prob camera extrinsics"
_VERSION = 2  # with the lens of each camera; 1 held poses alone
_FIELDS = {"T_world_camera", "covariance", "residual", "num_boards", "intrinsics"}


def save_extrinsics(path: str | Path, extrinsics: Mapping[str, Extrinsics]) -> Path:
    """Writes the poses of all cameras; a file of that name stays as it was if writing fails.

    Args:
        path: of the file; folders that are missing are made.
        extrinsics: of each camera, by its name.

    Raises:
        InputError: no cameras, or a path that is a folder or lies under a file.

    Example:
        >>> import tempfile
        >>> camera = Intrinsics(1920, 1080, 1060.0, 1060.0, 960.0, 540.0)
        >>> left = Extrinsics(np.eye(4), np.eye(6) * 1e-6, residual=0.1, num_boards=8, intrinsics=camera)
        >>> with tempfile.TemporaryDirectory() as folder:
        ...     path = save_extrinsics(Path(folder) / "kinects.json", {"left": left})
        ...     load_extrinsics(path)["left"].num_boards
        8
    """
    path = Path(path)
    if not extrinsics:
        raise InputError("Expected the extrinsics of at least one camera, got none. Calibrate first.")
    cameras = {name: _as_json(one) for name, one in extrinsics.items()}
    content = {"kind": _KIND, "version": _VERSION, "units": "m, rad, px", "cameras": cameras}
    make_folder_of(path)
    write_text(path, json.dumps(content | {"checksum": _checksum(content)}, indent=1))
    return path


def load_extrinsics(path: str | Path) -> dict[str, Extrinsics]:
    """Poses of cameras from a file of `save_extrinsics`, to the last digit.

    Args:
        path: of the file.

    Raises:
        MissingDataError: no such file.
        DataFileError: damaged, of another kind or version, or with a pose that is none.

    Example:
        >>> load_extrinsics("nowhere.json")
        Traceback (most recent call last):
        ...
        eaip_prob.errors.MissingDataError: Expected a file with camera poses at nowhere.json, got none. Calibrate first.
    """
    path = Path(path)
    if not path.is_file():
        raise MissingDataError(f"Expected a file with camera poses at {path}, got none. Calibrate first.")
    try:
        content = json.loads(path.read_text(encoding="utf-8"))
    except (ValueError, RecursionError) as error:
        raise _damaged(path, f"text that is no JSON ({error})") from error
    if not isinstance(content, dict) or content.get("kind") != _KIND:
        raise _damaged(path, "another kind of file")
    _check_version(path, content.get("version"))
    checksum = content.pop("checksum", None)
    if checksum is not None and checksum != _checksum(content):
        raise _damaged(path, "content that does not fit its check sum (to edit by hand, remove the line `checksum`)")
    cameras = content.get("cameras")
    if not isinstance(cameras, dict) or not cameras:
        raise _damaged(path, "no cameras")
    return {name: _from_json(path, name, one) for name, one in cameras.items()}


def _check_version(path: Path, version: Any) -> None:
    if version == 1:
        raise DataFileError(
            f"Expected version {_VERSION} of a file of camera poses at {path}, got version 1, which lacks the lens "
            "that the poses hold with. Calibrate again."
        )
    if version != _VERSION:
        raise _damaged(path, f"another version, {version!r}")


def _as_json(extrinsics: Extrinsics) -> dict[str, Any]:
    return {
        "T_world_camera": np.asarray(extrinsics.T_world_camera, dtype=float).tolist(),
        "covariance": np.asarray(extrinsics.covariance, dtype=float).tolist(),
        "residual": float(extrinsics.residual),
        "num_boards": int(extrinsics.num_boards),
        "intrinsics": asdict(extrinsics.intrinsics),
    }


def _from_json(path: Path, name: str, fields: Any) -> Extrinsics:
    if not isinstance(fields, dict) or set(fields) != _FIELDS:
        raise _damaged(path, f"camera {name!r} without exactly {sorted(_FIELDS)}")
    try:
        pose, covariance = (np.array(fields[key], dtype=float) for key in ("T_world_camera", "covariance"))
        lens = Intrinsics(**fields["intrinsics"])
        return Extrinsics(pose, covariance, float(fields["residual"]), int(fields["num_boards"]), lens)
    except (TypeError, ValueError, OverflowError) as error:  # InputError is a ValueError
        raise _damaged(path, f"camera {name!r} with {error}") from error


def _checksum(content: Mapping[str, Any]) -> str:
    return f"{zlib.crc32(json.dumps(content, sort_keys=True).encode()):08x}"


def _damaged(path: Path, came: str) -> DataFileError:
    return DataFileError(f"Expected a complete file of camera poses at {path}, got {came}. Save it again.")

"""Files that are written whole or not at all: a reader, or a process that was stopped, never sees half of one."""

from __future__ import annotations

import os
import secrets
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import IO

from eaip_prob.errors import InputError


@contextmanager
def replacing(path: Path) -> Iterator[IO[bytes]]:
    """A file open for writing that takes the place of `path` once the block has ended well, on the disk and complete.

    Args:
        path: of the file, in a folder that is there; what it held stays if the block, or writing, fails.

    Example:
        >>> import tempfile
        >>> with tempfile.TemporaryDirectory() as folder:
        ...     with replacing(Path(folder) / "poses.json") as file:
        ...         _ = file.write(b"{}")
        ...     [place.name for place in Path(folder).iterdir()]
        ['poses.json']
    """
    temporary = path.with_name(f".{path.name}.{secrets.token_hex(4)}.tmp")
    try:
        with temporary.open("xb") as file:
            yield file
            file.flush()
            os.fsync(file.fileno())
        os.replace(temporary, path)
    finally:
        temporary.unlink(missing_ok=True)


def write_text(path: Path, text: str) -> None:
    """Writes a text as UTF-8, whole or not at all.

    Args:
        path: as of `replacing`.
        text: all of it.

    Example:
        >>> import tempfile
        >>> with tempfile.TemporaryDirectory() as folder:
        ...     write_text(Path(folder) / "note.txt", "seen")
        ...     (Path(folder) / "note.txt").read_text()
        'seen'
    """
    with replacing(path) as file:
        file.write(text.encode())


def make_folder_of(path: Path) -> None:
    """Makes the folder that a file will be written to.

    Args:
        path: of the file.

    Raises:
        InputError: the path is a folder, or lies under a file.

    Example:
        >>> import tempfile
        >>> with tempfile.TemporaryDirectory() as folder:
        ...     make_folder_of(Path(folder) / "sweep" / "note.txt")
        ...     (Path(folder) / "sweep").is_dir()
        True
    """
    if path.is_dir() or any(parent.is_file() for parent in path.parents):
        raise InputError(f"Expected the path of a file in a folder, got {path}, a folder or a path under a file.")
    path.parent.mkdir(parents=True, exist_ok=True)

"""Results of the conditions of one run, kept one by one: an interrupted sweep goes on where it stopped.

    parts = [Part("marginal-0.2", configuration), ...]
    results = dict(tqdm(completed(folder, parts, compute), total=len(parts)))

Each result is a small JSON file in the run folder's `parts/`, written in one step, with a fingerprint of all that it
depends on. A file with another fingerprint is refused: nothing is overwritten, and no run mixes configurations.
"""

from __future__ import annotations

import hashlib
import json
import re
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from eaip_prob.errors import DataFileError, InputError
from eaip_prob.files import write_text
from eaip_prob.run_folder import flat_metrics

FOLDER = "parts"


@dataclass(frozen=True)
class Part:
    """One condition of a sweep.

    Args:
        name: of its file: letters, digits, `_`, `.`, `+`, `-`; different for every condition of a run.
        config: everything that the result depends on, seeds of data included, as plain lists, mappings, numbers and
            texts.

    Raises:
        InputError: another kind of name, or a configuration that JSON cannot hold.

    Example:
        >>> Part("marginal-0.2", {"clock": "marginal", "log_sd": 0.2, "seed": 0}).fingerprint[:8]
        'faa5bfb3'
    """

    name: str
    config: Mapping[str, Any]

    def __post_init__(self) -> None:
        if not re.fullmatch(r"\w[\w.+-]*", self.name):
            raise InputError(f"Expected the name of a part from letters, digits, _, ., + and -, got {self.name!r}.")
        _ = self.fingerprint

    @property
    def fingerprint(self) -> str:
        """SHA-256 of the configuration, whatever the order of its keys."""
        try:
            text = json.dumps(self.config, sort_keys=True, allow_nan=False)
        except (TypeError, ValueError) as error:
            raise InputError(
                f"Expected the configuration of part {self.name!r} as plain finite values, got: {error}. "
                "Resolve it with OmegaConf.to_container(cfg, resolve=True)."
            ) from error
        return hashlib.sha256(text.encode()).hexdigest()


def completed(
    folder: Path, parts: Sequence[Part], compute: Callable[[Part], Mapping[str, Any]]
) -> Iterator[tuple[str, dict[str, float]]]:
    """(name, metrics) of every part in order, computed where the run folder does not hold it yet.

    All files that are there are read before anything is computed.

    Args:
        folder: of the run; `parts` is made inside it.
        parts: of different names.
        compute: flat or nested metrics of a part, finite numbers.

    Raises:
        InputError: a name given twice, or a file of another configuration.
        DataFileError: a damaged file.

    Example:
        >>> import tempfile
        >>> parts = [Part(f"square-{number}", {"number": number}) for number in (2, 3)]
        >>> with tempfile.TemporaryDirectory() as run_folder:
        ...     dict(completed(Path(run_folder), parts, lambda part: {"square": part.config["number"] ** 2}))
        {'square-2': {'square': 4.0}, 'square-3': {'square': 9.0}}
    """
    names = [part.name for part in parts]
    if len(set(names)) < len(names):
        twice = sorted({name for name in names if names.count(name) > 1})
        raise InputError(f"Expected parts of different names, got {twice} more than once.")
    place = folder / FOLDER
    place.mkdir(parents=True, exist_ok=True)
    known = {part.name: _read(place, part) for part in parts if _path(place, part).exists()}
    for part in parts:
        if part.name not in known:
            known[part.name] = flat_metrics(compute(part))
            entry = {"fingerprint": part.fingerprint, "config": part.config, "metrics": known[part.name]}
            write_text(_path(place, part), json.dumps(entry, indent=1, sort_keys=True, allow_nan=False) + "\n")
        yield part.name, known[part.name]


def _path(place: Path, part: Part) -> Path:
    return place / f"{part.name}.json"


def _read(place: Path, part: Part) -> dict[str, float]:
    path = _path(place, part)
    try:
        entry = json.loads(path.read_text(encoding="utf-8"))
        fingerprint, metrics = entry["fingerprint"], flat_metrics(entry["metrics"])
    except (ValueError, KeyError, TypeError, AttributeError) as error:
        raise DataFileError(
            f"Expected {FOLDER}/{path.name} as the result of a part, got a damaged file ({error}). Delete it; it is "
            "computed again."
        ) from error
    if fingerprint != part.fingerprint:
        raise InputError(
            f"Expected {FOLDER}/{path.name} to be a result of this configuration, got one of another. Choose another "
            "run_dir, or delete the file; nothing was overwritten."
        )
    return metrics

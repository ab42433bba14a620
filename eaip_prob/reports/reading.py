"""Run folders below a folder, read as they are: finished, still running, failed or damaged.

Nothing here writes, and nothing that one run left behind keeps the others from being read.
"""

from __future__ import annotations

import json
import os
import re
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from eaip_prob.errors import DataFileError, InputError
from eaip_prob.run_folder import CONFIG, ENVIRONMENT, ERROR, METRICS, flat_metrics

REPORT = "report"
FINISHED, UNFINISHED, FAILED, DAMAGED = STATES = ("finished", "unfinished", "failed", "damaged")
UNNAMED = "unnamed"


@dataclass(frozen=True, eq=False)
class Run:
    """What one run folder holds.

    Args:
        name: its path below the folder that was searched.
        state: `finished` (it has metrics), `failed` (it left a sentence instead), `unfinished` (neither: it runs, or
            was stopped) or `damaged` (a file of it cannot be read).
        experiment: that it is a run of; `unnamed` where its folder does not say.
        config: resolved configuration under dotted keys; entries of a list of mappings are numbered.
        overrides: what was typed to get it, without `seed` and what never changes a result.
        metrics: flat; empty unless the run is finished.
        sentence: why it failed, or what is damaged.

    Example:
        >>> Run("seed=1", "finished", config={"seed": 1}, metrics={"rmse": 2.5}).seed
        1
    """

    name: str
    state: str
    experiment: str = UNNAMED
    config: Mapping[str, Any] = field(default_factory=dict)
    overrides: tuple[str, ...] = ()
    metrics: Mapping[str, float] = field(default_factory=dict)
    sentence: str = ""

    @property
    def seed(self) -> Any:
        """Of its random numbers, None for an experiment without one."""
        return self.config.get("seed")

    @property
    def seconds(self) -> float | None:
        """That it took, where it says."""
        return self.metrics.get("seconds/total")


def read_runs(folder: str | Path) -> list[Run]:
    """Every run in a folder and in the folders below it, by name, numbers in their order.

    A run is a folder with a `config.yaml` beside an `environment.json`, a `metrics.json` or an `error.txt`. Hidden
    folders, reports and links to folders are passed by.

    Args:
        folder: of runs; may be a run itself.

    Raises:
        InputError: no such folder, or no run in it.
        DataFileError: no run in it can be read.

    Example:
        >>> import tempfile
        >>> with tempfile.TemporaryDirectory() as folder:
        ...     for name, text in (("config.yaml", "seed: 1"), ("metrics.json", '{"rmse": 2.5}')):
        ...         _ = (Path(folder) / name).write_text(text)
        ...     [(run.state, run.seed) for run in read_runs(folder)]
        [('finished', 1)]
    """
    root = Path(folder)
    if not root.is_dir():
        raise InputError(f"Expected runs as a folder of runs, got {str(folder)!r}, which is none. Mend its name.")
    read = (_read(path, str(path.relative_to(root)) if path != root else root.resolve().name) for path in _found(root))
    runs = sorted((run for run in read if run.experiment != REPORT), key=lambda run: natural(run.name))
    if not runs:
        raise InputError(
            f"Expected runs as a folder of runs, got {str(folder)!r}, which holds none: no {CONFIG} beside an "
            f"{ENVIRONMENT} or a {METRICS} in it or below. Name the folder of a sweep, such as runs/passing_over/sweep."
        )
    if all(run.state == DAMAGED for run in runs):
        raise DataFileError(
            f"Expected at least one run that can be read in {str(folder)!r}, got {len(runs)} damaged; {runs[0].name}: "
            f"{runs[0].sentence} Delete what is damaged and repeat these runs."
        )
    return runs


def natural(text: str) -> list[tuple[int, float, str]]:
    """A key that sorts numbers inside texts by their size: `rmse/5` before `rmse/10`.

    Example:
        >>> sorted(["seed=10", "seed=9", "seed=-1"], key=natural)
        ['seed=-1', 'seed=9', 'seed=10']
    """
    pieces = re.split(r"((?:(?<=[=/])-)?\d+(?:\.\d+)?)", text)
    return [(0, float(piece), "") if number % 2 else (1, 0.0, piece) for number, piece in enumerate(pieces)]


def _found(root: Path) -> Iterator[Path]:
    for place, folders, files in os.walk(root):
        folders[:] = [name for name in folders if not name.startswith(".") and name != REPORT]
        if CONFIG in files and {ENVIRONMENT, METRICS, ERROR} & set(files) or {METRICS, ENVIRONMENT} <= set(files):
            yield Path(place)


def _read(path: Path, name: str) -> Run:
    known: dict[str, Any] = {}
    try:
        environment = _mapping(path / ENVIRONMENT, json.loads) if (path / ENVIRONMENT).exists() else {}
        known["experiment"] = str(environment.get("experiment", UNNAMED))
        known["overrides"] = tuple(text for text in environment.get("overrides", ()) if counts(_key(text)))
        known["config"] = dict(_flat(_mapping(path / CONFIG, _yaml)))
        finished = (path / METRICS).exists()
        metrics = flat_metrics(_mapping(path / METRICS, json.loads)) if finished else {}
    except (TypeError, ValueError) as error:
        return Run(name, DAMAGED, sentence=str(error), **known)
    if finished:
        return Run(name, FINISHED, metrics=metrics, **known)
    if (path / ERROR).exists():
        return Run(name, FAILED, sentence=_last_line(path / ERROR), **known)
    return Run(name, UNFINISHED, **known)


def counts(key: str) -> bool:
    """Whether a key of the configuration tells settings apart: `seed`, and what changes no result, does not.

    Example:
        >>> [key for key in ("model", "seed", "recording._target_") if counts(key)]
        ['model']
    """
    return re.split(r"[.@]", key)[0] not in ("seed", "run_dir", "threads", "recording", "hydra")


def _key(override: str) -> str:
    return override.lstrip("+~").split("=")[0]


def _mapping(path: Path, parse: Callable[[str], Any]) -> dict[str, Any]:
    try:
        value = parse(path.read_text(encoding="utf-8"))
    except OSError as error:
        raise ValueError(f"{path.name}: {error.strerror}.") from error
    except ValueError as error:
        raise ValueError(f"{path.name}: {' '.join(str(error).split())}.") from error
    if not isinstance(value, dict):
        raise ValueError(f"{path.name}: expected a mapping, got {type(value).__name__}.")
    return value


def _yaml(text: str) -> Any:
    import yaml

    try:
        # In C where it is there: ten times as fast, which a sweep of hundreds of runs makes felt.
        return yaml.load(text, getattr(yaml, "CSafeLoader", yaml.SafeLoader))
    except yaml.YAMLError as error:
        raise ValueError(error) from error


def _flat(value: Any, prefix: str = "") -> Iterator[tuple[str, Any]]:
    if isinstance(value, list) and any(isinstance(entry, dict) for entry in value):
        value = dict(enumerate(value))
    if not isinstance(value, dict) or not value:
        yield prefix, value
        return
    for key, entry in value.items():
        yield from _flat(entry, f"{prefix}.{key}" if prefix else str(key))


def _last_line(path: Path) -> str:
    lines = path.read_text(encoding="utf-8", errors="replace").strip().splitlines()
    return lines[-1].strip() if lines else "It left no sentence."

"""The folder of one run: what it holds, when it may be written to, and how a reader tells what became of the run.

    config.yaml        the resolved configuration; there from the start
    environment.json   experiment, overrides, seed, versions, revision, kind of machine; there from the start
    metrics.json       numbers under flat keys; written last, so that a folder with metrics is a finished run
    error.txt          why the run did not finish; its last line is the message

A finished run is never written to again. Every file is written in one step.
"""

from __future__ import annotations

import contextlib
import json
import traceback
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from eaip_prob.errors import EaipError, InputError
from eaip_prob.files import write_text

METRICS, CONFIG, ENVIRONMENT, ERROR = "metrics.json", "config.yaml", "environment.json", "error.txt"


@dataclass(frozen=True)
class RunFolder:
    """A run's folder, made when it is first written to.

    Args:
        path: the folder.

    Example:
        >>> import tempfile
        >>> with tempfile.TemporaryDirectory() as path:
        ...     folder = RunFolder(Path(path) / "seed=1")
        ...     folder.start("seed: 1", {"seed": 1})
        ...     folder.finish({"rmse": 2.5})
        ...     folder.is_finished("seed: 1")
        True
    """

    path: Path

    def is_finished(self, config: str) -> bool:
        """Whether a run of this configuration has finished here.

        Raises:
            InputError: what lies here is of another configuration, and more than the sentence of a refusal.
        """
        stored = self.path / CONFIG
        finished = (self.path / METRICS).exists()
        if not finished and (not stored.exists() or self._holds_no_result()):
            return False
        if not stored.exists() or stored.read_text(encoding="utf-8") != config:
            raise InputError(
                f"Expected run folder {self.path.name!r} to be empty or of the same configuration, got one of another "
                f"configuration (its {CONFIG} differs). Choose another run_dir; nothing was overwritten."
            )
        return finished

    def start(self, config: str, environment: Mapping[str, Any]) -> None:
        """Writes down what is going to run; removes what an earlier attempt says of its failure."""
        self.path.mkdir(parents=True, exist_ok=True)
        (self.path / ERROR).unlink(missing_ok=True)
        write_text(self.path / CONFIG, config)
        write_text(self.path / ENVIRONMENT, json.dumps(environment, indent=2, sort_keys=True) + "\n")

    def finish(self, metrics: Mapping[str, float]) -> None:
        """Writes the metrics, which makes the run a finished one."""
        write_text(self.path / METRICS, json.dumps(metrics, indent=2, sort_keys=True, allow_nan=False) + "\n")

    def fail(self, error: BaseException) -> None:
        """Writes why the run did not finish: one sentence for what was refused, else the traceback."""
        lines = [f"{error}\n"] if isinstance(error, EaipError) else traceback.format_exception(error)
        try:
            write_text(self.path / ERROR, "".join(lines))
        except OSError:  # where the disk is full the error itself says so
            return

    def discard(self) -> None:
        """Removes what says that a run was begun, and the folder and the one around it where nothing else is there."""
        for name in (CONFIG, ENVIRONMENT, ERROR):
            (self.path / name).unlink(missing_ok=True)
        for folder in (self.path, self.path.parent):
            with contextlib.suppress(OSError):
                folder.rmdir()

    def _holds_no_result(self) -> bool:
        return {path.name for path in self.path.iterdir()} <= {CONFIG, ENVIRONMENT, ERROR} and (
            self.path / ERROR
        ).exists()


def flat_metrics(metrics: Mapping[str, Any], prefix: str = "") -> dict[str, float]:
    """Nested metrics as one sorted level, keys joined by "/".

    Raises:
        InputError: a value is not one finite number, or two values end under one key.

    Example:
        >>> flat_metrics({"eaip": {"rmse": 1, "nll": 0.5}})
        {'eaip/nll': 0.5, 'eaip/rmse': 1.0}
    """
    pairs: list[tuple[str, float]] = []
    for key, value in metrics.items():
        name = f"{prefix}{key}"
        if isinstance(value, Mapping):
            pairs += flat_metrics(value, f"{name}/").items()
        else:
            pairs.append((name, _number(name, value)))
    flat = dict(sorted(pairs))
    if len(flat) < len(pairs):
        raise InputError(f"Expected different metrics keys, got one twice among {sorted(key for key, _ in pairs)}.")
    return flat


def _number(name: str, value: Any) -> float:
    try:
        number = float("nan") if isinstance(value, str) else float(value)
    except (TypeError, ValueError, RuntimeError):  # RuntimeError: a tensor with several entries
        number = float("nan")
    if number in (float("inf"), float("-inf")) or number != number:
        raise InputError(
            f"Expected one finite number as metric {name!r}, got {value!r}. Leave the key out where it has no value."
        )
    return number

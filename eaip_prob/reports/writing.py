"""The files of a report, each written in one step: it can be repeated while the sweep runs, and read meanwhile.

- `report.csv`, `report.parquet`: a row for each setting and metric, with the columns experiment, one for each choice,
  metric, mean, low, high, num_seeds, difference, difference_low, difference_high and num_pairs;
- `runs.csv`: a row for each run, with experiment, run, state, seed, choices, seconds and sentence.
"""

from __future__ import annotations

import io
from collections.abc import Callable, Iterable, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from eaip_prob.files import replacing
from eaip_prob.reports.reading import Run
from eaip_prob.reports.statistics import Row, Section, SeedInterval

if TYPE_CHECKING:
    import pyarrow

_NUMBERS = ("mean", "low", "high", "difference", "difference_low", "difference_high", "seconds")
_COUNTS = ("num_seeds", "num_pairs")
_TEXTS = ("experiment", "metric", "run", "state", "sentence")


def statistics_table(sections: Sequence[Section]) -> pyarrow.Table:
    """The tidy table: a row for each experiment, setting and metric; what is absent is null.

    The column of a choice holds numbers where all of its values are numbers, else texts as they were typed.

    Args:
        sections: of `sections`, one for each experiment.

    Example:
        >>> from eaip_prob.reports.statistics import section
        >>> run = Run("a", "finished", config={"seed": 0}, metrics={"rmse": 2.5})
        >>> statistics_table([section("passing_over", [run])]).to_pylist()[0]["mean"]
        2.5
    """
    keys = _choice_keys(sections)
    rows = [_statistics(section.experiment, row, keys) for section in sections for row in section.rows]
    interval = ["mean", "low", "high", "num_seeds", "difference", "difference_low", "difference_high", "num_pairs"]
    return _table(rows, ["experiment", *keys.values(), "metric", *interval])


def runs_table(runs: Sequence[Run], sections: Sequence[Section]) -> pyarrow.Table:
    """A row for each run that was found, whatever its state.

    Args:
        runs: of `read_runs`.
        sections: of `sections`, for the choices of each run.

    Example:
        >>> runs_table([Run("seed=1", "failed", sentence="Expected a cube, got a ball.")], []).to_pylist()[0]["state"]
        'failed'
    """
    keys = _choice_keys(sections)
    of_run = {name: dict(setting.choices) for section in sections for name, setting in section.settings.items()}
    repeats = {name: text for section in sections for name, text in section.repeats.items()}
    rows = [
        {
            "experiment": run.experiment,
            "run": run.name,
            "state": run.state,
            "seed": None if run.seed is None else str(run.seed),
            **{column: of_run.get(run.name, {}).get(key) for key, column in keys.items()},
            "seconds": run.seconds,
            "sentence": run.sentence or repeats.get(run.name),
        }
        for run in runs
    ]
    return _table(rows, ["experiment", "run", "state", "seed", *keys.values(), "seconds", "sentence"])


def write_csv(table: pyarrow.Table, path: Path) -> None:
    """Writes a table as CSV; null is an empty cell.

    Args:
        table: any.
        path: of the file, replaced in one step.

    Example:
        >>> import tempfile, pyarrow
        >>> with tempfile.TemporaryDirectory() as folder:
        ...     write_csv(pyarrow.table({"rmse": [2.5, None]}), Path(folder) / "report.csv")
        ...     (Path(folder) / "report.csv").read_text().split()
        ['"rmse"', '2.5']
    """
    from pyarrow import csv

    _written(path, lambda sink: csv.write_csv(table, sink))


def write_parquet(table: pyarrow.Table, path: Path) -> None:
    """Writes a table as Parquet.

    Args:
        table: any.
        path: of the file, replaced in one step.

    Example:
        >>> import tempfile, pyarrow.parquet
        >>> with tempfile.TemporaryDirectory() as folder:
        ...     write_parquet(pyarrow.table({"rmse": [2.5, None]}), Path(folder) / "report.parquet")
        ...     pyarrow.parquet.read_table(Path(folder) / "report.parquet").to_pylist()
        [{'rmse': 2.5}, {'rmse': None}]
    """
    from pyarrow import parquet

    _written(path, lambda sink: parquet.write_table(table, sink))


def _choice_keys(sections: Sequence[Section]) -> dict[str, str]:
    """The column of each key that tells settings apart."""
    choices = [choice for section in sections for setting in section.settings.values() for choice in setting.choices]
    taken = {*_NUMBERS, *_COUNTS, *_TEXTS, "seed"}
    return {key: f"config.{key}" if key in taken else key for key in sorted({key for key, _ in choices})}


def _statistics(experiment: str, row: Row, keys: Mapping[str, str]) -> dict[str, Any]:
    choices = dict(row.setting.choices)
    return {
        "experiment": experiment,
        **{column: choices.get(key) for key, column in keys.items()},
        "metric": row.metric,
        **_interval(row.value, ("mean", "low", "high", "num_seeds")),
        **_interval(row.difference, ("difference", "difference_low", "difference_high", "num_pairs")),
    }


def _interval(value: SeedInterval | None, names: Sequence[str]) -> dict[str, float | int | None]:
    parts = (None,) * 4 if value is None else (value.mean, value.low, value.high, value.num_seeds)
    return dict(zip(names, parts, strict=True))


def _table(rows: Sequence[Mapping[str, Any]], names: Sequence[str]) -> pyarrow.Table:
    import pyarrow

    columns = {name: [row[name] for row in rows] for name in names}
    return pyarrow.table({name: pyarrow.array(*_typed(name, column)) for name, column in columns.items()})


def _typed(name: str, column: Iterable[Any]) -> tuple[list[Any], str]:
    """The values with their Arrow type; choices are typed by what they look like."""
    values = list(column)
    if name in _NUMBERS or name in _COUNTS:
        return values, "float64" if name in _NUMBERS else "int64"
    if name not in _TEXTS:
        for kind, arrow in ((int, "int64"), (float, "float64")):
            try:
                numbers = [None if value is None else kind(value) for value in values]
            except ValueError:
                continue
            if any(abs(number) >= 2**63 for number in numbers if number is not None):
                continue
            return numbers, arrow if any(value is not None for value in values) else "string"
    return values, "string"


def _written(path: Path, write: Callable[[io.BytesIO], object]) -> None:
    sink = io.BytesIO()
    write(sink)
    with replacing(path) as file:
        file.write(sink.getvalue())

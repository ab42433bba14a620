"""The page of a report, in Markdown: what was found, the table of each experiment, and its figures."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence

from eaip_prob.reports.reading import DAMAGED, FAILED, FINISHED, STATES, UNFINISHED, Run
from eaip_prob.reports.selecting import selected, shown
from eaip_prob.reports.settings import Setting
from eaip_prob.reports.statistics import Row, Section, unique
from eaip_prob.tables import text_table

MOST_METRICS = 60
MOST_FIGURES = 12  # of an experiment
MOST_SETTINGS = 18  # of a figure: as many as the house style can tell apart
_MOST_NAMED = 20
_WITHOUT_METRICS = "no metrics so far; it runs still, or was stopped."
_COLUMNS = 6


def chosen_metrics(section: Section, patterns: Sequence[str]) -> list[str]:
    """The metrics that the page shows: those of the patterns, all where none matches, and of many the first.

    Example:
        >>> from eaip_prob.reports.statistics import section
        >>> run = Run("a", "finished", config={"seed": 0}, metrics={"rmse/eaip/5": 2.5, "rmse/ip/5": 3.0})
        >>> chosen_metrics(section("few_demonstrations", [run]), ["*/eaip/*"])
        ['rmse/eaip/5']
    """
    metrics = {row.metric for row in section.rows}
    return (selected(metrics, patterns) or selected(metrics, ["*"]))[:MOST_METRICS]


def summary(runs: Sequence[Run], sections: Sequence[Section]) -> str:
    """How many runs are in which state, and what is said of those that count for nothing.

    Args:
        runs: of `read_runs`.
        sections: of `sections`, for the runs that were repeated.

    Example:
        >>> print(summary([Run("seed=1", "failed", sentence="Expected a cube, got a ball.")], []))
        1 run: 1 failed.
        <BLANKLINE>
        - `seed=1` failed: Expected a cube, got a ball.
    """
    of_state = {state: [run for run in runs if run.state == state] for state in STATES}
    counts = ", ".join(f"{len(found)} {state}" for state, found in of_state.items() if found)
    lines = []
    for state in (FAILED, DAMAGED, UNFINISHED):
        named = [f"- `{run.name}` {state}: {run.sentence or _WITHOUT_METRICS}" for run in of_state[state]]
        lines += _cut(named, f"more {state}")
    repeats = [f"- `{name}`: {text}" for section in sections for name, text in section.repeats.items()]
    lines += _cut(repeats, "more repeated")
    return "\n\n".join(filter(None, [f"{_plural(len(runs), 'run')}: {counts}.", "\n".join(lines)]))


def tables(section: Section, runs: Sequence[Run], patterns: Sequence[str]) -> str:
    """What is known of one experiment: its settings, the means of chosen metrics, and their differences.

    Args:
        section: its statistics.
        runs: all that were found.
        patterns: of the metrics to show.

    Example:
        >>> from eaip_prob.reports.statistics import section
        >>> runs = [Run(str(n), "finished", config={"seed": n}, metrics={"rmse": 2.0 + n}) for n in range(2)]
        >>> print(tables(section("handover", runs), runs, ["rmse"]).splitlines()[-3])
        | rmse   | 2.5 [-3.853, 8.853] |
    """
    if not section.rows:
        return f"{_settings_table(section, runs)}\n\nNo run has finished with metrics."
    metrics = chosen_metrics(section, patterns)
    parts = [_settings_table(section, runs), _explained(section)]
    parts += _tables(section, metrics, lambda row: shown(row.value))
    if section.baseline is not None and any(row.difference for row in section.rows):
        parts += [_difference_explained(section.baseline)]
        parts += _tables(section, metrics, lambda row: _bold(row), leave_out=section.baseline)
    return "\n\n".join([*parts, _rest(section, metrics, patterns)])


def page(
    title: str,
    runs: Sequence[Run],
    sections: Sequence[Section],
    patterns: Sequence[str],
    figures: Mapping[str, Sequence[str]],
) -> str:
    """The whole page.

    Args:
        title: name of the folder.
        runs: all that were found.
        sections: one for each experiment.
        patterns: of the metrics to show.
        figures: names of the figures of each experiment.

    Example:
        >>> print(page("handover/sweep", [Run("seed=1", "unfinished")], [], ["*"], {}).splitlines()[2])
        1 run: 1 unfinished.
    """
    parts = [f"# Report on {title}", summary(runs, sections)]
    for section in sections:
        parts += [f"## {section.experiment}", tables(section, runs, patterns)]
        parts += _pictures(section, figures.get(section.experiment, ()))
    return "\n\n".join(parts) + "\n"


def _pictures(section: Section, names: Sequence[str]) -> list[str]:
    left_out = []
    if names and len(section.counted) > MOST_SETTINGS:
        left_out.append(f"The figures show the first {MOST_SETTINGS} of {len(section.counted)} settings.")
    if len(names) == MOST_FIGURES:
        left_out.append(f"No more than {MOST_FIGURES} figures are drawn; metrics=[...] chooses.")
    return [*left_out, *(f"![{name}](figures/{name}.png)" for name in names)]


def _settings_table(section: Section, runs: Sequence[Run]) -> str:
    states = {run.name: run.state for run in runs}
    rows = []
    for setting in unique(section.settings):
        own = [states[name] for name, other in section.settings.items() if other == setting]
        seeds = ", ".join(section.counted.get(setting, {}))
        counts = {state: own.count(state) for state in STATES if state == FINISHED or state in states.values()}
        rows.append({"setting": setting.label, "seeds": seeds, **counts})
    return text_table(rows)


def _explained(section: Section) -> str:
    fewest = min(len(seeds) for seeds in section.counted.values())
    text = "Means over seeds; in brackets the 95 % Student-t interval over seeds."
    return text if fewest > 1 else f"{text} One seed has no interval."


def _difference_explained(baseline: Setting) -> str:
    return (
        f"Differences to `{baseline.label}` over the seeds that both have, paired by seed; bold where the interval "
        "leaves out zero."
    )


def _tables(
    section: Section, metrics: Sequence[str], cell: Callable[[Row], str], leave_out: Setting | None = None
) -> list[str]:
    """Tables with a row for each metric, side by side no more settings than can be read."""
    rows = {(row.setting, row.metric): row for row in section.rows}
    settings = [setting for setting in section.counted if setting != leave_out]
    groups = [settings[start : start + _COLUMNS] for start in range(0, len(settings), _COLUMNS)]
    return [
        text_table(
            [
                {"metric": metric}
                | {each.label: cell(rows[each, metric]) if (each, metric) in rows else "" for each in group}
                for metric in metrics
            ]
        )
        for group in groups
    ]


def _bold(row: Row) -> str:
    value = row.difference
    clear = value is not None and value.low is not None and value.high is not None and not value.low <= 0 <= value.high
    return f"**{shown(value)}**" if clear else shown(value)


def _rest(section: Section, metrics: Sequence[str], patterns: Sequence[str]) -> str:
    known = {row.metric for row in section.rows}
    matched = len(selected(known, patterns))
    asked = f"{len(metrics)} of {_plural(len(known), 'metric')} shown"
    if not matched:
        asked += f", as metrics={list(patterns)} match none"
    elif matched > len(metrics):
        asked += f" ({matched} were asked for)"
    return f"{asked}; report.csv and report.parquet hold all, and metrics=['*'] shows the first {MOST_METRICS}."


def _cut(lines: list[str], what: str) -> list[str]:
    more = len(lines) - _MOST_NAMED
    return lines if more <= 0 else [*lines[:_MOST_NAMED], f"- {more} {what}: see runs.csv"]


def _plural(count: int, noun: str) -> str:
    return f"{count} {noun}" + ("" if count == 1 else "s")

"""Means over seeds with their intervals, and paired differences to a baseline setting.

With n seeds, mean m and standard deviation s (over n - 1), the 95 % interval is m +- t(n - 1) s / sqrt(n), t the
Student quantile: it holds the mean over all seeds in 95 % of such sweeps where a metric is normal over seeds. One seed
says nothing about others and has no interval.
"""

from __future__ import annotations

import functools
import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass

from eaip_prob.errors import InputError
from eaip_prob.reports.reading import FINISHED, Run, natural
from eaip_prob.reports.settings import Setting, check_choice, setting_of, settings

LEVEL = 0.95
_SAME = 1e-9


@dataclass(frozen=True)
class SeedInterval:
    """A mean over seeds.

    Args:
        mean: in the metric's unit.
        low: lower end of the 95 % interval; None with one seed.
        high: upper end.
        num_seeds: that were averaged.

    Example:
        >>> SeedInterval(2.0, None, None, 1).num_seeds
        1
    """

    mean: float
    low: float | None
    high: float | None
    num_seeds: int


@dataclass(frozen=True)
class Row:
    """One metric under one setting.

    Args:
        setting: the choices.
        metric: its flat key.
        value: over the setting's seeds.
        difference: setting minus baseline, over the seeds that both have; None for the baseline itself, and where they
            share no seed.

    Example:
        >>> Row(Setting((("model", "kernel"),)), "rmse/eaip/10", SeedInterval(2.0, 1.5, 2.5, 3), None).setting.label
        'model=kernel'
    """

    setting: Setting
    metric: str
    value: SeedInterval
    difference: SeedInterval | None


@dataclass(frozen=True, eq=False)
class Section:
    """What a report says of one experiment.

    Args:
        experiment: its name.
        settings: the setting of each run whose configuration can be read, by the runs' names.
        counted: the run that counts for each setting and seed.
        repeats: what is said of the finished runs that do not count, by their names.
        baseline: that differences are to; None while no run has finished.
        rows: by setting, then by metric in natural order.

    Example:
        >>> section("handover", [Run("a", "finished", config={"seed": 0}, metrics={"rmse": 0.5})]).baseline.label
        'all runs'
    """

    experiment: str
    settings: Mapping[str, Setting]
    counted: Mapping[Setting, Mapping[str, Run]]
    repeats: Mapping[str, str]
    baseline: Setting | None
    rows: Sequence[Row]


def seed_interval(values: Sequence[float]) -> SeedInterval:
    """Mean of one number a seed, with its 95 % Student-t interval.

    Args:
        values: at least one, finite.

    Raises:
        InputError: no value.

    Example:
        >>> result = seed_interval([1.0, 2.0, 3.0])
        >>> result.mean, round(result.low, 3), round(result.high, 3), result.num_seeds
        (2.0, -0.484, 4.484, 3)
    """
    count = len(values)
    if count == 0:
        raise InputError("Expected the value of at least one seed, got none. Leave the metric out.")
    mean = math.fsum(value / count for value in values)
    if count == 1:
        return SeedInterval(mean, None, None, 1)
    # hypot, because squares of large scores overflow.
    deviation = math.hypot(*(value - mean for value in values)) / math.sqrt(count - 1)
    reach = _quantile(count - 1) * deviation / math.sqrt(count)
    return SeedInterval(mean, mean - reach, mean + reach, count)


@functools.cache
def _quantile(degrees: int) -> float:
    from scipy.special import stdtrit

    return float(stdtrit(degrees, 0.5 + 0.5 * LEVEL))


def section(experiment: str, runs: Sequence[Run], baseline: str | None = None) -> Section:
    """The statistics of one experiment's runs.

    Args:
        experiment: its name.
        runs: of it, in any state.
        baseline: label of a setting; where none of this experiment has it, the first with a finished run stands in.

    Example:
        >>> runs = [
        ...     Run(f"{m}{s}", "finished", config={"model": m, "seed": s}, metrics={"rmse": s + (m == "b")})
        ...     for m in "ab" for s in (0, 1)
        ... ]
        >>> [(row.setting.label, row.value.mean, row.difference and row.difference.mean)
        ...  for row in section("passing_over", runs).rows]
        [('model=a', 0.5, None), ('model=b', 1.5, 1.0)]
    """
    known = settings([run for run in runs if run.config])
    by_name = {run.name: run for run in runs}
    counted: dict[Setting, dict[str, Run]] = {}
    repeats: dict[str, str] = {}
    for name, setting in known.items():
        run = by_name[name]
        if run.state == FINISHED:
            earlier = counted.setdefault(setting, {}).get(str(run.seed))
            counted[setting][str(run.seed)] = run
            if earlier is not None:
                repeats[earlier.name] = _repeated(earlier, run)
    chosen = (setting_of(baseline, unique(known)) if baseline else None) or next(iter(counted), None)
    rows = tuple(row for setting in counted for row in _rows(setting, counted, chosen))
    return Section(experiment, known, counted, repeats, chosen, rows)


def sections(runs: Sequence[Run], baseline: str | None = None) -> list[Section]:
    """The statistics of every experiment that has a run whose configuration can be read, by its name.

    Args:
        runs: of any experiments, in any state.
        baseline: label of a setting of at least one of them; default the first of each.

    Raises:
        InputError: no experiment has a setting that the label names, or several settings answer to it.

    Example:
        >>> runs = [Run("a", "finished", "timing", {"seed": 0}), Run("b", "finished", "handover", {"seed": 0})]
        >>> [section.experiment for section in sections(runs)]
        ['handover', 'timing']
    """
    names = sorted({run.experiment for run in runs if run.config})
    made = [section(name, [run for run in runs if run.experiment == name], baseline) for name in names]
    known = [unique(each.settings) for each in made]
    if baseline is not None and not any(setting_of(baseline, each) for each in known):
        check_choice(baseline, [setting for each in known for setting in each])
    return made


def unique(settings: Mapping[str, Setting]) -> list[Setting]:
    """Each setting of some runs once, in order."""
    return list(dict.fromkeys(settings.values()))


def _rows(setting: Setting, counted: Mapping[Setting, Mapping[str, Run]], baseline: Setting | None) -> Iterable[Row]:
    own = counted[setting]
    other = {} if baseline is None or baseline == setting else counted.get(baseline, {})
    for metric in sorted({metric for run in own.values() for metric in run.metrics}, key=natural):
        values = {seed: run.metrics[metric] for seed, run in own.items() if metric in run.metrics}
        paired = [
            value - other[seed].metrics[metric]
            for seed, value in values.items()
            if seed in other and metric in other[seed].metrics
        ]
        yield Row(setting, metric, seed_interval(list(values.values())), seed_interval(paired) if paired else None)


def _repeated(earlier: Run, later: Run) -> str:
    differing = [
        key
        for key in earlier.metrics.keys() | later.metrics.keys()
        if not key.startswith("seconds/")
        and not math.isclose(earlier.metrics.get(key, math.nan), later.metrics.get(key, math.nan), rel_tol=_SAME)
    ]
    numbers = f"{len(differing)} metrics of which differ" if differing else "with the same numbers"
    return f"The same configuration and seed as {later.name}, {numbers}; only that one counts."

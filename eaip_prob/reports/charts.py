"""The figures of a report: lines over the number that ends a metric's key, else a dot and its interval.

`rmse/both/eaip/10` and `rmse/both/eaip/50` are two places of one line in the figure `rmse_both_eaip`; `decodable/width`
and `decodable/height`, two rows of the figure `decodable`. Every setting has a line or a dot of its own.
"""

from __future__ import annotations

import re
import textwrap
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from eaip_prob.figures import (
    method_styles,
    new_figure,
    outside_legend,
    save_figure,
    score_label,
    score_lines,
    signed_log,
)
from eaip_prob.reports.page import MOST_FIGURES, MOST_SETTINGS, chosen_metrics
from eaip_prob.reports.settings import Setting
from eaip_prob.reports.statistics import Section, SeedInterval

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

_SCORES = ("coverage90", "dtw", "nll", "rmse", "seconds", "success")
_SHARES = ("coverage90", "success")
_MUCH = 15.0  # nats per sample, so over-confident that a linear axis would hide all others
_MOST_BANDS = 4
_WIDEST = 44  # letters of a label in one line
_LETTER = 0.065  # inches

Values = Mapping[str, Mapping[str, SeedInterval]]


@dataclass(frozen=True)
class Axis:
    """What the metrics of an experiment are drawn over.

    Args:
        x: what the number at the end of a key is, with its unit.
        unit: of errors; empty where it is not known.

    Example:
        >>> Axis("samples seen", "px").unit
        'px'
    """

    x: str = ""
    unit: str = ""


@dataclass(frozen=True, eq=False)
class Chart:
    """Metrics that agree in all but the last part of their key.

    Args:
        prefix: what they agree in.
        values: {last part of the key: {label of the setting: value}}.
    """

    prefix: str
    values: Values

    @property
    def is_line(self) -> bool:
        """Whether there are at least two numbers to draw over."""
        return len(self.values) > 1 and all(_is_number(place) for place in self.values)


def charts(section: Section, metrics: Sequence[str]) -> list[Chart]:
    """The figures that some metrics give, in their order: numbers and words at the end of a key are apart.

    Example:
        >>> from eaip_prob.reports.reading import Run
        >>> from eaip_prob.reports.statistics import section
        >>> run = Run("a", "finished", config={"seed": 0}, metrics={"rmse/eaip/5": 2.5, "rmse/eaip/10": 3.0})
        >>> made = charts(section("timing", [run]), ["rmse/eaip/5", "rmse/eaip/10"])
        >>> [(chart.prefix, chart.is_line) for chart in made]
        [('rmse/eaip', True)]
    """
    settings = list(section.counted)[:MOST_SETTINGS]
    rows = {(row.metric, row.setting): row.value for row in section.rows}
    grouped: dict[tuple[str, bool], dict[str, dict[str, SeedInterval]]] = {}
    for metric in metrics:
        prefix, _, last = metric.rpartition("/")
        own = {_wrapped(each): rows[metric, each] for each in settings if (metric, each) in rows}
        grouped.setdefault((prefix, _is_number(last)), {})[last] = own
    return [Chart(prefix, values) for (prefix, _), values in grouped.items()]


def draw(
    folder: Path, sections: Sequence[Section], patterns: Sequence[str], axes: Mapping[str, Axis]
) -> dict[str, list[str]]:
    """Draws the metrics that the page shows into a folder's `figures`; returns the figures' names by experiment.

    Args:
        folder: of the report; figures that its page names, and that are not drawn again, are removed.
        sections: one for each experiment, of which the first charts are drawn.
        patterns: of the metrics.
        axes: by experiment; one that is absent has no unit.

    Example:
        >>> import tempfile
        >>> from eaip_prob.reports.reading import Run
        >>> from eaip_prob.reports.statistics import sections
        >>> run = Run("a", "finished", "handover", {"seed": 0}, metrics={"rmse/eaip/20": 0.2, "rmse/eaip/50": 0.1})
        >>> with tempfile.TemporaryDirectory() as folder:
        ...     draw(Path(folder), sections([run]), ["rmse/*"], {"handover": Axis("seen (%)", "m")})
        {'handover': ['rmse_eaip']}
    """
    names: dict[str, list[str]] = {}
    drawn: list[str] = []
    for section in sections:
        prefix = f"{section.experiment}_" if len(sections) > 1 else ""
        own = charts(section, chosen_metrics(section, patterns))[:MOST_FIGURES]
        for chart in own:
            name = _file_name(f"{prefix}{chart.prefix}", drawn)
            save_figure(_figure(chart, axes.get(section.experiment, Axis())), folder, name)
            drawn.append(name)
        names[section.experiment] = drawn[len(drawn) - len(own) :]
    _remove_earlier(folder, drawn)
    return names


def _file_name(text: str, taken: Sequence[str]) -> str:
    name = re.sub(r"[^\w-]+", "_", text) or "metrics"
    return f"{name}_{len(taken)}" if name in taken else name


def _remove_earlier(folder: Path, drawn: Sequence[str]) -> None:
    page = folder / "report.md"
    earlier = page.read_text(encoding="utf-8") if page.exists() else ""
    for name in set(re.findall(r"\(figures/([\w-]+)\.png\)", earlier)) - set(drawn):
        (folder / "figures" / f"{name}.png").unlink(missing_ok=True)


def _figure(chart: Chart, axis: Axis) -> Figure:
    figure = _lines(chart, axis) if chart.is_line else _dots(chart, axis)
    _widen(figure, [label for row in chart.values.values() for label in row])
    return figure


def _lines(chart: Chart, axis: Axis) -> Figure:
    lines: dict[str, dict[float, float]] = {}
    bands: dict[str, dict[float, tuple[float, float]]] = {}
    for place, row in chart.values.items():
        for label, value in row.items():
            lines.setdefault(label, {})[float(place)] = value.mean
            if value.low is not None and value.high is not None:
                bands.setdefault(label, {})[float(place)] = (value.low, value.high)
    title = _title(chart)
    few = len(lines) <= _MOST_BANDS
    figure = score_lines({title: lines}, axis.x, _label(chart, axis), bands={title: bands if few else {}})
    if not few:
        _bars(figure.axes[0], bands, list(lines))
    _scale(figure.axes[0], _score(chart), [value for line in lines.values() for value in line.values()])
    return figure


def _bars(ax: Axes, bands: Mapping[str, Mapping[float, tuple[float, float]]], labels: Sequence[str]) -> None:
    """Intervals side by side, where so many bands would hide one another."""
    left, right = ax.get_xlim()
    styles = method_styles(labels)
    for rank, label in enumerate(labels):
        shift = (rank - (len(labels) - 1) / 2) * (right - left) / 200
        for x, (low, high) in bands.get(label, {}).items():
            ax.vlines(x + shift, low, high, color=styles[label].color, linestyle=styles[label].line, linewidth=1)


def _scale(ax: Axes, score: str, values: Sequence[float]) -> None:
    """Fits y to the lines: intervals of few seeds can be far wider, and are cut at three times the range."""
    low, high = min(values), max(values)
    if score == "nll" and high > _MUCH:
        signed_log(ax)
    reach = high - low or 0.1 * abs(high) or 1.0
    bottom, top = ax.get_ylim()
    bottom, top = max(bottom, low - reach), min(top, high + reach)
    if score == "coverage90":
        ax.axhline(0.9, color="#444444", linewidth=1, linestyle="--")
    if score in _SHARES:
        bottom, top = max(-0.02, min(bottom, 0.78)), 1.02
    elif score in ("rmse", "dtw"):
        bottom = 0.0
    ax.set_ylim(bottom, top)


def _dots(chart: Chart, axis: Axis) -> Figure:
    labels = list(dict.fromkeys(label for row in chart.values.values() for label in row))
    figure, (ax,) = new_figure(height=1.0 + len(chart.values) * max(0.3, 0.16 * len(labels)))
    for rank, (label, style) in enumerate(method_styles(labels).items()):
        shift = 0.8 * ((rank + 0.5) / len(labels) - 0.5)
        for number, row in enumerate(chart.values.values()):
            if label in row:
                value, y = row[label], number + shift
                ax.plot(value.mean, y, color=style.color, marker=style.marker, markersize=5)
                if value.low is not None and value.high is not None:
                    ax.hlines(y, value.low, value.high, color=style.color, linestyle=style.line)
        ax.plot([], [], color=style.color, marker=style.marker, linestyle=style.line, markersize=5, label=label)
    ax.set(yticks=range(len(chart.values)), yticklabels=list(chart.values), ylim=(len(chart.values) - 0.5, -0.5))
    ax.set(title=_title(chart), xlabel=_label(chart, axis))
    outside_legend(figure)
    return figure


def _score(chart: Chart) -> str:
    parts = chart.prefix.split("/")
    return next((part for part in parts if part in _SCORES), parts[0])


def _title(chart: Chart) -> str:
    return chart.prefix.replace("/", ", ")


def _label(chart: Chart, axis: Axis) -> str:
    return score_label(_score(chart), axis.unit)


def _wrapped(setting: Setting) -> str:
    return "\n".join(textwrap.wrap(setting.label, _WIDEST, break_on_hyphens=False, break_long_words=False))


def _widen(figure: Figure, labels: Sequence[str]) -> None:
    """Room for the legend beside axes that keep their size."""
    longest = max(len(line) for label in labels for line in label.splitlines())
    lines = sum(len(label.splitlines()) for label in dict.fromkeys(labels))
    width, height = figure.get_size_inches()
    figure.set_size_inches(width + _LETTER * longest, max(height, 0.6 + 0.19 * lines))


def _is_number(text: str) -> bool:
    return re.fullmatch(r"-?\d+(\.\d+)?(e[+-]?\d+)?", text) is not None

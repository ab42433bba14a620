"""Scores over a quantity that is varied: the one form in which both studies draw, record and tabulate."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING

from eaip_prob.figures import method_styles, rgb, save_figure, score_label, score_lines, signed_log
from eaip_prob.recording import AbstractRunLogger
from eaip_prob.tables import text_table

if TYPE_CHECKING:
    from matplotlib.axes import Axes

Line = Mapping[float, float]
Panels = Mapping[str, Mapping[str, Line]]
LABELS = {score: score_label(score, "px") for score in ("rmse", "nll", "coverage90")}
_SHORT = {"rmse": "rmse [px]", "nll": "nll [nats]", "coverage90": "coverage of 90 %", "ratio": "rmse / environment's"}
_MARGIN = 0.06
_MUCH = 15.0  # nats per sample, so over-confident that a linear axis would hide all others
# Where a score says that nothing is wrong, or that nothing is gained.
_REFERENCES = {"coverage90": 0.9, "ratio": 1.0}


@dataclass(frozen=True, eq=False)
class Chart:
    """One score of several lines over one quantity, in panels.

    Args:
        name: of the figure's file.
        score: `rmse`, `nll`, `coverage90` or `ratio`; decides the axis.
        xlabel: what x is, with its unit.
        ylabel: what the score is, with its unit.
        panels: {title: {line: {x: score}}}.
        bands: {title: {line: {x: (low, high)}}}; an empty band is not drawn.
        num_columns: panels in a row; None for all.
        log_x: x on a logarithmic scale.
    """

    name: str
    score: str
    xlabel: str
    ylabel: str
    panels: Panels
    bands: Mapping[str, Mapping[str, Mapping[float, tuple[float, float]]]] = field(default_factory=dict)
    num_columns: int | None = None
    log_x: bool = False


def draw(folder: Path, charts: Sequence[Chart]) -> None:
    """Writes one figure for each chart into the run folder."""
    for chart in charts:
        figure = score_lines(
            chart.panels,
            chart.xlabel,
            chart.ylabel,
            bands={title: {name: band for name, band in lines.items() if band} for title, lines in chart.bands.items()},
            log_x=chart.log_x,
            num_columns=chart.num_columns,
        )
        for ax in figure.axes:
            if chart.score in _REFERENCES:
                ax.axhline(_REFERENCES[chart.score], color="#444444", linewidth=1, linestyle="--")
            _scale(ax, chart)
        save_figure(figure, folder, chart.name)


def _scale(ax: Axes, chart: Chart) -> None:
    """Fits the y axis to the lines: bands of few repetitions can be much wider, and are cut."""
    values = [value for panel in chart.panels.values() for line in panel.values() for value in line.values()]
    low, high = min(values), max(values)
    if chart.score == "coverage90":
        low, high = 0.0, 1.0
    elif chart.score in ("rmse", "ratio"):
        high = max(high, _REFERENCES.get(chart.score, high))
        low = 0.0
    elif high > _MUCH:
        signed_log(ax)
    margin = _MARGIN * (high - low) or 1.0
    ax.set_ylim(low - margin if chart.score == "nll" else low, high + margin)


def record(logger: AbstractRunLogger, charts: Sequence[Chart], report: str, scale: float = 1.0) -> None:
    """A plot for each panel beside the report; x becomes a whole number on the `samples_seen` axis.

    Args:
        logger: that nothing was recorded to yet.
        charts: what to show.
        report: Markdown.
        scale: x is multiplied by it, so that all x are whole numbers.
    """
    places = {f"scores/{chart.name}/{n}": (chart, title) for chart in charts for n, title in enumerate(chart.panels)}
    titles = {place: f"{_SHORT[chart.score]}: {title}" for place, (chart, title) in places.items()}
    logger.blueprint("plots", titles)
    for place, (chart, title) in places.items():
        styles = method_styles([name for panel in chart.panels.values() for name in panel])
        for name, line in chart.panels[title].items():
            x = sorted(line)
            values = [[line[at]] for at in x]
            seen = [round(scale * at) for at in x]
            logger.series(f"{place}/{name}", x, values, [name], samples_seen=seen, color=rgb(styles[name].color))
    logger.text("scores", report)


def score_table(rows: Sequence[tuple[Mapping[str, str], Line]]) -> str:
    """A Markdown table with a column for each x.

    Args:
        rows: (labels, {x: score}).

    Example:
        >>> print(score_table([({"clock": "marginal"}, {0.1: 12.345, 0.2: 14.0})]))
        | clock    |  0.1 | 0.2 |
        |:---------|-----:|----:|
        | marginal | 12.3 |  14 |
    """
    return text_table([{**labels} | {f"{x:g}": line[x] for x in sorted(line)} for labels, line in rows], digits=3)

"""Scores as figures: lines against samples seen, coverage, and histograms of the probability integral transform."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING

from torch import Tensor

from eaip_prob.checks import check_count, check_fraction
from eaip_prob.errors import InputError
from eaip_prob.figures.style import MethodStyle, as_array, method_styles, new_figure, outside_legend

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

Number = float | int
_SCORES = {
    "coverage90": "share inside the 90 % interval",
    "dtw": "DTW distance{unit}",
    "nll": "negative log density (nats per sample)",
    "rmse": "rmse of the future{unit}",
    "seconds": "time (s)",
    "success": "share of plans that pass",
}


def score_label(score: str, unit: str = "") -> str:
    """What an axis of a score is called, the same in all figures; the score's own name where it is not known.

    Args:
        score: `rmse`, `nll`, `coverage90`, `dtw`, `success` or `seconds`.
        unit: of errors, such as px; left out where empty.

    Example:
        >>> score_label("rmse", "px"), score_label("ratio")
        ('rmse of the future (px)', 'ratio')
    """
    return _SCORES.get(score, score).format(unit=f" ({unit})" if unit else "")


def score_lines(
    panels: Mapping[str, Mapping[str, Mapping[Number, Number]]],
    xlabel: str,
    ylabel: str,
    *,
    bands: Mapping[str, Mapping[str, Mapping[Number, tuple[Number, Number]]]] | None = None,
    log_y: bool = False,
    log_x: bool = False,
    num_columns: int | None = None,
) -> Figure:
    """Score against samples seen, one line a method, one panel for each condition: the form of the paper's Fig. 3.

    Args:
        panels: {panel's title: {method: {x: score}}}; a single panel may have the title "".
        xlabel: what x is, with its unit.
        ylabel: which score, with its unit.
        bands: {panel's title: {method: {x: (low, high)}}}, shaded, e.g. intervals over people.
        log_y: logarithmic scores, for methods that differ by orders of magnitude.
        log_x: logarithmic x, with a tick at every x that occurs.
        num_columns: panels in a row; default all of them.

    Raises:
        InputError: nothing to draw.

    Example:
        >>> lines = {"ip": {10: 5.0, 50: 4.0}, "eaip": {10: 2.0, 50: 1.9}}
        >>> figure = score_lines({"both axes": lines}, "samples seen", "DTW distance (px)")
    """
    methods = list(dict.fromkeys(method for scores in panels.values() for method in scores))
    if not methods:
        raise InputError("Expected at least one panel with one method, got none.")
    styles = method_styles(methods)
    columns = len(panels) if num_columns is None else check_count("num_columns", num_columns)
    figure, axes = new_figure(columns, -(-len(panels) // columns), sharey=True)
    for ax in axes[len(panels) :]:
        ax.remove()
    for ax, (title, scores) in zip(axes, panels.items(), strict=False):
        shaded = (bands or {}).get(title, {})
        for method, line in scores.items():
            x = sorted(line)
            _draw_line(ax, x, [line[at] for at in x], method, styles[method])
            if method in shaded:
                x = sorted(shaded[method])
                low, high = zip(*(shaded[method][at] for at in x), strict=True)
                ax.fill_between(x, low, high, color=styles[method].color, alpha=0.15, linewidth=0)
        ax.set(title=title, xlabel=xlabel, yscale="log" if log_y else "linear")
        if log_x:
            _log_ticks(ax, sorted({at for line in scores.values() for at in line}))
    for ax in axes[: len(panels) : columns]:
        ax.set_ylabel(ylabel)
    outside_legend(figure)
    return figure


def signed_log(ax: Axes, linear: float = 2.0) -> None:
    """Makes y logarithmic away from zero on both sides: for scores of many orders of magnitude that may be negative.

    Args:
        ax: with a y axis in any unit.
        linear: from minus this to this, the scale is linear.

    Example:
        >>> figure = score_lines({"": {"eaip": {10: -0.5, 50: 1000.0}}}, "samples seen", "nll (nats per sample)")
        >>> signed_log(figure.axes[0])
        >>> figure.axes[0].get_yscale()
        'symlog'
    """
    from matplotlib.ticker import ScalarFormatter, SymmetricalLogLocator

    ax.set_yscale("symlog", linthresh=linear)
    ax.yaxis.set_major_locator(SymmetricalLogLocator(base=10, linthresh=linear, subs=[1, 2, 3, 5]))
    ax.yaxis.set_major_formatter(ScalarFormatter())


def coverage_plot(levels: Sequence[Number], observed: Mapping[str, Sequence[Number]]) -> Figure:
    """Share of the truth inside intervals against their nominal level; below the diagonal is over-confident.

    Args:
        levels: nominal levels, fractions.
        observed: {method: share of samples inside, one for each level}, fractions.

    Raises:
        InputError: nothing to draw, or fractions outside 0..1.

    Example:
        >>> figure = coverage_plot([0.5, 0.9], {"eaip": [0.48, 0.88], "paper_eaip": [0.2, 0.4]})
    """
    if not observed:
        raise InputError("Expected the coverage of at least one method, got none.")
    figure, (ax,) = new_figure(width=4.8, height=3.4)
    ax.plot([0, 1], [0, 1], color="#444444", linewidth=1, label="honest")
    for method, style in method_styles(observed).items():
        shares = [check_fraction(f"the coverage of {method}", float(share)) for share in observed[method]]
        _draw_line(ax, [check_fraction("levels", level) for level in levels], shares, method, style)
    ax.set(xlabel="nominal level of the interval", ylabel="share of the truth inside", xlim=(0, 1), ylim=(0, 1.02))
    outside_legend(figure)
    return figure


def pit_histogram(values: Mapping[str, Tensor], num_bins: int = 20) -> Figure:
    """Histogram of the probability integral transform, a panel a method; flat at 1 is honest, a U over-confident.

    Args:
        values: {method: PIT of the scored samples, any shape, 0..1}.
        num_bins: number of bins over [0, 1].

    Raises:
        InputError: nothing to draw, or values outside 0..1 (NaN of unscored samples among them).

    Example:
        >>> import torch
        >>> figure = pit_histogram({"eaip": torch.rand(500, generator=torch.Generator().manual_seed(0))})
    """
    if not values:
        raise InputError("Expected the PIT of at least one method, got none.")
    figure, axes = new_figure(len(values), width=3.4, height=3.0, sharey=True)
    for ax, (method, style) in zip(axes, method_styles(values).items(), strict=True):
        sample = as_array(values[method]).ravel()
        if len(sample) == 0 or not ((sample >= 0) & (sample <= 1)).all():
            raise InputError(
                f"Expected PIT values of {method} between 0 and 1. Select the scored samples: pit(...)[mask]."
            )
        ax.hist(sample, bins=num_bins, range=(0, 1), density=True, color=style.color, edgecolor="white", linewidth=0.5)
        ax.axhline(1.0, color="#444444", linewidth=1, linestyle="--")
        ax.set(title=method, xlabel="predicted probability of the truth", xlim=(0, 1))
    axes[0].set_ylabel("density (1 = honest)")
    return figure


def _log_ticks(ax: Axes, places: Sequence[Number]) -> None:
    from matplotlib.ticker import NullLocator

    ax.set_xscale("log")
    ax.set_xticks(places, [f"{place:g}" for place in places])
    ax.xaxis.set_minor_locator(NullLocator())


def _draw_line(ax: Axes, x: Sequence[Number], y: Sequence[Number], label: str, style: MethodStyle) -> None:
    ax.plot(
        x, y, color=style.color, marker=style.marker, linestyle=style.line, linewidth=1.6, markersize=5, label=label
    )

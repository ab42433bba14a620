"""What came of runs and plans, as figures: Fig. 17b of the paper, and outcomes that it does not have."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np
from jaxtyping import Float

from eaip_prob.figures import method_styles, new_figure, outside_legend, save_figure, score_lines
from eaip_prob.tasks.bag_covering.outcome import KINDS, READY
from eaip_prob.tasks.bag_covering.running import Job, Result

_KIND_COLORS = dict(zip(KINDS, ("#1b9e77", "#e6c229", "#d00000", "#8da0b3", "#4a5763"), strict=True))
_STEP = 0.2  # s
_CENTI = 100.0
_SAME = 1e-6  # m; nearer plans are the same but for round-off


def spoken(name: str) -> str:
    """An object's name as words.

    Args:
        name: as in the configuration.

    Example:
        >>> spoken("table_4_legged"), spoken("folding_table")
        ('4-legged table', 'folding table')
    """
    kind, legs, rest = name.partition("_4_legged")
    return f"4-legged {kind}" if legs and not rest else name.replace("_", " ")


def draw_final_error(folder: Path, metrics: Mapping[str, float]) -> None:
    """Fig. 17b: how far plans are from those after the whole motion, at equal times and at equal phases.

    Methods whose plans never change are left out, and so is the last plan, which is the final one.

    Args:
        folder: of the run.
        metrics: of `study.summary`.
    """
    kinds = {"at equal times": "rmse_to_final", "at equal phases": "shape_to_final"}
    panels: dict[str, dict[str, dict[float, float]]] = {}
    for title, kind in kinds.items():
        for method, line in _by_percent(metrics, kind).items():
            shown = {percent: _CENTI * value for percent, value in line.items() if value > _SAME}
            if shown:
                panels.setdefault(title, {})[method] = shown
    if not panels:
        return
    figure = score_lines(panels, "observed of the partner's motion (%)", "rmse to the final plan (cm)", log_y=True)
    save_figure(figure, folder, "fig_17b_rmse_to_final")


def draw_success_at(folder: Path, metrics: Mapping[str, float]) -> None:
    """Share of plans that, taken as they are, clear the object and can be taken by the arm.

    Args:
        folder: of the run.
        metrics: of `study.summary`.
    """
    lines = _by_percent(metrics, "success_at")
    figure = score_lines({"": lines}, "observed of the partner's motion (%)", "share of plans that pass")
    figure.axes[0].set_ylim(-0.03, 1.03)
    save_figure(figure, folder, "success_at")


def draw_outcomes(folder: Path, results: Mapping[Job, Result], names: Sequence[str]) -> None:
    """How the runs of each method ended, object by object and over all.

    Args:
        folder: of the run.
        results: of all jobs.
        names: of the objects, from above to below.
    """
    methods = list(dict.fromkeys(job.method for job in results))
    columns = min(len(methods), 3)
    shown = [*(name for name in names if any(job.case.site.name == name for job in results)), "all"]
    height = 1.0 + 0.26 * len(shown)
    figure, axes = new_figure(columns, -(-len(methods) // columns), width=3.8, height=height, sharex=True, sharey=True)
    for ax in axes[len(methods) :]:
        ax.remove()
    for number, (ax, method) in enumerate(zip(axes, methods, strict=False)):
        _draw_bars(ax, outcome_shares(results, method, shown), shown)
        count, is_lowest = sum(job.method == method for job in results), number + columns >= len(methods)
        ax.set(title=f"{method} (n = {count})", xlim=(0.0, 100.0), xlabel="runs (%)" if is_lowest else "")
        ax.tick_params(labelbottom=is_lowest)
    outside_legend(figure)
    save_figure(figure, folder, "success")


def outcome_shares(
    results: Mapping[Job, Result], method: str, names: Sequence[str]
) -> Float[np.ndarray, "names kinds"]:
    """Share of runs that ended in each of `KINDS`.

    Args:
        results: of all jobs.
        method: whose runs.
        names: of objects; "all" is all of them.
    """
    shares = np.zeros((len(names), len(KINDS)))
    for row, name in zip(shares, names, strict=True):
        own = {job: result for job, result in results.items() if job.method == method}
        kinds = [result.run.kind for job, result in own.items() if name in (job.case.site.name, "all")]
        row[:] = [kinds.count(kind) / max(len(kinds), 1) for kind in KINDS]
    return shares


def draw_when_to_act(folder: Path, results: Mapping[Job, Result], methods: Sequence[str]) -> None:
    """How far the rest of the plan may still move, over the time of a run: median and quartiles of all runs.

    Args:
        folder: of the run.
        results: of all jobs.
        methods: to be compared.
    """
    figure, (ax,) = new_figure(width=6.4, height=3.8)
    for method, style in method_styles(methods).items():
        time, quartiles = deviation_quartiles(_watched(results, method))
        low, middle, high = _CENTI * quartiles.T
        ax.plot(time, middle, color=style.color, linestyle=style.line, linewidth=2.0, label=f"{method}: median")
        ax.fill_between(time, low, high, color=style.color, alpha=0.2, linewidth=0, label=f"{method}: quartiles")
    enough = f"certain enough to act, {_CENTI * READY:g} cm"
    ax.axhline(_CENTI * READY, color="#222222", linestyle="--", linewidth=1.2, label=enough)
    ax.set(xlabel="time since the partner began (s)", ylabel="remaining deviation (cm)", yscale="log")
    _plain_numbers(ax)
    outside_legend(figure)
    save_figure(figure, folder, "when_to_act")


def deviation_quartiles(
    deviations: Sequence[Float[np.ndarray, "predictions 2"]],
) -> tuple[Float[np.ndarray, "times"], Float[np.ndarray, "times 3"]]:
    """(times, s; quartiles at each, m), at times at which at least half of the runs still predict.

    Args:
        deviations: time, s, and remaining deviation, m, of each prediction of each run.

    Example:
        >>> runs = [np.array([[1.0, 0.2], [2.0, 0.1]]), np.array([[1.0, 0.4]])]
        >>> time, quartiles = deviation_quartiles(runs)
        >>> [time[0].item(), time[-1].item()], quartiles[0].round(2).tolist()
        ([1.0, 2.0], [0.25, 0.3, 0.35])
    """
    known = [run for run in deviations if len(run)]
    if not known:
        return np.zeros(0), np.zeros((0, 3))
    first, last = min(run[0, 0] for run in known), max(run[-1, 0] for run in known)
    time = first + _STEP * np.arange(round((last - first) / _STEP) + 1)
    # Rounded, or the last prediction of a run might lie before its own time in the table.
    table = np.array([np.interp(time.round(6), run[:, 0].round(6), run[:, 1], np.nan, np.nan) for run in known])
    enough = np.isfinite(table).mean(0) >= 0.5
    return time[enough], np.nanquantile(table[:, enough], [0.25, 0.5, 0.75], axis=0).T


def _watched(results: Mapping[Job, Result], method: str) -> list[Float[np.ndarray, "predictions 2"]]:
    """Deviations while the partner moved; a robot that holds predicts on after that."""
    own = [(job.case.motion.duration, result.run.deviation) for job, result in results.items() if job.method == method]
    return [deviation[deviation[:, 0] <= duration] for duration, deviation in own]


def _by_percent(metrics: Mapping[str, float], score: str) -> dict[str, dict[float, float]]:
    """{method: {percent: value}}."""
    lines: dict[str, dict[float, float]] = {}
    for key, value in metrics.items():
        if key.startswith(f"{score}/"):
            _, method, percent = key.split("/")
            lines.setdefault(method, {})[float(percent)] = value
    return lines


def _draw_bars(ax, shares: np.ndarray, names: Sequence[str]) -> None:  # noqa: ANN001
    place = np.arange(len(names), dtype=float)
    place[-1] += 0.4
    left = np.zeros(len(names))
    for kind, values in zip(KINDS, _CENTI * shares.T, strict=True):
        ax.barh(place, values, left=left, height=0.75, color=_KIND_COLORS[kind], label=kind)
        left += values
    ax.set_yticks(place, [spoken(name) for name in names])
    ax.set_ylim(place[-1] + 0.6, -0.6)
    ax.grid(False, axis="y")


def _plain_numbers(ax) -> None:  # noqa: ANN001
    from matplotlib.ticker import LogLocator, NullFormatter

    ax.yaxis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0)))
    ax.yaxis.set_major_formatter(lambda value, _: f"{value:g}")
    ax.yaxis.set_minor_formatter(NullFormatter())

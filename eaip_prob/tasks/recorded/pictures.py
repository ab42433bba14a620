"""Figures of the experiments on recorded motions."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from torch import Tensor

from eaip_prob.data.trajectory import Trajectory
from eaip_prob.figures import (
    coverage_plot,
    method_styles,
    new_figure,
    outside_legend,
    pit_histogram,
    save_figure,
    score_label,
    score_lines,
    signed_log,
)
from eaip_prob.figures.style import as_array
from eaip_prob.methods import EAIP, ENVIRONMENT, IP, MEAN, PAPER_EAIP
from eaip_prob.tasks.recorded.folds import beginning
from eaip_prob.tasks.recorded.study import GAINS, Example, Study

if TYPE_CHECKING:
    from matplotlib.axes import Axes

SEEN = "share of the motion seen (%)"
LEVELS = tuple(0.05 * number for number in range(1, 20))
_NLL_LINEAR = 10.0  # nats; below, no method is so over-confident that the others cannot be told apart
_SIGNAL_COLORS = ("#332288", "#117733", "#AA4499", "#88771f")


def draw(folder: Path, study: Study, unit: str) -> None:
    """Every figure: scores, gains, calibration and the examples.

    Args:
        folder: of the run.
        study: what was measured.
        unit: of the predicted and of the observed signals.
    """
    draw_scores(folder, study, unit)
    draw_gains(folder, study, unit)
    draw_calibration(folder, study)
    for number, example in enumerate(study.examples, start=1):
        draw_example(folder, f"example_{number}", example, study.percents, unit)


def draw_scores(folder: Path, study: Study, unit: str) -> None:
    """Rmse, nll and coverage of every method against the share seen."""
    summaries = study.summaries()
    for score in ("rmse", "nll", "coverage90"):
        lines = {name: {float(p): summaries[name, p][score] for p in study.percents} for name in study.methods}
        figure = score_lines({"": lines}, SEEN, score_label(score, unit))
        (ax,) = figure.axes
        ax.set_xticks(study.percents)
        if score == "rmse":
            ax.set_ylim(bottom=0.0)
        elif score == "nll":
            if max(summary[score] for summary in summaries.values()) > _NLL_LINEAR:
                signed_log(ax)
        else:
            ax.axhline(0.9, color="#444444", linewidth=1, linestyle="--")
            ax.set_ylim(0.0, 1.02)
        save_figure(figure, folder, f"scores_{score}")


def draw_gains(folder: Path, study: Study, unit: str) -> None:
    """Reduction of the error with its 95 % interval; an interval that holds zero leaves open whether there is any."""
    gains = study.gains()
    names = [name for name in GAINS if any(name == key for key, _ in gains)]
    figure, axes = new_figure(len(names), width=3.0, height=3.0)
    for ax, name in zip(axes, names, strict=True):
        rows = [gains[name, percent] for percent in study.percents]
        means = [gain.mean for gain in rows]
        reach = [[gain.mean - gain.low for gain in rows], [gain.high - gain.mean for gain in rows]]
        color = method_styles([GAINS[name][1]])[GAINS[name][1]].color
        ax.axhline(0.0, color="#444444", linewidth=1, linestyle="--")
        ax.errorbar(study.percents, means, yerr=reach, fmt="o", color=color, capsize=4)
        ax.set(title=name.replace("_over_", " over\n"), xlabel="seen (%)", xlim=(5, 95))
        ax.set_xticks(study.percents)
    axes[0].set_ylabel(f"reduction of rmse ({unit})")
    save_figure(figure, folder, "gains")


def draw_calibration(folder: Path, study: Study) -> None:
    """Are intervals of every level honest? At the middle percentage seen, over all scored samples."""
    percent = study.percents[len(study.percents) // 2]
    shown = [name for name in (MEAN, ENVIRONMENT, IP, EAIP, PAPER_EAIP) if name in study.methods]
    levels = {name: study.results[name, percent].pit for name in shown}
    inside = {
        name: [float(((pit - 0.5).abs() <= level / 2).double().mean()) for level in LEVELS]
        for name, pit in levels.items()
    }
    figure = coverage_plot(LEVELS, inside)
    figure.axes[0].set_title(f"{percent} % seen")
    save_figure(figure, folder, "coverage")
    save_figure(pit_histogram({name: levels[name] for name in shown if name != MEAN}), folder, "pit")


def draw_example(folder: Path, name: str, example: Example, percents: Sequence[int], unit: str) -> None:
    """One motion: what was seen of the human above, what was predicted of the robot below, a column a percentage."""
    human, robot = example.motion.human, example.motion.robot
    assert human is not None and robot is not None
    figure, axes = new_figure(len(percents), 1 + robot.num_signals, width=3.6, height=2.3, sharex=True, sharey="row")
    for column, percent in enumerate(percents):
        _, cut = beginning(human, percent)
        _draw_observed(axes[column], human, float(cut))
        axes[column].set_title(f"{percent} % seen")
        for row, signal in enumerate(robot.names, start=1):
            ax = axes[row * len(percents) + column]
            _draw_predicted(ax, example, percent, row - 1, float(cut))
            if column == 0:
                ax.set_ylabel(f"robot: {signal} ({unit})")
    axes[0].set_ylabel(f"human ({unit})")
    for ax in axes[-len(percents) :]:
        ax.set_xlabel("time (s)")
    outside_legend(figure)
    save_figure(figure, folder, name)


def _draw_observed(ax: Axes, human: Trajectory, cut: float) -> None:
    time = as_array(human.time)
    for signal, name in enumerate(human.names):
        seen, values = human.mask[:, signal], human.values[:, signal]
        color = _SIGNAL_COLORS[signal % len(_SIGNAL_COLORS)]
        before = seen & (human.time <= cut)
        ax.plot(time[as_array(seen)], as_array(values[seen]), color=color, linewidth=0.8, linestyle=":")
        ax.plot(time[as_array(before)], as_array(values[before]), color=color, linewidth=2.2, label=f"human: {name}")
    ax.axvline(cut, color="#444444", linewidth=0.8)


def _draw_predicted(ax: Axes, example: Example, percent: int, signal: int, cut: float) -> None:
    robot = example.motion.robot
    assert robot is not None
    ahead = robot.time > cut
    time = as_array(robot.time[ahead])
    styles = method_styles((ENVIRONMENT, IP, EAIP))
    low, high = (bound[ahead, signal] for bound in example.predictions[EAIP, percent].interval(0.9))
    color = styles[EAIP].color
    ax.fill_between(time, as_array(low), as_array(high), color=color, alpha=0.2, linewidth=0, label="90 % band (eaip)")
    for name, style in styles.items():
        mean = _mean(example, name, percent)[ahead, signal]
        ax.plot(time, as_array(mean), color=style.color, linestyle=style.line, linewidth=1.6, label=name)
    seen = robot.mask[:, signal]
    truth = as_array(robot.values[seen][:, signal])
    ax.plot(as_array(robot.time[seen]), truth, color="#222222", linewidth=1.2, linestyle="--", label="robot: true")
    ax.axvline(cut, color="#444444", linewidth=0.8)


def _mean(example: Example, name: str, percent: int) -> Tensor:
    return example.predictions[name, percent].mean

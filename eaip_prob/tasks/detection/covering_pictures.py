"""What a detector said while objects were covered: boxes on frames, Table 1 as bars, and accuracy over the task."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from eaip_prob.figures import new_figure, outside_legend, save_figure
from eaip_prob.simulation.oracle import LabelledFrame
from eaip_prob.tasks.detection.outlines import outline
from eaip_prob.tasks.detection.study import PAPER, ObjectScores, Sighting

if TYPE_CHECKING:
    pass

_TRUE, _FOUND, _WRONG = "#00BFFF", "#F0E442", "#FF8AD6"
_FIRST, _WHOLE, _COVERED, _PAPER = "#0072B2", "#56B4E9", "#D55E00", "#444444"
_SHARES = 10  # steps of the task


def draw_boxes(
    folder: Path,
    frames: Mapping[str, Sequence[Sequence[LabelledFrame]]],
    sightings: Mapping[str, Sequence[Sequence[Sighting]]],
) -> Path:
    """Fig. 8: the first frame of each object's first trial with the true box and what was answered.

    Args:
        folder: of the run.
        frames: object -> trials -> frames.
        sightings: of the same frames.
    """
    figure, axes = new_figure(4, -(-len(frames) // 4), width=4.2, height=2.7)
    for ax, (name, trials) in zip(axes, frames.items(), strict=False):
        frame, said = trials[0][0], sightings[name][0][0]
        ax.imshow(frame.color)
        outline(ax, frame.objects[0].box, _TRUE, "--", "true box")
        for index, box in enumerate(said.detections.box):
            right = said.detections.labels[index] == said.label
            color = _FOUND if right else _WRONG
            outline(ax, box, color, label="answered, right class" if right else "answered, wrong class")
            text = f"{said.detections.labels[index]} {said.detections.score[index]:.2f}"
            edge = said.detections.corners[index]
            ax.text(edge[0], edge[3] + 6, text, color="black", backgroundcolor=color, fontsize=7, va="top")
        ax.set_title(name.replace("_", " "))
        ax.set_axis_off()
    for ax in axes[len(frames) :]:
        ax.set_visible(False)
    outside_legend(figure)
    return save_figure(figure, folder, "figure_8_detections")


def draw_table_1(folder: Path, scores: Mapping[str, ObjectScores]) -> Path:
    """Table 1 as bars: accuracy over half and all of the task, the paper's figure, and how much was covered.

    Args:
        folder: of the run.
        scores: of each object.
    """
    figure, (ax,) = new_figure(1, 1, width=9.0, height=3.6)
    place = np.arange(len(scores))
    first, whole = [one.first_half for one in scores.values()], [one.whole for one in scores.values()]
    ax.bar(place - 0.27, first, 0.25, color=_FIRST, label="right class, first half")
    ax.bar(place, whole, 0.25, color=_WHOLE, label="right class, whole task")
    ax.bar(place + 0.27, [one.covered for one in scores.values()], 0.25, color=_COVERED, label="covered, whole task")
    known = [(i, PAPER[name][0] / PAPER[name][1]) for i, name in enumerate(scores) if name in PAPER]
    if known:
        ax.plot(*zip(*known, strict=True), "_", color=_PAPER, markersize=14, label="the paper, whole task")
    ax.set_xticks(place, [name.replace("_", "\n") for name in scores], fontsize=8)
    ax.set(ylabel="share of frames; of the object", ylim=(0.0, 1.05))
    outside_legend(figure)
    return save_figure(figure, folder, "table_1")


def draw_over_time(folder: Path, sightings: Mapping[str, Sequence[Sequence[Sighting]]]) -> Path:
    """Accuracy and the share that is covered over the task, one panel an object.

    Args:
        folder: of the run.
        sightings: object -> trials -> frames.
    """
    figure, axes = new_figure(4, -(-len(sightings) // 4), width=3.2, height=2.5, sharey=True)
    for ax, (name, trials) in zip(axes, sightings.items(), strict=False):
        said = [one for trial in trials for one in trial]
        step = np.minimum((np.array([one.share for one in said]) * _SHARES).astype(int), _SHARES - 1)
        there = np.unique(step)
        for values, color, label in (
            ([one.right for one in said], _FIRST, "right class"),
            ([one.iou for one in said], _WHOLE, "IoU"),
            ([one.covered for one in said], _COVERED, "covered"),
        ):
            mean = [np.mean(np.asarray(values, float)[step == at]) for at in there]
            ax.plot(100.0 * (there + 0.5) / _SHARES, mean, color=color, label=label)
        ax.set(title=name.replace("_", " "), xlabel="task done (%)", ylabel="mean over frames", ylim=(-0.05, 1.05))
    for ax in axes[len(sightings) :]:
        ax.set_visible(False)
    outside_legend(figure)
    return save_figure(figure, folder, "over_time")

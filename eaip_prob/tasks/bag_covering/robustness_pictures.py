"""Success under each condition, as bars."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np

from eaip_prob.figures import method_styles, new_figure, save_figure


def draw(folder: Path, metrics: Mapping[str, float], methods: Sequence[str]) -> None:
    """The figure `success_under_faults`.

    Args:
        folder: of the run.
        metrics: of `robustness.outcomes`.
        methods: names.
    """
    conditions = list(dict.fromkeys(name.split("/")[1] for name in metrics))
    figure, (ax,) = new_figure(width=6.4, height=0.32 * len(conditions) + 1.2)
    styles, place = method_styles(methods), np.arange(len(conditions))
    thick = 0.8 / len(methods)
    for number, method in enumerate(methods):
        at = place + (number - (len(methods) - 1) / 2.0) * thick
        for score, alpha in (("success", 1.0), ("collisions", 0.35)):
            share = [metrics[f"{score}/{condition}/{method}"] for condition in conditions]
            sign = 1.0 if score == "success" else -1.0
            ax.barh(at, sign * np.array(share), thick, color=styles[method].color, alpha=alpha,
                    label=f"{method}, {score}")  # fmt: skip
    ax.set_yticks(place, conditions)
    ax.invert_yaxis()
    ax.set_xlim(-1.05, 1.05)
    ax.set_xticks([-1, -0.5, 0, 0.5, 1], ["1", "0.5", "0", "0.5", "1"])
    ax.set_xlabel("share of runs: collisions to the left, success to the right")
    ax.axvline(0.0, color="black", linewidth=0.8)
    ax.legend(loc="lower left", fontsize="small")
    save_figure(figure, folder, "success_under_faults")

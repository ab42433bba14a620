"""Paths of the robot's left gripper beside the object, seen from the front of the robot: Fig. 13 to 17a of the paper.

All are drawn in the robot's Y-Z plane as the partner sees it: y, towards the robot's left, to the right, and z up, m.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from jaxtyping import Float

from eaip_prob.figures import method_styles, new_figure, outside_legend, save_figure
from eaip_prob.tasks.bag_covering.judging import CLEAR
from eaip_prob.tasks.bag_covering.outcome_pictures import spoken
from eaip_prob.tasks.bag_covering.recorded import RecordedCovering
from eaip_prob.tasks.bag_covering.running import Job, Result
from eaip_prob.tasks.bag_covering.site import Site
from eaip_prob.tasks.bag_covering.study import Planned, Seen

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

Row = tuple[Seen, str, Mapping[float, Planned], Mapping[int, bool]]
Path2 = Float[np.ndarray, "samples 2"]

EARLY = 10  # percent of the motion after which Fig. 14 plans
_SAMPLES = 101
_ACROSS, _UP = "y (m), to the robot's left", "z (m)"
_FLOOR = -0.93
_LOWEST, _HIGHEST = -0.72, 0.45  # m, of what paths alone need
_TRUTH: Mapping[str, Any] = {"color": "#000000", "linestyle": "--", "linewidth": 1.2}
_OBJECT, _OUTLINE, _COLLISION = "#d9d9d9", "#b5b5b5", "#d00000"


def by_phase(
    path: Float[np.ndarray, "time dims"], time: Float[np.ndarray, "time"]
) -> Float[np.ndarray, "samples dims"]:
    """A path at equal steps of its duration, so that those of slow and fast people can be averaged.

    Args:
        path: (T, D).
        time: (T,), s.

    Example:
        >>> by_phase(np.array([[0.0], [3.0], [4.0]]), np.array([0.0, 3.0, 4.0]))[50].tolist()
        [2.0]
    """
    at = np.linspace(time[0], time[-1], _SAMPLES)
    return np.stack([np.interp(at, time, column) for column in path.T], -1)


def band(paths: Float[np.ndarray, "paths samples 2"]) -> Float[np.ndarray, "outline 2"]:
    """The outline of what lies within one standard deviation of the mean path, measured across it.

    Args:
        paths: (N, S, 2), at the same phases.

    Example:
        >>> along = np.linspace(0.0, 1.0, 5)
        >>> paths = np.stack([np.stack([along, np.full(5, height)], -1) for height in (-0.1, 0.1)])
        >>> band(paths)[:, 1].round(2).tolist()
        [0.1, 0.1, 0.1, 0.1, 0.1, -0.1, -0.1, -0.1, -0.1, -0.1]
    """
    mean = paths.mean(0)
    along = np.gradient(mean, axis=0)
    across = np.stack([-along[:, 1], along[:, 0]], -1)
    across /= np.maximum(np.linalg.norm(across, axis=-1, keepdims=True), 1e-12)
    spread = np.einsum("nsd,sd->ns", paths - mean, across).std(0)[:, None] * across
    return np.concatenate([mean + spread, (mean - spread)[::-1]])


def draw_demonstrations(folder: Path, recorded: Sequence[RecordedCovering], names: Sequence[str]) -> None:
    """Fig. 13: the mean path that the demonstrators led for each object, and how far they differ.

    Args:
        folder: of the run.
        recorded: demonstrations.
        names: of all objects, which fixes their colours.
    """
    figure, (ax,) = new_figure(width=7.2, height=3.6)
    looks = thing_looks(names)
    for name in dict.fromkeys(one.thing for one in recorded):
        own = np.stack([by_phase(one.gripper[:, 1:], one.time) for one in recorded if one.thing == name])
        ax.fill(*band(own).T, color=looks[name]["color"], alpha=0.18, linewidth=0)
        ax.plot(*own.mean(0).T, **looks[name], linewidth=2.0, label=f"{spoken(name)} (n = {len(own)})")
    ax.fill([], [], color="#888888", alpha=0.3, label="one standard deviation")
    _as_seen_from_the_front(ax, low=_LOWEST)
    outside_legend(figure)
    save_figure(figure, folder, "fig_13_mean_demonstrations")


def draw_early_plans(folder: Path, rows: Sequence[Row], methods: Mapping[str, str], names: Sequence[str]) -> None:
    """Fig. 14: the plans of all objects after a tenth of the partner's motion; thin each, thick their mean.

    Args:
        folder: of the run.
        rows: of `study.table`.
        methods: name of the figure -> method.
        names: of all objects.
    """
    looks = thing_looks(names)
    for figure_name, method in methods.items():
        figure, (ax,) = new_figure(width=7.2, height=3.6)
        for name in names:
            own = [by_phase(plan[EARLY].path[:, 1:], seen.case.motion.time) for seen, plan in _of(rows, method, name)]
            for path in own if len(own) > 1 else ():
                ax.plot(*path.T, **looks[name], linewidth=0.6, alpha=0.5)
            if own:
                ax.plot(*np.mean(own, 0).T, **looks[name], linewidth=2.2, label=spoken(name))
        ax.set_title(f"{method}: plans after {EARLY} % of the motion")
        _as_seen_from_the_front(ax, low=_LOWEST)
        outside_legend(figure)
        save_figure(figure, folder, figure_name)


def draw_behaviour(
    folder: Path, name: str, results: Mapping[Job, Result], methods: Sequence[str], things: Sequence[str]
) -> None:
    """Fig. 15 and 16: the path that the robot took over each object, with what came of it, for the first partner.

    Args:
        folder: of the run.
        name: of the figure.
        results: of all jobs.
        methods: one row each.
        things: one column each, of those that were run.
    """
    runs = {(job.method, job.case.site.name): [] for job in results}
    for job, result in results.items():
        runs[job.method, job.case.site.name].append((job, result))
    shown = [thing for thing in things if all((method, thing) in runs for method in methods)]
    if not shown:
        return
    height = 3.3 + 0.4 / len(methods)  # the legend's, which axes of equal scales do not make room for
    figure, axes = new_figure(len(shown), len(methods), width=3.5, height=height, sharex=True, sharey=True)
    for ax, (method, thing) in zip(axes, [(m, t) for m in methods for t in shown], strict=True):
        own = runs[method, thing]
        _draw_run(ax, *own[0])
        share = f"covered with {sum(result.run.is_success for _, result in own)} of {len(own)} partners"
        ax.set_title(f"{method}, {spoken(thing)}: {own[0][1].run.kind}\n{share}", fontsize=9)
    _as_seen_from_the_front(*axes, num_columns=len(shown))
    _legend_below(figure)
    save_figure(figure, folder, name)


def draw_convergence(folder: Path, name: str, rows: Sequence[Row], methods: Sequence[str], thing: str) -> None:
    """Fig. 17a: plans for one object as more of the first partner's motion is seen.

    Args:
        folder: of the run.
        name: of the figure.
        rows: of `study.table`.
        methods: one panel each.
        thing: the object, one of those in `rows`.
    """
    from matplotlib.colors import Normalize

    figure, axes = new_figure(len(methods), width=4.8, height=3.9, sharex=True, sharey=True)
    scale = Normalize(0.0, 100.0)
    for ax, method in zip(axes, methods, strict=True):
        seen, plans = _of(rows, method, thing)[0]
        draw_silhouette(ax, seen.case.site)
        ax.plot(*seen.case.motion.gripper[:, 1:].T, label="as a demonstrator would lead it", **_TRUTH)
        for percent, plan in plans.items():
            ax.plot(*plan.path[:, 1:].T, color=_shade(percent / 100.0), linewidth=1.6)
        ax.set_title(f"{method}, {spoken(thing)}")
    _as_seen_from_the_front(*axes, num_columns=len(methods))
    _color_bar(figure, axes, scale)
    _legend_below(figure)
    save_figure(figure, folder, name)


def draw_silhouette(ax: Axes, site: Site) -> None:
    """What hides the background behind an object, as seen along x.

    Args:
        ax: to draw on.
        site: the object in its place.
    """
    from matplotlib.collections import PolyCollection

    outlines = site.mesh.vertices[site.mesh.triangles][:, :, 1:]
    for color, width, order in ((_OUTLINE, 1.8, 0.8), (_OBJECT, 0.4, 0.9)):
        look = {"facecolors": color, "edgecolors": color, "linewidths": width, "zorder": order}
        ax.add_collection(PolyCollection(list(outlines), **look))
    ax.fill([], [], color=_OBJECT, label="object")


def thing_looks(names: Sequence[str]) -> dict[str, dict[str, Any]]:
    """Colour and line of each object, the same in all figures.

    Args:
        names: of all objects.
    """
    return {name: {"color": style.color, "linestyle": style.line} for name, style in method_styles(names).items()}


def _draw_run(ax: Axes, job: Job, result: Result) -> None:
    run, style = result.run, method_styles([job.method])[job.method]
    draw_silhouette(ax, job.case.site)
    hand = np.array([state.position[1] for state in result.hands])
    ax.plot(*hand[:, 1:].T, color="#777777", linestyle=":", linewidth=1.2, label="partner's right hand, tracked")
    ax.plot(*run.gripper[:, 1:].T, color=style.color, linewidth=2.0, label=f"left gripper ({job.method})")
    ax.plot(*run.gripper[-1, 1:], marker="s", color=style.color, markersize=5)
    if run.kind == "collided":
        near = np.where((run.near < CLEAR)[:, None], run.gripper[:, 1:], np.nan)
        worst = run.gripper[run.near.argmin(), 1:]
        ax.plot(*near.T, color=_COLLISION, linewidth=3.5, label=f"lip or arm nearer than {100 * CLEAR:g} cm")
        ring = {"marker": "o", "markersize": 22, "markerfacecolor": "none", "markeredgewidth": 1.5}
        ax.plot(*worst, markeredgecolor=_COLLISION, **ring)


def _of(rows: Iterable[Row], method: str, thing: str) -> list[tuple[Seen, Mapping[float, Planned]]]:
    return [(seen, plans) for seen, own, plans, _ in rows if own == method and seen.case.site.name == thing]


def _shade(share: float):
    from matplotlib import colormaps

    return colormaps["viridis"](share)


def _color_bar(figure: Figure, axes: Sequence[Axes], scale) -> None:
    from matplotlib.cm import ScalarMappable

    figure.colorbar(ScalarMappable(scale, "viridis"), ax=list(axes), label="observed of the partner's motion (%)")


def _legend_below(figure: Figure) -> None:
    entries: dict[str, Any] = {}
    for ax in figure.axes:
        for handle, label in zip(*ax.get_legend_handles_labels(), strict=True):
            entries.setdefault(label, handle)
    columns = max(1, round(figure.get_figwidth() / 2.7))
    figure.legend(list(entries.values()), list(entries), loc="outside lower center", frameon=False, ncols=columns)


def _as_seen_from_the_front(*axes: Axes, num_columns: int = 1, low: float = _FLOOR - 0.04) -> None:
    """Labels at the rim only, and equal scales."""
    for number, ax in enumerate(axes):
        ax.axhline(_FLOOR, color="#8c8c8c", linewidth=1.0)
        ax.set_aspect("equal", adjustable="box")
        ax.set(xlim=(-0.9, 0.95), ylim=(low, _HIGHEST))
        ax.set_ylabel("" if number % num_columns else _UP)
        ax.set_xlabel(_ACROSS if number >= len(axes) - num_columns else "")

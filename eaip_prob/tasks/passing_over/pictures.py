"""The figures of Sec. 4.1, and the recording that opens in rerun."""

from __future__ import annotations

import warnings
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import torch
from jaxtyping import Float
from torch import Tensor

from eaip_prob.data.environment import EnvironmentFeatures
from eaip_prob.data.resampling import held
from eaip_prob.data.trajectory import Trajectory
from eaip_prob.errors import ExtrapolationWarning
from eaip_prob.figures import (
    method_styles,
    new_figure,
    outside_legend,
    paths_panel,
    rgb,
    save_figure,
    score_label,
    score_lines,
)
from eaip_prob.methods import EAIP, IP, PAPER_EAIP, FittedMethods
from eaip_prob.recording import AbstractRunLogger, Moment
from eaip_prob.tasks.passing_over.study import PLAN_SAMPLES, SCENARIOS, Beginnings

if TYPE_CHECKING:
    from matplotlib.axes import Axes

_TRAIN, _TEST = "#1f77b4", "#2ca02c"  # blue and green, as in the paper's Fig. 2
_AXES = {"horizontal": "horizontal axis seen", "both": "both axes seen"}
_PANEL = {"width": 3.6, "height": 2.5, "sharex": True, "sharey": True}
_PLANS_DRAWN = 40

Size = tuple[float, float]


def rectangle_of(size: Size) -> tuple[float, float, float, float]:
    """(left, bottom, width, height) of a rectangle that stands centred at x = 0."""
    return (-size[0] / 2, 0.0, size[0], size[1])


def draw_motions(folder: Path, training: Beginnings, test: Beginnings) -> None:
    """Fig. 2: training and test motions over each rectangle."""
    figure, axes = new_figure(3, 3, **_PANEL | {"height": 2.1})
    for ax, label in zip(axes, training.references, strict=True):
        size = _size(label)
        paths_panel(ax, rectangle=rectangle_of(size), title=f"{size[0]:g} x {size[1]:g} px")
        for part, color, name in ((training, _TRAIN, "training"), (test, _TEST, "test")):
            for number, motion in enumerate(_of_group(part, label)):
                ax.plot(*motion.T, color=color, linewidth=0.8, label=name if number == 0 else None)
    _finish(figure, axes, folder, "figure_2", 3)


def draw_scores(folder: Path, scores: Mapping[str, Mapping[str, float]], floor: float) -> None:
    """Fig. 3a and 3b (DTW distance), and the scores on the future that the paper does not have."""
    for letter, scenario in zip("ab", SCENARIOS, strict=True):
        lines = _lines(scores, scenario, "dtw")
        lines["real motions"] = {length: floor for length in next(iter(lines.values()))}
        figure = score_lines(
            {_AXES[scenario]: lines}, "samples seen", "DTW distance to training motions (px)", log_y=True
        )
        save_figure(figure, folder, f"figure_3{letter}")
    for score in ("rmse", "nll", "coverage90", "success"):
        panels = {_AXES[scenario]: _lines(scores, scenario, score) for scenario in SCENARIOS}
        figure = score_lines(panels, "samples seen", score_label(score, "px"), log_y=score in ("rmse", "nll"))
        for ax in figure.axes:
            if score == "coverage90":
                ax.axhline(0.9, color="#444444", linewidth=1, linestyle="--")
        save_figure(figure, folder, f"scores_{score}")


def draw_examples(folder: Path, methods: FittedMethods, test: Beginnings, number: int, lengths: Sequence[int]) -> None:
    """Fig. 4a and 4b: predictions of IP and EaIP for one motion as more of it is seen."""
    size = _size(test.groups[number])
    truth = test.motions[number]
    truth = truth.first(int(truth.seen.sum()))
    scene = test.scene[number]
    for letter, hidden in zip("ab", SCENARIOS.values(), strict=True):
        figure, axes = new_figure(len(lengths), 2, **_PANEL)
        for ax, (method, length) in zip(axes, [(m, n) for m in (IP, EAIP) for n in lengths], strict=True):
            observed = truth.first(length).hide(hidden)
            prediction = methods.predict(method, observed, scene, truth.time, truth.duration)
            future = slice(length, None)
            paths_panel(
                ax,
                rectangle=rectangle_of(size),
                mean=prediction.mean[future],
                covariance=prediction.covariance[future],
                truth=truth.values,
                observed=truth.values[:length],
                method=method,
                title=f"{method}, {length} samples seen",
            )
        _finish(figure, axes, folder, f"figure_4{letter}", len(lengths))


def draw_novel(
    folder: Path,
    plans: Sequence[tuple[Size, Trajectory, Float[Tensor, "plans samples 2"]]],
    success: Mapping[str, float],
) -> None:
    """Fig. 5: plans after ten samples for rectangles that nobody demonstrated."""
    figure, axes = new_figure(2, 2, **_PANEL | {"width": 4.2, "height": 2.6})
    for ax, (size, _, paths) in zip(axes, plans, strict=True):
        name = f"{size[0]:g}x{size[1]:g}"
        paths_panel(
            ax,
            rectangle=rectangle_of(size),
            plans=paths[:_PLANS_DRAWN],
            mean=paths.mean(0),
            title=f"{size[0]:g} x {size[1]:g} px (novel): {success[name]:.1%} pass",
        )
    _finish(figure, axes, folder, "figure_5", 2)


def draw_feature_errors(
    folder: Path,
    methods: FittedMethods,
    test: Beginnings,
    levels: Sequence[float],
    noises: Sequence[float],
    generator: torch.Generator,
) -> None:
    """Fig. 6: plans after ten samples with noise in e, for small and large sigma_e."""
    label = list(test.references)[len(test.references) // 2]
    size = _size(label)
    own = [i for i, group in enumerate(test.groups) if group == label][:_PLANS_DRAWN]
    observed = test.seen(10)[own]
    draws = torch.randn(len(own), 2, generator=generator, dtype=torch.float64)
    figure, axes = new_figure(len(levels), len(noises), **_PANEL)
    for ax, (noise, level) in zip(axes, [(n, s) for n in noises for s in levels], strict=True):
        scene = EnvironmentFeatures(test.scene.names, torch.tensor(size, dtype=torch.float64) + level * draws)
        # Sizes far from the demonstrated ones are what is shown.
        with warnings.catch_warnings(action="ignore", category=ExtrapolationWarning):
            plans = methods.ours.with_noise(None, noise).predict(observed, scene).plan(PLAN_SAMPLES)
        title = f"noise in e {level:g} px, sigma_e {noise:g} px"
        paths_panel(ax, rectangle=rectangle_of(size), plans=plans, mean=plans.mean(0), title=title)
    _finish(figure, axes, folder, "figure_6", len(levels))


def draw_error_scores(folder: Path, errors: Mapping[str, float], floor: float) -> None:
    """Fig. 7: DTW distance against the error in e, for each sigma_e."""
    for kind, name in {"noise": "figure_7", "bias": "figure_7_bias"}.items():
        panels: dict[str, dict[str, dict[float, float]]] = {"this package": {}, "as published": {}}
        for key, value in errors.items():
            if key.startswith(f"{kind}/"):
                _, method, level, noise = key.split("/")
                panel = panels["as published" if method == PAPER_EAIP else "this package"]
                panel.setdefault(f"sigma_e {noise} px", {})[float(level)] = value
        for panel in panels.values():
            panel["real motions"] = {level: floor for level in next(iter(panel.values()))}
        figure = score_lines(panels, f"{kind} in e (px)", "DTW distance to training motions (px)", log_y=True)
        save_figure(figure, folder, name)


def record(
    logger: AbstractRunLogger,
    methods: FittedMethods,
    test: Beginnings,
    number: int,
    lengths: Sequence[int],
    scores: Mapping[str, Mapping[str, float]],
    table: str,
    generator: torch.Generator,
) -> None:
    """One motion as it is seen: the prediction of EaIP after each number of samples, scores beside it."""
    size = _size(test.groups[number])
    truth = test.motions[number]
    truth = truth.first(int(truth.seen.sum()))
    scene = test.scene[number]
    plots = {f"signals/{name}": f"{name} (px)" for name in truth.names} | {"phase": "phase", "scores": "rmse (px)"}
    logger.blueprint("plane", plots, bounds=((-420.0, -40.0), (420.0, 480.0)))
    logger.rectangle("object", *size, corner=(-size[0] / 2, 0.0))
    logger.paths("demonstrations", torch.stack(_of_group_padded(test, test.groups[number])))
    logger.path("human/truth", truth.values)
    for name, signal in zip(truth.names, truth.values.T, strict=True):
        logger.series(f"signals/{name}/truth", truth.time, signal[:, None], ["truth"])
    times, phases, evidence = [], [], []
    for length in lengths:
        observed = truth.first(length)
        prediction = methods.predict(EAIP, observed, scene, truth.time, truth.duration)
        lower, upper = prediction.interval(0.9)
        now = Moment(samples_seen=length, time=float(observed.time[-1]))
        logger.prediction(
            "human/eaip",
            truth.time,
            prediction.mean,
            truth.names,
            at=now,
            lower=lower,
            upper=upper,
            samples=prediction.sample(20, generator),
            observed=observed.values,
        )
        weight = prediction.posterior.weight
        phases.append((weight * prediction.phase.paths[..., -1]).sum(-1, keepdim=True))
        times.append(observed.time[-1])
        evidence.append(prediction.log_evidence.reshape(1))
    seen = list(lengths)
    logger.series("phase", times, torch.stack(phases), ["expected phase now"], samples_seen=seen)
    logger.series("evidence", times, torch.stack(evidence), ["log evidence (nats)"], samples_seen=seen)
    lines = _lines(scores, "both", "rmse")
    values = torch.tensor([[line[length] for line in lines.values()] for length in lengths], dtype=torch.float64)
    colors = [rgb(style.color) for style in method_styles(lines).values()]
    logger.series("scores", times, values, list(lines), samples_seen=seen, color=colors)
    dtw = _lines(scores, "both", "dtw")
    logger.array("figure_3b", [[line[length] for line in dtw.values()] for length in lengths], ["samples", "method"])
    logger.text("scores", table)


def _lines(scores: Mapping[str, Mapping[str, float]], scenario: str, score: str) -> dict[str, dict[float, float]]:
    """{method: {samples seen: score}} of one scenario."""
    lines: dict[str, dict[float, float]] = {}
    for name, row in scores.items():
        if name.startswith(f"{scenario}/"):
            _, method, length = name.split("/")
            lines.setdefault(method, {})[float(length)] = row[score]
    return lines


def _of_group(part: Beginnings, label: int | str) -> list[Tensor]:
    motions = [part.motions[i] for i, group in enumerate(part.groups) if group == label]
    return [motion.values[motion.seen] for motion in motions]


def _of_group_padded(part: Beginnings, label: int | str) -> list[Tensor]:
    """Training motions of one rectangle, at rest after their end."""
    motions = part.references[label]
    return list(held(motions, 0.0).values)


def _size(label: int | str) -> Size:
    width, height = str(label).split("x")
    return float(width), float(height)


def _finish(figure, axes: Sequence[Axes], folder: Path, name: str, num_columns: int) -> None:  # noqa: ANN001
    """Axis labels at the rim only, one legend."""
    for number, ax in enumerate(axes):
        ax.set_aspect("equal", adjustable="box")  # the other way is refused where panels share their axes
        if number % num_columns:
            ax.set_ylabel("")
        if number < len(axes) - num_columns:
            ax.set_xlabel("")
    outside_legend(figure)
    save_figure(figure, folder, name)

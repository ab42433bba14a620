"""Planned paths over an object, with their uncertainty."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

import torch
from jaxtyping import Float
from torch import Tensor

from eaip_prob.checks import as_float64, check_shape
from eaip_prob.errors import InputError
from eaip_prob.figures.style import as_array, method_styles
from eaip_prob.linalg import safe_cholesky

if TYPE_CHECKING:
    from matplotlib.axes import Axes


def paths_panel(
    ax: Axes,
    *,
    rectangle: tuple[float, float, float, float] | None = None,
    demonstrations: Float[Tensor, "motions time 2"] | None = None,
    plans: Float[Tensor, "draws time 2"] | None = None,
    mean: Float[Tensor, "time 2"] | None = None,
    covariance: Float[Tensor, "time 2 2"] | None = None,
    truth: Float[Tensor, "seen 2"] | None = None,
    observed: Float[Tensor, "part 2"] | None = None,
    method: str = "eaip",
    level: float = 0.9,
    unit: str = "px",
    title: str = "",
) -> None:
    """Planned paths over an object: the band is the union of every sample's ellipse that holds `level`.

    Add `outside_legend(figure)` once all panels are drawn.

    Args:
        ax: axes to draw on, from `new_figure`.
        rectangle: (left, bottom, width, height) of the object, in `unit`.
        demonstrations: (N, T, 2), thin grey lines.
        plans: (N, T, 2), draws or single plans, thin lines.
        mean: (T, 2), a thick line.
        covariance: (T, 2, 2), predictive covariance of the mean's samples, unit squared.
        truth: (T', 2), what really followed, dashed.
        observed: (T'', 2), the part that was seen.
        method: whose colour to use.
        level: share that each ellipse holds.
        unit: of both axes.
        title: over the panel.

    Raises:
        ShapeError: a path without two signals.
        InputError: a covariance without a mean.

    Example:
        >>> from eaip_prob.figures import new_figure
        >>> figure, (ax,) = new_figure()
        >>> paths_panel(ax, rectangle=(0.0, 0.0, 215.0, 125.0), mean=torch.tensor([[0.0, 0.0], [100.0, 140.0]]))
    """
    if rectangle is not None:
        _draw_rectangle(ax, rectangle)
    if covariance is not None:
        _draw_ellipses(ax, mean, covariance, level, method)
    color, thin = method_styles([method])[method].color, {"linewidth": 0.6, "zorder": 2}
    for paths, look in [
        (demonstrations, {**thin, "color": "#a0a0a0", "label": "demonstrations"}),
        (plans, {**thin, "color": color, "alpha": 0.5, "label": f"plans ({method})"}),
        (truth, {"color": "#222222", "linewidth": 1.4, "linestyle": "--", "zorder": 4, "label": "what followed"}),
        (mean, {"color": color, "linewidth": 2.2, "zorder": 3, "label": f"mean ({method})"}),
        (observed, {"color": "#000000", "linewidth": 2.6, "zorder": 5, "label": "seen"}),
    ]:
        if paths is not None:
            _draw_paths(ax, paths, look)
    ax.set(title=title, xlabel=f"horizontal ({unit})", ylabel=f"vertical ({unit})")
    ax.set_aspect("equal", adjustable="datalim")


def _draw_rectangle(ax: Axes, rectangle: tuple[float, float, float, float]) -> None:
    from matplotlib.patches import Rectangle

    left, bottom, width, height = rectangle
    # The outline stands above the band, which would hide where a plan meets the object.
    ax.add_patch(Rectangle((left, bottom), width, height, facecolor="#e3d9c6", zorder=1, label="object"))
    ax.add_patch(Rectangle((left, bottom), width, height, fill=False, edgecolor="#8c7b5a", zorder=1.8))
    ax.autoscale_view()


def _draw_ellipses(ax: Axes, mean: Tensor | None, covariance: Tensor, level: float, method: str) -> None:
    from matplotlib.collections import PolyCollection
    from matplotlib.colors import to_rgb

    if mean is None:
        raise InputError("Expected the mean path of which covariance is the spread, got none.")
    outline = as_array(level_ellipses(mean, covariance, level))
    # Opaque and pale: transparent ellipses would add up where they overlap.
    pale = tuple(0.75 + 0.25 * channel for channel in to_rgb(method_styles([method])[method].color))
    label = f"{level:.0%} band ({method})"
    ax.add_collection(PolyCollection(list(outline), facecolors=[pale], edgecolors="none", zorder=1.5, label=label))
    ax.update_datalim(outline.reshape(-1, 2))
    ax.autoscale_view()


def level_ellipses(
    mean: Float[Tensor, "time 2"], covariance: Float[Tensor, "time 2 2"], level: float, num_points: int = 48
) -> Float[Tensor, "time points 2"]:
    """Outlines of the ellipses that hold a draw of N(mean, covariance) with probability `level`.

    Two signals: (y - m)^T C^-1 (y - m) <= -2 log(1 - level).

    Args:
        mean: (T, 2).
        covariance: (T, 2, 2), unit squared.
        level: between 0 and 1, exclusive.
        num_points: points of each outline, the first and the last the same.

    Raises:
        ShapeError: a mean or a covariance of another shape.
        InputError: a level outside (0, 1).
        NotPositiveDefiniteError: no covariance.

    Example:
        >>> outline = level_ellipses(torch.zeros(1, 2), torch.eye(2)[None], 0.9)
        >>> round(float(outline.norm(dim=-1).mean()), 3)
        2.146
    """
    if not 0.0 < level < 1.0:
        raise InputError(f"Expected level above 0 and below 1, got {level}. Give 90 % as 0.9.")
    check_shape("mean", mean, ["T", 2])
    check_shape("covariance", covariance, [len(mean), 2, 2])
    turn = torch.linspace(0.0, 2.0 * math.pi, num_points, dtype=torch.float64)
    circle = math.sqrt(-2.0 * math.log1p(-level)) * torch.stack([turn.cos(), turn.sin()], dim=-1)
    return as_float64("mean", mean)[:, None] + circle @ safe_cholesky(as_float64("covariance", covariance)).mT


def _draw_paths(ax: Axes, paths: Tensor, look: Mapping[str, Any]) -> None:
    check_shape("a path", paths, ["T", 2])
    for number, path in enumerate(as_array(paths).reshape(-1, *paths.shape[-2:])):
        ax.plot(path[:, 0], path[:, 1], **{**look, "label": look["label"] if number == 0 else "_"})

"""Boxes drawn on images."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from jaxtyping import Float

if TYPE_CHECKING:
    from matplotlib.axes import Axes


def outline(ax: Axes, box: Float[np.ndarray, "4"], color: str, line: str = "-", label: str | None = None) -> None:
    """Draws a box on the image that a panel shows.

    Args:
        ax: the panel.
        box: (4,), centre column, centre row, width and height, px.
        color: of the line.
        line: its style.
        label: for the legend.

    Example:
        >>> from eaip_prob.figures import new_figure
        >>> _, (ax,) = new_figure()
        >>> outline(ax, np.array([5.0, 4.0, 2.0, 2.0]), "#0072B2")
        >>> len(ax.patches)
        1
    """
    from matplotlib.patches import Rectangle

    corner = tuple(box[:2] - box[2:] / 2)
    shown = Rectangle(corner, box[2], box[3], fill=False, edgecolor=color, linestyle=line, linewidth=1.4, label=label)
    ax.add_patch(shown)

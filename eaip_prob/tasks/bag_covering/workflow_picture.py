"""Fig. 12: from what the cameras see to how the robot moves, as a diagram of the loop in `loop.py`."""

from __future__ import annotations

from pathlib import Path

from eaip_prob.figures import new_figure, save_figure

_SEEN, _KNOWN, _DONE = "#dceaf5", "#f7e3d3", "#dff0e6"
_WIDTH, _HEIGHT = 2.5, 1.0
_BOXES = {
    "kinects": (1.5, 3.2, "three Kinects:\ncolour and depth", _SEEN),
    "gloves": (4.7, 3.2, "both green gloves\nin the fused cloud", _SEEN),
    "hands": (7.9, 3.2, "the partner's\ntrajectory so far", _SEEN),
    "image": (1.5, 1.4, "colour image of\nKinect 3 (right)", _SEEN),
    "detector": (4.7, 1.4, "detector:\nclass, box, place", _SEEN),
    "features": (7.9, 1.4, "features $e$ and\ntheir covariance", _SEEN),
    "joint": (11.1, 5.0, "joint model, from\ndemonstrations", _KNOWN),
    "posterior": (11.1, 2.3, "posterior of the phase\nand of the robot's\nweights", _KNOWN),
    "plan": (14.3, 2.3, "plan: expected path\nand its uncertainty", _KNOWN),
    "check": (17.5, 2.3, "check: reach, speed,\njump, risk of collision", _DONE),
    "execution": (17.5, 5.0, "execution: follow the\nplan, or hold", _DONE),
}
_ARROWS = (
    ("kinects", "gloves"), ("kinects", "image"), ("gloves", "hands"), ("image", "detector"), ("detector", "features"),
    ("hands", "posterior"), ("features", "posterior"), ("joint", "posterior"), ("posterior", "plan"),
    ("plan", "check"), ("check", "execution"),
)  # fmt: skip


def draw_workflow(folder: Path) -> None:
    """Draws the diagram.

    Args:
        folder: of the run.
    """
    figure, (ax,) = new_figure(width=13.0, height=4.3)
    for x, y, text, color in _BOXES.values():
        _box(ax, x, y, text, color)
    for start, end in _ARROWS:
        _arrow(ax, *_ends(start, end))
    # The robot and the partner move, and the cameras see both again.
    back = [(17.5 - _WIDTH / 2, 5.0), (14.3, 5.0), (14.3, 6.1), (1.5, 6.1), (1.5, 3.2 + _HEIGHT / 2)]
    ax.plot(*zip(*back, strict=True), color="#555555", linewidth=1.4)
    _arrow(ax, back[-2], back[-1])
    words = {"fontsize": 9, "color": "#444444"}
    ax.annotate("the robot moves, the partner goes on; a new plan every 0.2 s", (7.9, 6.18), ha="center", **words)
    ax.annotate("safe or not, and why", (17.65, 3.65), va="center", **words)
    ax.set(xlim=(0.1, 19.3), ylim=(0.6, 6.6))
    ax.set_axis_off()
    save_figure(figure, folder, "fig_12_workflow")


def _box(ax, x: float, y: float, text: str, color: str) -> None:  # noqa: ANN001
    from matplotlib.patches import FancyBboxPatch

    corner, look = (x - _WIDTH / 2, y - _HEIGHT / 2), {"facecolor": color, "edgecolor": "#555555", "linewidth": 1.2}
    ax.add_patch(FancyBboxPatch(corner, _WIDTH, _HEIGHT, boxstyle="round,pad=0,rounding_size=0.12", **look))
    ax.annotate(text, (x, y), ha="center", va="center", fontsize=9.5)


def _ends(start: str, end: str) -> tuple[tuple[float, float], tuple[float, float]]:
    """From the rim of one box to that of another: straight across, or straight up and down."""
    (x, y), (to_x, to_y) = _BOXES[start][:2], _BOXES[end][:2]
    if x == to_x:
        side = _HEIGHT / 2 if to_y > y else -_HEIGHT / 2
        return (x, y + side), (to_x, to_y - side)
    return (x + _WIDTH / 2, y), (to_x - _WIDTH / 2, to_y + 0.25 * (y - to_y))


def _arrow(ax, start, end) -> None:  # noqa: ANN001
    look = {"arrowstyle": "-|>", "color": "#555555", "linewidth": 1.4, "shrinkA": 0, "shrinkB": 0, "mutation_scale": 14}
    ax.annotate("", end, start, arrowprops=look)

"""What the cameras saw, and how far tracked hands were from the gloves."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np
from jaxtyping import Float

from eaip_prob.data.frames import RGBDFrame
from eaip_prob.figures import new_figure, outside_legend, save_figure
from eaip_prob.perception.hands import HandState
from eaip_prob.tasks.kinects.paths import HandPath

_COLORS = {"left": "#0072B2", "right": "#D55E00"}


def draw_views(folder: Path, name: str, frames: Sequence[RGBDFrame]) -> Path:
    """Colour above depth of every camera at one time.

    Args:
        folder: of the run.
        name: of the figure.
        frames: one a camera.
    """
    figure, axes = new_figure(len(frames), 2, width=4.0, height=2.9)
    for place, frame in enumerate(frames):
        above, below = axes[place], axes[place + len(frames)]
        above.imshow(frame.color)
        above.set_title(f"{frame.name}: colour")
        depth = np.where(frame.valid, frame.depth, np.nan)
        below.imshow(depth, cmap="viridis", vmin=0.5, vmax=4.5)
        below.set_title(f"{frame.name}: depth")
        for ax in (above, below):
            ax.set_axis_off()
    figure.colorbar(axes[-1].images[0], ax=axes[len(frames) :], label="depth (m)", shrink=0.8)
    return save_figure(figure, folder, name)


def draw_errors(folder: Path, paths: Mapping[str, HandPath], states: Mapping[str, Sequence[HandState | None]]) -> Path:
    """Distance of each tracked hand from its glove over time, one panel a scenario; crosses where it is not seen.

    Args:
        folder: of the run.
        paths: where the gloves were, by scenario.
        states: what the tracker said, by scenario.
    """
    figure, axes = new_figure(2, -(-len(paths) // 2), width=5.0, height=2.7, sharey=True)
    for ax, (name, path) in zip(axes, paths.items(), strict=False):
        for hand, (side, color) in enumerate(_COLORS.items()):
            error, seen = _errors(path, states[name], hand)
            ax.plot(path.time, error, color=color, label=f"{side} hand")
            ax.plot(path.time[~seen], error[~seen], "x", color=color, label=f"{side} hand, not seen")
        ax.set(title=name, xlabel="time (s)", ylabel="distance from the glove (mm)", yscale="log", ylim=(0.2, 1000.0))
    for ax in axes[len(paths) :]:
        ax.set_visible(False)
    outside_legend(figure)
    return save_figure(figure, folder, "errors")


def _errors(
    path: HandPath, states: Sequence[HandState | None], hand: int
) -> tuple[Float[np.ndarray, "time"], np.ndarray]:
    error, seen = np.full(len(path.time), np.nan), np.zeros(len(path.time), dtype=bool)
    for place, state in enumerate(states):
        if state is not None:
            error[place] = 1000.0 * np.linalg.norm(state.position[hand] - path.position[place, hand])
            seen[place] = state.seen[hand]
    return error, seen

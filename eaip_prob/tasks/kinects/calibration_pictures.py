"""What a calibration looked at, and how far each camera was from the truth."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from eaip_prob.data.frames import inverse
from eaip_prob.figures import new_figure, outside_legend, save_figure
from eaip_prob.perception.extrinsics import Extrinsics
from eaip_prob.tasks.kinects.board_session import BoardSession
from eaip_prob.tasks.kinects.calibrating import CalibrationResult

if TYPE_CHECKING:
    from matplotlib.axes import Axes

_COLORS = ("#0072B2", "#D55E00", "#009E73", "#CC79A7")
_ARROW = 500.0  # px drawn for each px of a residual
_MARGIN = 90.0  # px shown around the board


def draw_calibration(folder: Path, session: BoardSession, results: Mapping[str, CalibrationResult]) -> Path:
    """One board with its corners and their residuals, and each camera's errors beside what was predicted.

    Args:
        folder: of the run.
        session: what the cameras saw.
        results: by what was known of the boards' poses, such as "exact" and "uncertain"; the first is drawn on the
            image, with the true poses of the boards.
    """
    figure, (image, position, rotation) = new_figure(3, width=5.0, height=3.8)
    _draw_board(image, session, next(iter(results.values())).found)
    _draw_bars(position, results)
    _draw_rotations(rotation, results)
    outside_legend(figure)
    return save_figure(figure, folder, "calibration")


def _draw_board(ax: Axes, session: BoardSession, found: Mapping[str, Extrinsics]) -> None:
    view = session.views[0]
    camera, corners = found[view.camera], view.corners
    pose = inverse(camera.T_world_camera) @ session.T_world_board[view.board]
    places = session.board.corners[corners.ids]
    expected = camera.intrinsics.project(places @ pose[:3, :3].T + pose[:3, 3])
    gaps = expected - corners.pixels
    ax.imshow(session.image)
    ax.plot(*corners.pixels.T, "o", color=_COLORS[0], markersize=4, fillstyle="none", label="corner found")
    label = f"to its reprojection, {_ARROW:g} times enlarged"
    ax.quiver(
        *corners.pixels.T, *gaps.T, color=_COLORS[3], angles="xy", scale_units="xy", scale=1.0 / _ARROW, label=label
    )
    low, high = corners.pixels.min(0) - _MARGIN, corners.pixels.max(0) + _MARGIN
    residual = float(np.sqrt(np.mean(np.sum(gaps**2, axis=1))))
    ax.set(xlim=(low[0], high[0]), ylim=(high[1], low[1]), xlabel="column (px)", ylabel="row (px)")
    ax.set_title(f"{view.camera}, board {view.board}: residual {residual:.3f} px")
    ax.grid(False)


def _draw_bars(ax: Axes, results: Mapping[str, CalibrationResult]) -> None:
    for place, (label, result) in enumerate(results.items()):
        at = _places(place, len(results), len(result.errors))
        ax.bar(at, [error.millimetres for error in result.errors.values()], 0.7 / len(results),
               color=_COLORS[place], label=f"error, {label} board poses")  # fmt: skip
        predicted = [1e3 * one for one in result.predicted.values()]
        ax.plot(at, predicted, "_", color="black", markersize=16, markeredgewidth=2, label="predicted, 1 sigma")
    _label_cameras(ax, results)
    ax.set(ylabel="root mean square error (mm)", title="misplaced points of the workspace")


def _draw_rotations(ax: Axes, results: Mapping[str, CalibrationResult]) -> None:
    for place, (_, result) in enumerate(results.items()):
        at = _places(place, len(results), len(result.errors))
        ax.bar(at, [error.degrees for error in result.errors.values()], 0.7 / len(results), color=_COLORS[place])
        stds = [np.degrees(np.sqrt(np.trace(one.covariance[:3, :3]))) for one in result.found.values()]
        ax.plot(at, stds, "_", color="black", markersize=16, markeredgewidth=2)
    _label_cameras(ax, results)
    ax.set(ylabel="rotation error (degrees)", title="rotation of each camera")


def _places(place: int, count: int, cameras: int) -> np.ndarray:
    return np.arange(cameras) + (place - 0.5 * (count - 1)) * 0.8 / count


def _label_cameras(ax: Axes, results: Mapping[str, CalibrationResult]) -> None:
    names = list(next(iter(results.values())).errors)
    ax.set_xticks(range(len(names)), names)
    ax.grid(False, axis="x")

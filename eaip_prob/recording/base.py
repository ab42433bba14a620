"""The calls with which experiments record."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from eaip_prob.errors import ShapeError
from eaip_prob.recording.checks import Color, as_array, check_bounds
from eaip_prob.recording.prediction import prediction_records
from eaip_prob.recording.records import PREDICTED, TRUTH, Array, Curves, Layout, Moment, Text
from eaip_prob.recording.sensing import AbstractSensing


class AbstractRunLogger(AbstractSensing):
    """Records what a run did; a context manager that keeps what was recorded even if the run raises.

    A subclass implements `_write`, which stores one checked record (`recording.records`, `recording.sensor_records`,
    `recording.scene_records`),
    and `_finish`, which is called once when the logger is closed. It gets every public call below, and those of
    `recording.drawing` and `recording.sensing`, with its checks of shapes and values.

    Every call raises `ShapeError` where axes do not match, and `InputError` where numbers are not finite, time does
    not increase, bounds are exchanged, an entity is malformed or the logger was closed; nothing is stored then.
    Arrays may be tensors, NumPy arrays or nested lists; they are copied before a call returns, and never changed.
    """

    def series(
        self,
        entity: str,
        time: Any,
        values: Any,
        names: Sequence[str],
        *,
        samples_seen: Any = None,
        color: Color | Sequence[Color] = TRUTH,
        width: float = 1.5,
    ) -> None:
        """Curves over time: signals, phase, log evidence, scores.

        Args:
            entity: name of the curves; the layout shows all curves under one entity in one plot.
            time: (T,), seconds, strictly increasing.
            values: (T, C), in the plot's unit.
            names: C names for the legend.
            samples_seen: (T,), whole numbers, strictly increasing; default 1 to T: one row per sample.
            color: one for all curves, or C of them.
            width: of the lines, in points of the screen.

        Example:
            >>> from eaip_prob.recording import NullLogger
            >>> NullLogger().series("phase", [0.0, 0.1, 0.2], [[0.0], [0.4], [1.0]], ["phase"])
            >>> NullLogger().series("scores", [0.1, 0.4], [[9.0], [3.0]], ["rmse"], samples_seen=[10, 40])
        """
        colors = [color] * len(names) if not color or isinstance(color[0], int) else list(color)  # pyright: ignore
        if len(colors) != len(names):
            raise ShapeError(f"Expected one color or {len(names)}, one per name, at {entity!r}, got {len(colors)}.")
        count = np.arange(1, as_array("time", time).size + 1) if samples_seen is None else samples_seen
        self._record(Curves(entity, time, count, values, tuple(names), tuple(colors), width))  # pyright: ignore

    def interval(
        self,
        entity: str,
        time: Any,
        lower: Any,
        upper: Any,
        *,
        samples_seen: Any = None,
        color: Color = (*PREDICTED[:3], 140),
        name: str = "interval",
    ) -> None:
        """The bounds of one signal over time, as two thin curves.

        Args:
            entity: name of the interval; put it under the entity of the signal's plot.
            time: (T,), seconds, strictly increasing.
            lower: (T,), in the signal's unit.
            upper: (T,), nowhere below `lower`.
            samples_seen: (T,), whole numbers; default 1 to T.
            color: (red, green, blue) or with opacity, 0..255.
            name: for the legend, such as `90 %`.

        Example:
            >>> from eaip_prob.recording import NullLogger
            >>> NullLogger().interval("signals/x/90", [0.0, 0.1], [1.0, 2.0], [3.0, 4.0], name="90 %")
        """
        low, high = as_array("lower", lower), as_array("upper", upper)
        check_bounds(entity, low, high, as_array("time", time).shape)
        bounds = np.stack([low, high], axis=-1)
        self.series(entity, time, bounds, [name, name], samples_seen=samples_seen, color=color, width=0.75)

    def prediction(
        self,
        entity: str,
        time: Any,
        mean: Any,
        names: Sequence[str],
        *,
        at: Moment,
        lower: Any = None,
        upper: Any = None,
        samples: Any = None,
        observed: Any = None,
        curves: bool = True,
    ) -> None:
        """What was predicted at one moment: a picture that changes with the slider, and a fan in the plots.

        Two or three signals are drawn as paths in the plane or in space (mean, samples, the part observed, and the
        interval at the end of the motion as a box), each replaced by the prediction of a later moment. In the plot
        `signals/NAME` of each signal the mean and its bounds start at `at`, one fan for each moment.

        Args:
            entity: whose motion is predicted, such as `robot`.
            time: (T,), seconds, strictly increasing, on the clock of `at`.
            mean: (T, D), in the signals' units.
            names: D names of the signals.
            at: when the prediction was made.
            lower: (T, D), lower bound of an interval, or None together with `upper`.
            upper: (T, D), upper bound.
            samples: (N, T, D), drawn from the posterior.
            observed: (samples seen, 2 or 3), the partner's motion so far.
            curves: whether to add the fan; switch it off where predictions follow each other closely.

        Example:
            >>> now = Moment(samples_seen=1, time=0.0)
            >>> from eaip_prob.recording import NullLogger
            >>> NullLogger().prediction("robot", [0.0, 0.1], [[0.0, 0.0], [9.0, 5.0]], ["x", "y"], at=now)
        """
        bounds = None if lower is None and upper is None else (lower, upper)
        records = prediction_records(
            entity, time, mean, names, at, bounds=bounds, samples=samples, observed=observed, fan=curves
        )
        for record in records:
            self._record(record)

    def text(self, entity: str, markdown: str, *, at: Moment | None = None) -> None:
        r"""A Markdown document, such as the table of the metrics.

        Args:
            entity: name of the document.
            markdown: its text.
            at: since when it holds; None for the whole recording.

        Example:
            >>> from eaip_prob.recording import NullLogger
            >>> NullLogger().text("metrics", "| method | rmse [px] |\n|---|---|\n| eaip | 8.1 |")
        """
        self._record(Text(entity, markdown, at))

    def array(self, entity: str, values: Any, names: Sequence[str]) -> None:
        """The numbers behind a figure.

        Args:
            entity: name of the figure, such as `figure_5/dtw`.
            values: any shape, finite.
            names: one name per axis.

        Example:
            >>> from eaip_prob.recording import NullLogger
            >>> NullLogger().array("figure_5/dtw", [[1.0, 2.0], [3.0, 4.0]], ["method", "samples seen"])
        """
        self._record(Array(entity, values, tuple(names)))

    def blueprint(
        self,
        kind: str,
        plots: Mapping[str, str] | None = None,
        *,
        timeline: str = "samples_seen",
        bounds: tuple[tuple[float, float], tuple[float, float]] | None = None,
    ) -> None:
        """Says what the viewer shows when the recording is opened; call it first, so that a killed run has it too.

        Args:
            kind: `plane` (2-D paths beside the plots), `space` (3-D paths beside the plots), `cameras` (3-D scene,
                images of the cameras and plots), `workspace` (surfaces in a large 3-D scene above the colour images,
                beside report and plots) or `plots`.
            plots: title with unit for each plot, by entity: `{"signals/x": "x [px]", "scores": "rmse [px]"}`.
            timeline: `samples_seen` or `time`, the horizontal axis of the plots and of the slider.
            bounds: ((x, y) smallest, (x, y) largest) of the plane, y up; None fits what was recorded.

        Example:
            >>> from eaip_prob.recording import NullLogger
            >>> NullLogger().blueprint("plane", {"signals/x": "x [px]"}, timeline="time")
        """
        self._record(Layout(kind, plots or {}, timeline, bounds))

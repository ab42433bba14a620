"""The logger that writes a file for the rerun viewer."""

from __future__ import annotations

import os
from pathlib import Path
from typing import Any

import numpy as np
import rerun as rr

from eaip_prob.errors import InputError
from eaip_prob.recording.base import AbstractRunLogger
from eaip_prob.recording.layout import Sensed, viewer_blueprint
from eaip_prob.recording.records import Array, Box, Curves, Layout, Moment, Paths, Record, Text
from eaip_prob.recording.rerun_scene import IMAGE_BOXES, fabric_columns, image_box_columns, vertex_columns
from eaip_prob.recording.rerun_sensors import (
    camera_places,
    cloud_columns,
    ellipsoid_columns,
    image_columns,
    marker_columns,
    pinhole_columns,
)
from eaip_prob.recording.scene_records import ImageBoxes, SceneRecord, Surface
from eaip_prob.recording.sensor_records import CameraImages, Cloud, Markers, SensorRecord

_MIRRORED = np.diag([1.0, -1.0, 1.0])


class RerunLogger(AbstractRunLogger):
    """Writes one `.rrd` file; two runs that record the same write recordings that compare equal.

    While the run goes on the file has a temporary name, `NAME.partial.rrd`; it gets its own name when the logger is
    closed, also by an exception that passes the `with` block. Every record is in the file when its call returns, so
    what a killed run leaves under the temporary name can be opened as well. Nothing is sent over the network, and no
    timeline holds the wall clock.

    Args:
        path: of the file, ending in `.rrd`; its folder is made, and an older recording is replaced on closing.
        application_id: what the viewer calls the experiment; recordings that share it share the viewer's layout.
        recording_id: of this run, such as `passing_over-seed3`; the viewer merges recordings with one id. Default:
            the folder and name of the file.

    Raises:
        InputError: a path that does not end in `.rrd`.

    Example:
        >>> import tempfile
        >>> with RerunLogger(Path(tempfile.mkdtemp()) / "recording.rrd", "passing_over") as logger:
        ...     logger.path("human/truth", [[0.0, 0.0], [120.0, 80.0]])
        >>> logger.path_of_file.name
        'recording.rrd'
    """

    def __init__(
        self, path: str | Path = "recording.rrd", application_id: str = "eaip_prob", recording_id: str | None = None
    ) -> None:
        self.path_of_file = Path(path)
        if self.path_of_file.suffix != ".rrd":
            raise InputError(f"Expected a path that ends in '.rrd', got {str(path)!r}.")
        self.path_of_file.parent.mkdir(parents=True, exist_ok=True)
        self._partial = self.path_of_file.with_suffix(".partial.rrd")
        name = recording_id or f"{self.path_of_file.resolve().parent.name}-{self.path_of_file.stem}"
        self._stream = rr.RecordingStream(application_id, recording_id=name, send_properties=False)
        self._stream.set_sinks(rr.FileSink(str(self._partial)))
        self._layout: Layout | None = None
        self._extent: np.ndarray | None = None
        self._last: Moment | None = None
        self._sensed = Sensed()
        self._places: dict[str, bytes] = {}
        self._send("plane", None, rr.Transform3D.columns(mat3x3=_MIRRORED[None]))

    def _write(self, record: Record | SensorRecord | SceneRecord) -> None:
        if isinstance(record, Paths):
            self._write_paths(record)
        elif isinstance(record, Box):
            self._write_box(record)
        elif isinstance(record, Curves):
            self._write_curves(record)
        elif isinstance(record, Text):
            columns = rr.TextDocument.columns(text=[record.markdown], media_type=[rr.MediaType.MARKDOWN])
            self._send(f"report/{record.entity}", record.at, columns)
        elif isinstance(record, Array):
            columns = rr.Tensor.columns(data=[rr.TensorData(array=record.values, dim_names=record.names)])
            self._send(f"arrays/{record.entity}", None, columns)
        elif isinstance(record, Layout):
            self._layout = record
            self._send_layout()
        elif isinstance(record, Surface):
            self._write_surface(record)
        elif isinstance(record, ImageBoxes):
            self._send(f"space/{record.entity}/{IMAGE_BOXES}", record.at, image_box_columns(record))
        else:
            self._write_sensed(record)
        self._stream.flush()

    def _write_sensed(self, record: SensorRecord) -> None:
        if isinstance(record, CameraImages):
            self._write_camera(record)
        elif isinstance(record, Cloud):
            self._show_also(self._sensed.clouds, record.entity)
            self._send(f"space/{record.entity}", record.at, cloud_columns(record))
        elif isinstance(record, Markers):
            self._show_also(self._sensed.markers, record.entity)
            self._send(f"space/{record.entity}", record.at, marker_columns(record))
        else:
            self._send(f"space/{record.entity}", record.at, ellipsoid_columns(record))

    def _write_camera(self, record: CameraImages) -> None:
        self._show_also(self._sensed.cameras, record.entity)
        for camera, (pose, lens) in camera_places(record.frame).items():
            entity = f"space/{record.entity}/{camera}"
            place = pose.tobytes() + repr(lens).encode()
            if self._places.get(entity) != place:
                self._places[entity] = place
                self._send(entity, record.at, pinhole_columns(pose, lens))
        for image, columns in image_columns(record.frame).items():
            self._send(f"space/{record.entity}/{image}", record.at, columns)

    def _write_surface(self, record: Surface) -> None:
        self._show_also(self._sensed.surfaces, record.entity)
        entity = f"space/{record.entity}"
        fabric = record.triangles.tobytes() + record.colors.tobytes() + bytes([record.smooth])
        if self._places.get(entity) != fabric:
            self._places[entity] = fabric
            self._send(entity, record.at, fabric_columns(record))
        self._send(entity, record.at, vertex_columns(record))

    def _show_also(self, shown: list[str], entity: str) -> None:
        """Adds an entity for which the layout has views of its own."""
        if entity not in shown:
            shown.append(entity)
            self._send_layout()

    def _finish(self) -> None:
        self._send_layout()
        self._stream.disconnect()
        os.replace(self._partial, self.path_of_file)

    def _write_paths(self, record: Paths) -> None:
        in_plane = record.values.shape[-1] == 2
        strips = (rr.LineStrips2D if in_plane else rr.LineStrips3D).columns(strips=list(record.values))
        shape = strips.partition([len(record.values)])
        self._send_drawn(record.entity, record.at, record.values, shape, record)

    def _write_box(self, record: Box) -> None:
        low, high = record.lower, record.upper
        if len(low) == 2:
            # A closed line, because the viewer puts the label of a 2-D box wrongly under a mirroring transform.
            outline = np.array([low, [high[0], low[1]], high, [low[0], high[1]], low])
            shape = rr.LineStrips2D.columns(strips=[outline])
        else:
            wires = [rr.components.FillMode.MajorWireframe]
            shape = rr.Boxes3D.columns(centers=[(low + high) / 2], half_sizes=[(high - low) / 2], fill_mode=wires)
        self._send_drawn(record.entity, record.at, np.stack([low, high]), shape, record)

    def _send_drawn(self, entity: str, at: Moment | None, points: np.ndarray, shape: Any, style: Paths | Box) -> None:
        in_plane = points.shape[-1] == 2
        kind = rr.LineStrips2D if in_plane else (rr.Boxes3D if isinstance(style, Box) else rr.LineStrips3D)
        radius = style.radius if isinstance(style, Paths) else 1.0
        # Negative radii are points of the screen, so that a line stays visible at any zoom and in any unit.
        look: dict[str, Any] = {"colors": [style.color], "radii": [-radius]}
        if in_plane:
            look["draw_order"] = [radius]
        if style.label is not None:
            look["labels"] = [style.label]
        self._send(f"{'plane' if in_plane else 'space'}/{entity}", at, [*shape, *kind.columns(**look)])
        if in_plane:
            self._grow(points)

    def _write_curves(self, record: Curves) -> None:
        entity, number = f"plots/{record.entity}", len(record.names)
        look = rr.SeriesLines.columns(colors=record.colors, names=record.names, widths=[record.width] * number)
        self._send(entity, None, look.partition([number]))
        indexes = [
            rr.TimeColumn("time", duration=record.time),
            rr.TimeColumn("samples_seen", sequence=record.samples_seen),
        ]
        before = self._last or Moment(0, 0.0)
        ends = int(record.samples_seen[-1]), float(record.time[-1])
        self._last = Moment(max(before.samples_seen, ends[0]), max(before.time, ends[1]))
        columns = rr.Scalars.columns(scalars=record.values.ravel()).partition([number] * len(record.values))
        self._stream.send_columns(entity, indexes, columns, strict=True)

    def _send(self, entity: str, at: Moment | None, columns: Any) -> None:
        indexes: list[Any] = []
        if at is not None:
            indexes = [
                rr.TimeColumn("time", duration=[at.time]),
                rr.TimeColumn("samples_seen", sequence=[at.samples_seen]),
            ]
        self._stream.send_columns(entity, indexes, columns, strict=True)

    def _grow(self, points: np.ndarray) -> None:
        flat = points.reshape(-1, 2)
        corners = np.stack([flat.min(axis=0), flat.max(axis=0)])
        if self._extent is not None:
            corners = np.stack([np.minimum(corners[0], self._extent[0]), np.maximum(corners[1], self._extent[1])])
        self._extent = corners

    def _send_layout(self) -> None:
        if self._layout is None:
            return
        bounds = None
        if self._extent is not None:
            (left, bottom), (right, top) = self._extent.tolist()
            bounds = ((left, bottom), (right, top))
        self._stream.send_blueprint(viewer_blueprint(self._layout, bounds, self._last, self._sensed))

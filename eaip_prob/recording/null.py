"""The logger that keeps nothing."""

from __future__ import annotations

from pathlib import Path

from eaip_prob.recording.base import AbstractRunLogger
from eaip_prob.recording.records import Record
from eaip_prob.recording.scene_records import SceneRecord
from eaip_prob.recording.sensor_records import SensorRecord


class NullLogger(AbstractRunLogger):
    """Accepts every call, with the same checks, and keeps nothing.

    Args:
        path: ignored, as are the others: either logger is built with the same arguments.
        application_id: ignored.
        recording_id: ignored.

    Example:
        >>> with NullLogger() as logger:
        ...     logger.text("metrics", "nothing is kept")
    """

    def __init__(
        self, path: str | Path | None = None, application_id: str = "", recording_id: str | None = None
    ) -> None:
        del path, application_id, recording_id

    def _write(self, record: Record | SensorRecord | SceneRecord) -> None:
        del record

    def _finish(self) -> None:
        return

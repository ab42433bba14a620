"""How a logger stores records and ends."""

from __future__ import annotations

from abc import ABC, abstractmethod
from types import TracebackType
from typing import Self

from eaip_prob.errors import InputError
from eaip_prob.recording.records import Record
from eaip_prob.recording.scene_records import SceneRecord
from eaip_prob.recording.sensor_records import SensorRecord


class AbstractRecorder(ABC):
    """Stores checked records until it is closed; the calls that make records are in the classes derived from it."""

    _closed = False

    @abstractmethod
    def _write(self, record: Record | SensorRecord | SceneRecord) -> None:
        """Stores one record."""

    @abstractmethod
    def _finish(self) -> None:
        """Completes the recording."""

    def close(self) -> None:
        """Completes the recording; later calls to `close` do nothing."""
        if not self._closed:
            self._closed = True
            self._finish()

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    def _record(self, record: Record | SensorRecord | SceneRecord) -> None:
        if self._closed:
            raise InputError("Expected an open logger, got one that was closed. Record inside its `with` block.")
        self._write(record)

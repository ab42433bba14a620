"""What a run leaves behind to be looked at: paths, signals with intervals, phase, scores and text over time.

Library and experiments record through `AbstractRunLogger`; `RerunLogger` writes a file that the rerun viewer opens
with a layout of its own, `NullLogger` accepts the same calls and keeps nothing. Only `recording.rerun_logger`,
`recording.rerun_sensors`, `recording.rerun_scene` and `recording.layout` import rerun, when `RerunLogger` is first
asked for.

Where things are stored in a recording:

==========================  =================================================================================
``plane/ENTITY``            2-D paths and boxes, in the caller's unit (px), y up
``space/ENTITY``            3-D paths, boxes, surfaces, clouds, markers and ellipsoids, m, z up; cameras with
                            their images and the boxes found in them
``plots/ENTITY``            curves: signals, intervals, phase, scores
``report/ENTITY``           Markdown
``arrays/ENTITY``           tensors: the data behind a figure
==========================  =================================================================================

Two timelines index what changes: ``time`` (seconds) and ``samples_seen`` (how many samples of the partner had been
seen). Values under ``plane`` are stored as given, with y up; because the viewer's 2-D view has y down, ``plane`` itself
carries one constant transform that mirrors y, and the picture stands upright.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from eaip_prob.recording.base import AbstractRunLogger
from eaip_prob.recording.null import NullLogger
from eaip_prob.recording.records import Moment

if TYPE_CHECKING:
    from eaip_prob.recording.rerun_logger import RerunLogger

__all__ = ["AbstractRunLogger", "Moment", "NullLogger", "RerunLogger"]


def __getattr__(name: str) -> Any:
    if name != "RerunLogger":
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    from eaip_prob.recording.rerun_logger import RerunLogger

    return RerunLogger

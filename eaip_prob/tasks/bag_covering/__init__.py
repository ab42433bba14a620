"""Sec. 4.2 of the paper: a person and a robot cover large objects with a bag, from pixels to motion."""

from eaip_prob.tasks.bag_covering.cases import Case, Room
from eaip_prob.tasks.bag_covering.demonstrating import demonstrated
from eaip_prob.tasks.bag_covering.faults import Faults
from eaip_prob.tasks.bag_covering.judging import Clearance, Judge
from eaip_prob.tasks.bag_covering.loop import CoveringLoop, LoopReport, LoopState
from eaip_prob.tasks.bag_covering.motion import Covering, planned
from eaip_prob.tasks.bag_covering.outcome import KINDS, Run, ended
from eaip_prob.tasks.bag_covering.people import Partner
from eaip_prob.tasks.bag_covering.perceiving import (
    AbstractPerception,
    Instant,
    KinectPerception,
    OraclePerception,
    Sighting,
)
from eaip_prob.tasks.bag_covering.recorded import (
    RecordedCovering,
    demonstration_set,
    load_recorded,
    save_recorded,
    shipped,
)
from eaip_prob.tasks.bag_covering.site import Site
from eaip_prob.tasks.bag_covering.trial import Looks, Step, Trial

__all__ = [
    "KINDS",
    "AbstractPerception",
    "Case",
    "Clearance",
    "Covering",
    "CoveringLoop",
    "Faults",
    "Instant",
    "Judge",
    "KinectPerception",
    "Looks",
    "LoopReport",
    "LoopState",
    "OraclePerception",
    "Partner",
    "RecordedCovering",
    "Room",
    "Run",
    "Sighting",
    "Site",
    "Step",
    "Trial",
    "demonstrated",
    "demonstration_set",
    "ended",
    "load_recorded",
    "planned",
    "save_recorded",
    "shipped",
]

"""Sec. 4.2.1 of the paper: a detector of furniture, trained on rendered views, and tried while objects are covered."""

from eaip_prob.tasks.detection.consequence import ENVIRONMENTS, Lift, consequence
from eaip_prob.tasks.detection.covering import AbstractCoveringViews, CoveringViews, Placement
from eaip_prob.tasks.detection.feature_study import feature_study
from eaip_prob.tasks.detection.study import PAPER, ObjectScores, Sighting, by_cover, sighting, table_1

__all__ = [
    "ENVIRONMENTS",
    "PAPER",
    "AbstractCoveringViews",
    "CoveringViews",
    "Lift",
    "ObjectScores",
    "Placement",
    "Sighting",
    "by_cover",
    "consequence",
    "feature_study",
    "sighting",
    "table_1",
]

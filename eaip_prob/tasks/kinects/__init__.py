"""Sec. 4.2 of the paper: three Kinects watch a person cover furniture with a bag, and follow both gloves."""

from eaip_prob.tasks.kinects.paths import MOTIONS, HandPath, hand_path
from eaip_prob.tasks.kinects.scenario import Scenario
from eaip_prob.tasks.kinects.study import TrackingScores, followed, tracking_scores

__all__ = ["MOTIONS", "HandPath", "Scenario", "TrackingScores", "followed", "hand_path", "tracking_scores"]

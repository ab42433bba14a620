"""Demonstrations: trajectories of two agents and features of the scene; reading, saving and resampling them."""

from eaip_prob.data.demonstrations import AGENTS, Demonstration, DemonstrationSet
from eaip_prob.data.environment import EnvironmentFeatures, stack_environments
from eaip_prob.data.feature_map import AbstractFeatureMap
from eaip_prob.data.features import DistanceFeatures, QuadraticFeatures, RawFeatures
from eaip_prob.data.frames import Intrinsics, RGBDFrame
from eaip_prob.data.handover import read_handover
from eaip_prob.data.reach_to_grasp import read_reach_to_grasp
from eaip_prob.data.resampling import held, resample, resampled_at_rate, time_normalised
from eaip_prob.data.storage import load, save
from eaip_prob.data.trajectory import Trajectory, stack

__all__ = [
    "AGENTS",
    "AbstractFeatureMap",
    "Demonstration",
    "DemonstrationSet",
    "DistanceFeatures",
    "EnvironmentFeatures",
    "Intrinsics",
    "QuadraticFeatures",
    "RGBDFrame",
    "RawFeatures",
    "Trajectory",
    "held",
    "load",
    "read_handover",
    "read_reach_to_grasp",
    "resample",
    "resampled_at_rate",
    "save",
    "stack",
    "stack_environments",
    "time_normalised",
]

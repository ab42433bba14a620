"""What real cameras need as much as simulated ones: calibration, registration, fusion, and the gloves of a person."""

from eaip_prob.perception.board import BoardCorners, CharucoBoard, detect_board
from eaip_prob.perception.board_view import BoardView
from eaip_prob.perception.calibration import calibrate
from eaip_prob.perception.calibration_file import load_extrinsics, save_extrinsics
from eaip_prob.perception.drift import Drift, drift
from eaip_prob.perception.extrinsics import Extrinsics, PoseError, workspace_error
from eaip_prob.perception.fusion import PointCloud, clusters, from_open3d, fuse, inliers, to_open3d
from eaip_prob.perception.glove_mask import GloveColor
from eaip_prob.perception.gloves import GloveTracker, GloveTracks
from eaip_prob.perception.hands import AbstractHandTracker, HandState, hands_to_trajectory
from eaip_prob.perception.lens_std import LensStd
from eaip_prob.perception.posing import posed
from eaip_prob.perception.registration import color_at, depth_colors, registered

__all__ = [
    "AbstractHandTracker",
    "BoardCorners",
    "BoardView",
    "CharucoBoard",
    "Drift",
    "Extrinsics",
    "GloveColor",
    "GloveTracker",
    "GloveTracks",
    "HandState",
    "LensStd",
    "PointCloud",
    "PoseError",
    "calibrate",
    "clusters",
    "color_at",
    "depth_colors",
    "detect_board",
    "drift",
    "from_open3d",
    "fuse",
    "hands_to_trajectory",
    "inliers",
    "load_extrinsics",
    "posed",
    "registered",
    "save_extrinsics",
    "to_open3d",
    "workspace_error",
]

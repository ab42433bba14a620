"""Simulated scenes and cameras: furniture, people, a robot, ray-cast images, and the noise of depth cameras."""

from eaip_prob.simulation.clip import Clip
from eaip_prob.simulation.four_legs import Chair, Table
from eaip_prob.simulation.furniture import AbstractObject, Bookshelf, FoldingTable, OfficeChair, Stepladder
from eaip_prob.simulation.kinect import Kinect, KinectModel, Rig, looking_at, render_rgbd
from eaip_prob.simulation.kinect_noise import KinectNoise, camera_generators
from eaip_prob.simulation.mesh_file import MeshFile
from eaip_prob.simulation.meshes import Mesh, box, cylinder, ellipsoid, joined, picture, revolved, sheet, tube
from eaip_prob.simulation.oracle import LabelledFrame, OracleDetector, TrueObject, render_labelled
from eaip_prob.simulation.person import Person, bent
from eaip_prob.simulation.render import Labels, Lighting, View, render_color, render_depth
from eaip_prob.simulation.robot import Bag, BaxterShape
from eaip_prob.simulation.scene import NOTHING, Part, Scene
from eaip_prob.simulation.workspace import Workspace

__all__ = [
    "NOTHING",
    "AbstractObject",
    "Bag",
    "BaxterShape",
    "Bookshelf",
    "Chair",
    "Clip",
    "FoldingTable",
    "Kinect",
    "KinectModel",
    "KinectNoise",
    "LabelledFrame",
    "Labels",
    "Lighting",
    "Mesh",
    "MeshFile",
    "OfficeChair",
    "OracleDetector",
    "Part",
    "Person",
    "Rig",
    "Scene",
    "Stepladder",
    "Table",
    "TrueObject",
    "View",
    "Workspace",
    "bent",
    "box",
    "camera_generators",
    "cylinder",
    "ellipsoid",
    "joined",
    "looking_at",
    "picture",
    "render_color",
    "render_depth",
    "render_labelled",
    "render_rgbd",
    "revolved",
    "sheet",
    "tube",
]

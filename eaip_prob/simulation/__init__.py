"""Simulated scenes and cameras: furniture, people, a robot, ray-cast images, and the noise of depth cameras."""

from eaip_prob.simulation.clip import Clip
from eaip_prob.simulation.cloth import ClothBag, ClothState
from eaip_prob.simulation.cloth_contact import Obstacle
from eaip_prob.simulation.cloth_mesh import BagMesh
from eaip_prob.simulation.coverage import covered_points, surface_points
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
    "BagMesh",
    "BaxterShape",
    "Bookshelf",
    "Chair",
    "Clip",
    "ClothBag",
    "ClothState",
    "FoldingTable",
    "Kinect",
    "KinectModel",
    "KinectNoise",
    "LabelledFrame",
    "Labels",
    "Lighting",
    "Mesh",
    "MeshFile",
    "Obstacle",
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
    "covered_points",
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
    "surface_points",
    "tube",
]

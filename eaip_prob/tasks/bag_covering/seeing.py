"""What an ideal camera and tracker would say of a trial, with errors of known size: perception without rendering."""

from __future__ import annotations

import numpy as np
import torch
from jaxtyping import Float

from eaip_prob.data import Trajectory
from eaip_prob.perception.hands import HANDS
from eaip_prob.simulation import Kinect, LabelledFrame, Part, Scene
from eaip_prob.simulation.oracle import TrueObject, true_object
from eaip_prob.tasks.bag_covering.site import Site

TRACKING_STD = 0.0015  # m; experiments/kinects.py: 1.4 mm median
HAND_NAMES = tuple(f"{hand}_{axis}" for hand in HANDS for axis in "xyz")
ROBOT_NAMES = ("x", "y", "z")


def labelled_frame(site: Site, camera: Kinect, time: float = 0.0) -> LabelledFrame:
    """A frame that shows nothing, and knows where the object of a site is in the colour image of a camera.

    Args:
        site: the object in its place.
        camera: the unit, such as Kinect 3.
        time: s.

    Example:
        >>> from eaip_prob.data.frames import Intrinsics
        >>> from eaip_prob.simulation import Bookshelf, KinectModel, Workspace, looking_at
        >>> shelf = Bookshelf(0.4, 0.3, 0.9, 2, 0.018, (0.4, 0.25, 0.15), (0.3, 0.2, 0.1))
        >>> small = Intrinsics(96, 54, 53.0, 53.0, 48.0, 27.0)
        >>> pose = looking_at((0.55, -1.75, 1.15), (0.95, 0, -0.15))
        >>> unit = Kinect("right", KinectModel(small, small, (-0.05, 0, 0)), pose)
        >>> labelled_frame(Site("shelf", "bookshelf", Workspace(shelf)), unit).objects[0].label
        'bookshelf'
    """
    found = true_object(Scene([Part("thing", site.mesh)]), camera.color_view, "thing", site.label)
    return frame_of_truth(found, camera, time)


def frame_of_truth(truth: TrueObject | None, camera: Kinect, time: float = 0.0) -> LabelledFrame:
    """A frame that shows nothing, and knows an object; None for nothing in view.

    Args:
        truth: of the object.
        camera: the unit.
        time: s.
    """
    color, depth = camera.model.color_camera, camera.model.depth
    return LabelledFrame(
        color=np.zeros((color.height, color.width, 3), np.uint8),
        depth=np.zeros((depth.height, depth.width), np.float32),
        valid=np.zeros((depth.height, depth.width), bool),
        intrinsics=depth,
        T_world_camera=camera.T_world_camera,
        time=time,
        color_intrinsics=color,
        T_color_depth=camera.model.T_color_depth,
        name=camera.name,
        objects=() if truth is None else (truth,),
    )


def tracked(
    time: Float[np.ndarray, "time"],
    hands: Float[np.ndarray, "time 2 3"],
    generator: np.random.Generator,
    std: float = TRACKING_STD,
) -> Trajectory:
    """Both hands as a tracker reports them: with white errors of a known size, all seen.

    Args:
        time: (T,), s.
        hands: (T, 2, 3), m.
        generator: of the errors.
        std: of the errors, m.

    Example:
        >>> tracked(np.arange(3.0), np.zeros((3, 2, 3)), np.random.default_rng(0)).names[:2]
        ('left_x', 'left_y')
    """
    seen = hands + std * generator.standard_normal(hands.shape)
    noise = np.tile(std**2 * np.eye(6), (len(time), 1, 1))
    return Trajectory(
        torch.from_numpy(np.asarray(time, float)),
        torch.from_numpy(seen.reshape(len(time), 6)),
        HAND_NAMES,
        noise=torch.from_numpy(noise),
    )


def led(time: Float[np.ndarray, "time"], gripper: Float[np.ndarray, "time 3"]) -> Trajectory:
    """The path of the robot's left gripper, x, y, z, m.

    Args:
        time: (T,), s.
        gripper: (T, 3), m.

    Example:
        >>> led(np.arange(2.0), np.zeros((2, 3))).names
        ('x', 'y', 'z')
    """
    return Trajectory(torch.from_numpy(np.asarray(time, float)), torch.from_numpy(np.array(gripper)), ROBOT_NAMES)

"""Kinect v2 cameras in their places, and the frames that they deliver.

The colour camera sits beside the depth camera and sees from there: colour is rendered from its own place.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from jaxtyping import Float

from eaip_prob.data.frames import MAX_DEPTH, Intrinsics, RGBDFrame, inverse
from eaip_prob.errors import InputError, ShapeError
from eaip_prob.simulation.render import Labels, Lighting, View, render_color, render_depth
from eaip_prob.simulation.scene import Scene


@dataclass(frozen=True)
class KinectModel:
    """Both cameras of one unit.

    Args:
        depth: depth camera.
        color: colour camera, at its full resolution.
        baseline: (3,), where the depth camera's origin is for the colour camera, m.
        rotation: (3,), rotation vector from the depth to the colour camera, degrees.
        color_size: (width, height) to which colour is reduced; full if None.

    Raises:
        ShapeError: a baseline or rotation of another length.

    Example:
        >>> depth = Intrinsics(512, 424, 365.0, 365.0, 255.0, 205.0)
        >>> color = Intrinsics(1920, 1080, 1060.0, 1058.0, 956.0, 519.0)
        >>> KinectModel(depth, color, (-0.0519, 0.0, 0.0), color_size=(480, 270)).color_camera.fx
        265.0
    """

    depth: Intrinsics
    color: Intrinsics
    baseline: Sequence[float]
    rotation: Sequence[float] = (0.0, 0.0, 0.0)
    color_size: Sequence[int] | None = None

    def __post_init__(self) -> None:
        for name in ("baseline", "rotation"):
            if np.shape(getattr(self, name)) != (3,):
                raise ShapeError(f"Expected {name} with shape (3,), got {np.shape(getattr(self, name))}.")

    @cached_property
    def color_camera(self) -> Intrinsics:
        """The colour camera at the resolution used."""
        return self.color if self.color_size is None else self.color.scaled(*self.color_size)

    @cached_property
    def T_color_depth(self) -> Float[np.ndarray, "4 4"]:  # noqa: N802  # the name of the frame's field
        """Maps coordinates of the depth camera into those of the colour camera."""
        from scipy.spatial.transform import Rotation

        T = np.eye(4)
        T[:3, :3] = Rotation.from_rotvec(np.asarray(self.rotation, float), degrees=True).as_matrix()
        T[:3, 3] = self.baseline
        return T


@dataclass(frozen=True, eq=False)
class Kinect:
    """One unit in its place; the rays of its cameras are computed once.

    Args:
        name: of the unit.
        model: its cameras.
        T_world_camera: (4, 4), maps coordinates of the depth camera into the world.

    Example:
        >>> camera = Intrinsics(8, 6, 8.0, 8.0, 3.5, 2.5)
        >>> unit = Kinect("left", KinectModel(camera, camera, (-0.05, 0, 0)), np.eye(4))
        >>> unit.color_view.T_world_camera[:3, 3].tolist()
        [0.05, 0.0, 0.0]
    """

    name: str
    model: KinectModel
    T_world_camera: Float[np.ndarray, "4 4"]

    @cached_property
    def depth_view(self) -> View:
        """The depth camera in its place."""
        return View(self.model.depth, self.T_world_camera)

    @cached_property
    def color_view(self) -> View:
        """The colour camera in its place."""
        return View(self.model.color_camera, self.T_world_camera @ inverse(self.model.T_color_depth))


@dataclass(frozen=True)
class Rig:
    """Where the cameras of a room stand and what they look at; upright, as cameras on tripods or beams are.

    Args:
        positions: name -> (3,), in the world, m.
        targets: name -> (3,), a point in the middle of the image, m.

    Raises:
        InputError: other names in one than in the other, or a camera that looks straight up or down.

    Example:
        >>> rig = Rig({"left": (1.0, 2.0, 0.0)}, {"left": (1.0, 0.0, 0.0)})
        >>> rig.poses()["left"][:3, 2].tolist()
        [0.0, -1.0, 0.0]
    """

    positions: Mapping[str, Sequence[float]]
    targets: Mapping[str, Sequence[float]]

    def __post_init__(self) -> None:
        if set(self.positions) != set(self.targets) or not self.positions:
            raise InputError(
                f"Expected a target for each camera, got positions of {sorted(self.positions)} and targets of "
                f"{sorted(self.targets)}."
            )
        self.poses()

    def poses(self) -> dict[str, Float[np.ndarray, "4 4"]]:
        """T_world_camera of each camera, in the order of `positions`."""
        return {name: looking_at(self.positions[name], self.targets[name]) for name in self.positions}

    def cameras(self, model: KinectModel) -> tuple[Kinect, ...]:
        """A unit of one model in each place."""
        return tuple(Kinect(name, model, pose) for name, pose in self.poses().items())


def looking_at(position: Sequence[float], target: Sequence[float]) -> Float[np.ndarray, "4 4"]:
    """T_world_camera of an upright camera at a place, with a point in the middle of its image.

    Args:
        position: (3,), m.
        target: (3,), m.

    Raises:
        InputError: the same place twice, or a camera that looks straight up or down.

    Example:
        >>> looking_at((0.0, 0.0, 1.0), (1.0, 0.0, 1.0))[:3, :3].tolist()  # image right is -y, image down is -z
        [[0.0, 0.0, 1.0], [-1.0, 0.0, 0.0], [0.0, -1.0, 0.0]]
    """
    forward = np.asarray(target, float) - np.asarray(position, float)
    right = np.array([forward[1], -forward[0], 0.0])
    if np.linalg.norm(right) < 1e-6:
        raise InputError(
            f"Expected a camera at {list(position)} that looks sideways at least a little, got the target "
            f"{list(target)}. Shift the target."
        )
    forward, right = forward / np.linalg.norm(forward), right / np.linalg.norm(right)
    T = np.eye(4)
    T[:3, :3] = np.column_stack([right, np.cross(forward, right), forward]) + 0.0
    T[:3, 3] = position
    return T


def render_rgbd(
    scene: Scene, camera: Kinect, time: float, lighting: Lighting | None = None
) -> tuple[RGBDFrame, Labels]:
    """One frame without noise, and what each pixel of its depth image truly shows.

    Args:
        scene: what is there.
        camera: which unit.
        time: s.
        lighting: as `Lighting()` if None.

    Example:
        >>> from eaip_prob.simulation import Part, box
        >>> small = Intrinsics(8, 6, 8.0, 8.0, 3.5, 2.5)
        >>> scene = Scene([Part("wall", box((9.0, 9.0, 1.0), (1, 0, 0)).at(z=2.5))])
        >>> frame, labels = render_rgbd(scene, Kinect("left", KinectModel(small, small, (-0.05, 0, 0)), np.eye(4)), 0.0)
        >>> bool(frame.valid.all()), float(frame.depth.max())
        (True, 2.0)
    """
    labels = render_depth(scene, camera.depth_view)
    frame = RGBDFrame(
        color=render_color(scene, camera.color_view, lighting),
        depth=np.where(labels.hit, labels.depth, np.float32(0.0)),
        valid=labels.hit & (labels.depth < MAX_DEPTH),
        intrinsics=camera.model.depth,
        T_world_camera=camera.T_world_camera,
        time=time,
        color_intrinsics=camera.model.color_camera,
        T_color_depth=camera.model.T_color_depth,
        name=camera.name,
    )
    return frame, labels

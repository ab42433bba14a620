"""What can be shown of a run beside what it kept: the robot's and the partner's bodies, and what the cameras see."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Bool, Float

from eaip_prob.data.frames import RGBDFrame
from eaip_prob.robot import baxter_left_arm, baxter_right_arm, follow, link_points
from eaip_prob.simulation import Kinect, KinectNoise, Mesh, Part, Scene, camera_generators
from eaip_prob.simulation.oracle import render_labelled
from eaip_prob.tasks.bag_covering.perceiving import AbstractPerception, Instant
from eaip_prob.tasks.bag_covering.site import Site

COLOR_SIZE = (480, 270)  # px


@dataclass(frozen=True, eq=False)
class RobotBodies:
    """The robot's outline over time, in a part that stands still and one that moves.

    Args:
        meshes: of the whole robot, at some of the times; the same triangles of the same colours.
        moves: (F,), which triangles ever move.
        every: times from one mesh to the next.
    """

    meshes: Sequence[Mesh]
    moves: Bool[np.ndarray, "faces"]
    every: int = 1

    @property
    def still(self) -> Mesh:
        """What stands still."""
        return _part(self.meshes[0], ~self.moves)

    def whole(self, number: int) -> Mesh:
        """The robot at one of the times, or at the last before it that there is a mesh of.

        Args:
            number: of the time.
        """
        return self.meshes[number // self.every]

    def moving(self, number: int) -> Mesh:
        """What moves, at that time.

        Args:
            number: of the time.
        """
        return _part(self.whole(number), self.moves)


def robot_bodies(site: Site, grippers: Float[np.ndarray, "time hands 3"], every: int = 1) -> RobotBodies | None:
    """The robot as its joints lead the left gripper along its path; None where the room has no robot.

    Args:
        site: of the run.
        grippers: (T, 2, 3), left and right one over time, m; the right one stays where it is first.
        every: times from one mesh to the next.

    Example:
        >>> from eaip_prob.simulation import Bookshelf, Workspace
        >>> shelf = Bookshelf(0.4, 0.3, 0.9, 2, 0.018, (0.4, 0.25, 0.15), (0.3, 0.2, 0.1))
        >>> tips = np.array([[[0.42, -0.6, height], [0.42, -0.74, -0.5]] for height in (-0.15, 0.1)])
        >>> bodies = robot_bodies(Site("shelf", "bookshelf", Workspace(shelf)), tips)
        >>> bool(bodies.still.extent()[0, 2] < -0.9), bool(bodies.moves.any())
        (True, True)
    """
    robot = site.room.robot
    if robot is None:
        return None
    left = link_points(baxter_left_arm(), follow(baxter_left_arm(), grippers[:, 0]).joints[::every])
    right = link_points(baxter_right_arm(), follow(baxter_right_arm(), grippers[:1, 1]).joints[0])
    meshes = [robot.mesh(tips, [points, right]) for tips, points in zip(grippers[::every], left, strict=True)]
    vertices = np.stack([mesh.vertices for mesh in meshes])
    return RobotBodies(meshes, (np.ptp(vertices, axis=0) > 0.0).any(-1)[meshes[0].triangles].any(-1), every)


def partner_meshes(site: Site, hands: Float[np.ndarray, "hands 3"]) -> dict[str, Mesh]:
    """Body and gloves of the partner.

    Args:
        site: of the run.
        hands: (2, 3), left and right one, m.
    """
    room = site.room
    return room.person.meshes(hands, (*room.person_position, room.floor))


class Cameras:
    """The cameras of a run, rendered anew with noise, as small as is enough to look at.

    Args:
        perception: of the run.
        site: the object in its place.
        seed: of the noise.
    """

    def __init__(self, perception: AbstractPerception, site: Site, seed: int) -> None:
        self.site = site
        self.units = tuple(_reduced(unit) for unit in perception.cameras)
        self._noise = KinectNoise()
        self._generators = camera_generators([seed, 5], [unit.name for unit in self.units])

    def frames(self, instant: Instant, robot: Mesh | None) -> Iterator[RGBDFrame]:
        """A frame of each camera.

        Args:
            instant: how things are.
            robot: as it stands; None where there is none.
        """
        scene = self.site.room.scene(instant.hands, instant.grippers, bag=instant.bag)
        if robot is not None:
            scene = Scene([Part("robot", robot) if part.name == "robot" else part for part in scene.parts])
        for unit in self.units:
            frame, labels = render_labelled(scene, unit, instant.time, {"thing": self.site.label})
            yield self._noise.apply(frame, labels, self._generators[unit.name])


def _reduced(unit: Kinect) -> Kinect:
    return Kinect(unit.name, replace(unit.model, color_size=COLOR_SIZE), unit.T_world_camera)


def _part(mesh: Mesh, faces: Bool[np.ndarray, "faces"]) -> Mesh:
    used, triangles = np.unique(mesh.triangles[faces], return_inverse=True)
    return Mesh(mesh.vertices[used], triangles.reshape(-1, 3).astype(np.int32), mesh.color[faces])

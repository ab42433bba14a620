"""What Kinect 3 sees while a demonstrator and a partner carry the simulated bag over an object: Table 1 with cloth.

Unlike the sheet of `eaip_prob.tasks.detection.CoveringViews`, the bag lies at the object's feet from the beginning, and
hides most of it soon after: it is carried across the camera's line of sight.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

from eaip_prob.simulation.oracle import LabelledFrame
from eaip_prob.tasks.bag_covering.cases import Case
from eaip_prob.tasks.bag_covering.demonstrating import instants
from eaip_prob.tasks.bag_covering.motion import RATE
from eaip_prob.tasks.detection import AbstractCoveringViews


@dataclass(frozen=True, eq=False)
class ClothViews(AbstractCoveringViews):
    """The frames of one camera over one demonstration with the simulated bag.

    Args:
        case: the trial.

    Raises:
        InputError: fewer than two frames.
    """

    case: Case

    def key(self) -> str:
        """As in `AbstractCoveringViews`; delete kept views when the cloth's physics change."""
        site, motion = self.case.site, self.case.motion
        mesh, room = site.mesh, site.room
        return self.digest(
            (room.person, room.robot, room.floor, room.floor_color, room.tile, room.person_position),
            *(mesh.vertices, mesh.triangles, mesh.color, motion.time, motion.hands, motion.gripper, motion.still),
        )

    def render(self) -> Iterator[LabelledFrame]:
        """As in `AbstractCoveringViews`; each frame at the step of the simulation next to its time."""
        duration, generator = self.case.motion.duration, self.generator()
        shares = {round(share * duration * RATE): float(share) for share in self.share}
        for instant in instants(self.case, RATE):
            share = shares.get(round(instant.time * RATE))
            if share is not None:
                scene = self.case.site.room.scene(instant.hands, instant.grippers, bag=instant.bag)
                yield self.shown(scene, share, generator)

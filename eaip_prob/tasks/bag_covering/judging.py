"""What counts as covered, and as a collision. Fixed before any method was run.

A run is a success if the plan was executed to the end, at least `COVERED` of the object's surface points above
`ABOVE` (above half of its height where it is lower than `LOW`) lie under the cloth, and the left gripper, the left
forearm and the carried lip, the straight line between the left gripper and the partner's right hand, kept `CLEAR` from
the object while the robot moved.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from jaxtyping import Bool, Float

from eaip_prob.robot import ArmSpheres, SerialArm, follow
from eaip_prob.simulation import Mesh
from eaip_prob.simulation.coverage import covered_points, surface_points
from eaip_prob.tasks.bag_covering.site import Site

COVERED = 0.8
ABOVE, LOW = 0.35, 0.5  # m above the floor
CLEAR = 0.02  # m
_POINTS, _LIP_POINTS = 2000, 25


@dataclass(frozen=True, eq=False)
class Clearance:
    """How near the robot and the lip came to the object.

    Args:
        lip: (T,), smallest distance of the carried lip, m.
        arm: (T,), smallest distance of gripper and forearm, m; infinite where the arm cannot be there.
        reached: (T,), whether the arm can be there.
    """

    lip: Float[np.ndarray, "time"]
    arm: Float[np.ndarray, "time"]
    reached: Bool[np.ndarray, "time"]

    @property
    def smallest(self) -> Float[np.ndarray, "time"]:
        """Of lip and arm, m."""
        return np.minimum(self.lip, self.arm)

    def collides(self, counted: Bool[np.ndarray, "time"] | None = None) -> bool:
        """Whether something came nearer than `CLEAR`.

        Args:
            counted: (T,), times that count; all if None.
        """
        near = self.smallest < CLEAR
        return bool((near if counted is None else near & counted).any())


class Judge:
    """Distances from, and cover of, one object in its place.

    Args:
        site: the object in its place.
        arm: the robot's left arm.
        seed: of the surface points.
    """

    def __init__(self, site: Site, arm: SerialArm, seed: int = 0) -> None:
        self.site, self.arm = site, arm
        self._tracer = _tracer(site.mesh)
        points = surface_points(site.mesh, _POINTS, np.random.default_rng(seed))
        height, floor = site.high[2] - site.low[2], site.low[2]
        above = ABOVE if height >= LOW else height / 2.0
        self.points = points[points[:, 2] > floor + above]

    def clearance(self, gripper: Float[np.ndarray, "time 3"], hand: Float[np.ndarray, "time 3"]) -> Clearance:
        """Of a path of the left gripper while the partner's right hand moves along another.

        Args:
            gripper: (T, 3), m.
            hand: (T, 3), at the same times, m.
        """
        share = np.linspace(0.0, 1.0, _LIP_POINTS)[:, None]
        lip = gripper[:, None] + share * (hand - gripper)[:, None]
        found = follow(self.arm, gripper)
        spheres = ArmSpheres.baxter()
        arm = (self._distance(spheres.centers(self.arm, found.joints)) - spheres.radii).min(-1)
        return Clearance(self._distance(lip).min(-1), np.where(found.reached, arm, np.inf), found.reached)

    def covered(self, bag: Mesh) -> float:
        """Share of the counted surface points that lie under the cloth.

        Args:
            bag: the cloth.
        """
        middle = (self.site.low + self.site.high) / 2.0
        return float(covered_points(self.points, bag, middle[:2].tolist()).mean())

    def _distance(self, points: Float[np.ndarray, "*batch 3"]) -> Float[np.ndarray, "*batch"]:
        import open3d

        query = np.ascontiguousarray(points, np.float32)
        return self._tracer.compute_distance(open3d.core.Tensor.from_numpy(query)).numpy().astype(float)


def _tracer(mesh: Mesh) -> Any:
    import open3d

    tracer = open3d.t.geometry.RaycastingScene()
    vertices = open3d.core.Tensor.from_numpy(np.ascontiguousarray(mesh.vertices, np.float32))
    tracer.add_triangles(vertices, open3d.core.Tensor.from_numpy(np.ascontiguousarray(mesh.triangles, np.uint32)))
    return tracer

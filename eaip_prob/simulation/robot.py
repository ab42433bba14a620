"""A robot with Baxter's outline, and the bag that it and its partner hold."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from eaip_prob.errors import ShapeError
from eaip_prob.simulation.furniture import check_lengths
from eaip_prob.simulation.meshes import Color, Mesh, box, cylinder, joined, sheet, tube
from eaip_prob.simulation.person import bent


@dataclass(frozen=True)
class BaxterShape:
    """Torso, head and two arms of capsules, whose grippers are where they are told to be.

    Where nothing is said of the arms, two links take Baxter's lengths (shoulder to elbow 0.37 m, elbow to gripper
    0.37 + 0.25 m), whatever the joints allow; `eaip_prob.robot.link_points` gives arms as joint angles hold them.

    Args:
        floor: height of the floor below the robot's base, m (negative).
        shoulder_height: m.
        color: of arms and head, RGB from 0 to 1.
        body_color: of torso and pedestal, RGB from 0 to 1.

    Example:
        >>> mesh = BaxterShape().mesh(np.array([[0.7, 0.3, 0.2], [0.7, -0.3, 0.2]]))
        >>> float(mesh.extent()[0, 2].round(2))
        -0.93
    """

    floor: float = -0.93
    shoulder_height: float = 0.33
    color: Color = (0.55, 0.12, 0.12)
    body_color: Color = (0.25, 0.26, 0.28)

    def mesh(
        self, grippers: Float[np.ndarray, "hands 3"], arms: Sequence[Float[np.ndarray, "points 3"]] | None = None
    ) -> Mesh:
        """The robot at the origin of the world.

        Args:
            grippers: (2, 3), tips of the left and the right gripper, m; not looked at where arms are given.
            arms: the left and the right arm, each (any, 3): corners of the line from the shoulder to the tip, of which
                the last three are wrist, hand and tip, m. None bends two links towards each gripper.

        Raises:
            ShapeError: grippers or arms of another shape.
        """
        grippers = np.asarray(grippers, float)
        if grippers.shape != (2, 3):
            raise ShapeError(f"Expected grippers with shape (2, 3), left then right, got {grippers.shape}.")
        parts = [
            cylinder(0.36, 0.06, self.body_color, sides=24).at(z=self.floor),
            cylinder(0.13, -self.floor - 0.05, self.body_color).at(x=-0.05, z=self.floor + 0.05),
            box((0.22, 0.36, 0.52), self.body_color).at(-0.02, 0.0, 0.16),
            tube((0.0, 0.0, 0.4), (0.05, 0.0, 0.62), 0.05, self.body_color),
            box((0.05, 0.30, 0.20), self.color).at(0.11, 0.0, 0.66),
        ]
        if arms is not None:
            return joined([*parts, *(link for points in _checked_arms(arms) for link in self._links(points))])
        for gripper, side in zip(grippers, (1.0, -1.0), strict=True):
            parts += self._arm(np.array([0.06, side * 0.26, self.shoulder_height]), gripper, side)
        return joined(parts)

    def _links(self, points: np.ndarray) -> list[Mesh]:
        # Radii and the end of the wrist's cylinder are those of the collision model in baxter.urdf; the gripper's is a
        # guess.
        wrist, hand, tip = points[-3:]
        cuff = wrist + 0.6 * (hand - wrist)
        links = [tube(a, b, 0.06, self.color, rounded=True) for a, b in zip(points[:-3], points[1:-2], strict=True)]
        return [
            *links,
            tube(wrist, cuff, 0.06, self.color, rounded=True),
            tube(cuff, hand, 0.04, self.body_color),
            tube(hand, tip, 0.025, self.body_color),
        ]

    def _arm(self, shoulder: np.ndarray, gripper: np.ndarray, side: float) -> list[Mesh]:
        elbow = bent(shoulder, gripper, 0.37, 0.62, towards=np.array([-0.3, side, 0.2]))
        wrist = elbow + (gripper - elbow) * 0.8
        return [
            tube(np.array([0.0, side * 0.12, shoulder[2]]), shoulder, 0.08, self.body_color, rounded=True),
            tube(shoulder, elbow, 0.065, self.color, rounded=True),
            tube(elbow, wrist, 0.05, self.color, rounded=True),
            tube(wrist, gripper, 0.025, self.body_color, rounded=True),
        ]


def _checked_arms(arms: Sequence[np.ndarray]) -> list[np.ndarray]:
    points = [np.asarray(arm, float) for arm in arms]
    if len(points) != 2 or any(arm.ndim != 2 or arm.shape[-1] != 3 or len(arm) < 4 for arm in points):
        raise ShapeError(
            f"Expected two arms, left and right, each (points, 3) with at least four points, got shapes "
            f"{[arm.shape for arm in points]}. Give link_points(arm, joints) of one time for each."
        )
    return points


@dataclass(frozen=True)
class Bag:
    """The mouth of a bag as a sheet between four hands, which hangs down where it is not held.

    Args:
        sag: how far the middle of the sheet hangs below the straight line, m.
        skirt: how far its rim hangs below the edges, m.
        color: RGB from 0 to 1.

    Raises:
        InputError: lengths not above zero.

    Example:
        >>> corners = np.array([[[0.7, -0.3, 0.3], [0.7, 0.3, 0.3]], [[1.3, -0.3, 0.3], [1.3, 0.3, 0.3]]])
        >>> float(Bag().mesh(corners).extent()[1, 2].round(9))
        0.3
    """

    sag: float = 0.05
    skirt: float = 0.25
    color: Color = (0.80, 0.82, 0.86)

    def __post_init__(self) -> None:
        check_lengths(self)

    def mesh(self, corners: Float[np.ndarray, "robot_partner sides 3"], num: int = 13) -> Mesh:
        """The ruled surface between two held edges.

        Args:
            corners: (2, 2, 3): the points that the robot holds, then those that the partner holds, each along the same
                direction, m.
            num: points along each direction.

        Raises:
            ShapeError: corners of another shape.
        """
        corners = np.asarray(corners, float)
        if corners.shape != (2, 2, 3):
            raise ShapeError(f"Expected corners with shape (2, 2, 3), got {corners.shape}.")
        share = np.linspace(0.0, 1.0, num)
        u, v = share[:, None, None], share[None, :, None]
        robot = (1 - v) * corners[0, 0] + v * corners[0, 1]
        partner = (1 - v) * corners[1, 0] + v * corners[1, 1]
        points = (1 - u) * robot + u * partner
        points[..., 2] -= self.sag * (16.0 * u * (1 - u) * v * (1 - v))[..., 0]
        rims = [self._hanging(points[:, edge], share) for edge in (0, -1)]
        return joined([sheet(points, self.color), *rims])

    def _hanging(self, edge: np.ndarray, share: np.ndarray) -> Mesh:
        down = np.zeros_like(edge)
        down[:, 2] = self.skirt * np.sqrt(np.maximum(4.0 * share * (1 - share), 0.0))
        levels: Sequence[float] = np.linspace(0.0, 1.0, 5).tolist()
        return sheet(np.stack([edge - level * down for level in levels]), self.color)

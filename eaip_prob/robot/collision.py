"""The arm's outline as spheres, for distances to what stands around it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int

from eaip_prob.errors import InputError, ShapeError
from eaip_prob.robot._inputs import checked_rows, checked_vector
from eaip_prob.robot.kinematics import SerialArm


@dataclass(frozen=True, eq=False)
class ArmSpheres:
    """Spheres that move with the links of an arm; n spheres.

    Args:
        links: (n,), the link that each is fixed to, counted as in `SerialArm.frames`.
        offsets: (n, 3), centres in the frames of the links, m.
        radii: (n,), m.

    Raises:
        ShapeError: arrays that do not belong together.
        InputError: radii not above zero, links below zero, values that are not finite.

    Example:
        >>> from eaip_prob.robot import baxter_left_arm
        >>> spheres, arm = ArmSpheres.baxter(), baxter_left_arm()
        >>> spheres.centers(arm, np.tile(arm.posture, (50, 1))).shape
        (50, 14, 3)
    """

    links: Int[np.ndarray, "spheres"]
    offsets: Float[np.ndarray, "spheres 3"]
    radii: Float[np.ndarray, "spheres"]

    def __post_init__(self) -> None:
        offsets = checked_rows("offsets", self.offsets, 3, "centres in the frames of the links")
        radii = checked_vector("radii", self.radii, len(offsets), "one for each sphere")
        if offsets.ndim != 2 or np.shape(self.links) != radii.shape:
            raise ShapeError(
                f"Expected links (n,), offsets (n, 3) and radii (n,), got {np.shape(self.links)}, {offsets.shape} and "
                f"{radii.shape}."
            )
        if not (radii > 0).all() or np.min(self.links, initial=0) < 0:
            raise InputError(f"Expected radii above zero and links from 0 on, got {radii} and {self.links}.")

    def centers(
        self, arm: SerialArm, joints: Sequence[float] | Float[np.ndarray, "*batch joints"]
    ) -> Float[np.ndarray, "*batch spheres 3"]:
        """Centres in the arm's base, m.

        Args:
            arm: that carries the spheres.
            joints: (*batch, J), rad.

        Raises:
            InputError: an arm with fewer links.
        """
        if np.max(self.links, initial=0) > arm.num_joints:
            raise InputError(
                f"Expected an arm with {np.max(self.links)} joints or more, got {arm.num_joints}. Give the arm "
                "for which the spheres were made."
            )
        poses = arm.frames(np.asarray(joints))[..., self.links, :3, :]
        return (poses[..., :3] @ self.offsets[..., None])[..., 0] + poses[..., 3]

    @classmethod
    def baxter(cls) -> ArmSpheres:
        """Forearm and gripper of one of Baxter's arms with the longest fingers, from the elbow down to the tip.

        Each row of spheres covers a cylinder of the collision model in baxter.urdf (Rethink Robotics, BSD-3): both
        ends of the elbow's and of the wrist's hinge (radius 0.06 m, 0.10 m long), forearm and wrist (0.06 m), hand
        (0.04 m). Gripper (0.05 m) and fingers (0.03 m) are estimates that hold the published boxes while closed.
        """
        rows = [
            (4, *_covering(-0.06, 0.06, 0.05, 1)),
            (4, *_covering(0.0156, 0.3756, 0.06, 6)),
            (6, *_covering(-0.06, 0.06, 0.05, 1)),
            (6, *_covering(0.033475, 0.198475, 0.06, 3)),
            (7, *_covering(-0.0464, 0.045, 0.05, 1)),
            (7, *_covering(0.045, 0.1577, 0.03, 2)),
        ]
        links = np.concatenate([np.full(len(radii), link) for link, _, radii in rows])
        along = np.concatenate([middles for _, middles, _ in rows])
        radii = np.concatenate([radii for _, _, radii in rows])
        return cls(links, along[:, None] * np.array([0.0, 0.0, 1.0]), radii)


def _covering(start: float, end: float, radius: float, num: int) -> tuple[np.ndarray, np.ndarray]:
    """(middles, radii) of the smallest equal spheres that cover a cylinder around z, m."""
    length = (end - start) / num
    middles = start + length * (np.arange(num) + 0.5)
    return middles, np.full(num, np.hypot(radius, length / 2.0))

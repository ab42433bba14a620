"""An arm of revolute joints in a row: where its links are for given joint angles, and how its tip moves with them.

Classic Denavit-Hartenberg parameters, T_i = RotZ(theta0_i + q_i) TransZ(d_i) TransX(a_i) RotX(alpha_i): joint i turns
about the z axis of frame i - 1 (Denavit and Hartenberg 1955; Siciliano et al., Robotics, 2009, Sec. 2.8.2).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import cached_property

import numpy as np
from jaxtyping import Float

from eaip_prob.data.frames import check_transform
from eaip_prob.errors import InputError
from eaip_prob.robot._inputs import checked_rows, checked_vector

PARAMETERS = ("d", "a", "alpha", "theta0", "lower", "upper", "speed", "posture")


@dataclass(frozen=True, eq=False)
class SerialArm:
    """Geometry and limits of an arm; J joints, one entry of every sequence for each.

    Args:
        names: of the joints, from the shoulder on.
        d: along the z axis of the frame before a joint, m.
        a: along the x axis after it, m.
        alpha: about that x axis, rad.
        theta0: about the z axis where the joint reads zero, rad.
        lower: smallest joint angles, rad.
        upper: largest joint angles, rad.
        speed: largest joint speeds, rad/s.
        posture: joint angles to which an arm with joints to spare tends, rad.
        T_base_mount: (4, 4), maps the frame of the first joint's axis into the robot's base.
        T_flange_tip: (4, 4), maps coordinates of the tool's tip into the frame after the last joint.

    Raises:
        ShapeError: sequences of other lengths, transforms that are not (4, 4).
        InputError: numbers that are not finite, limits in the wrong order, a posture beyond them, speeds not above 0.

    Example:
        >>> zero = (0, 0)
        >>> flat = SerialArm(("shoulder", "elbow"), zero, (0.4, 0.3), zero, zero, (-2, 0), (2, 2.5), (1, 1), (0, 1))
        >>> flat.tip(np.array([0.0, np.pi / 2])).round(9).tolist()
        [0.4, 0.3, 0.0]
    """

    names: Sequence[str]
    d: Sequence[float] | Float[np.ndarray, "joints"]
    a: Sequence[float] | Float[np.ndarray, "joints"]
    alpha: Sequence[float] | Float[np.ndarray, "joints"]
    theta0: Sequence[float] | Float[np.ndarray, "joints"]
    lower: Sequence[float] | Float[np.ndarray, "joints"]
    upper: Sequence[float] | Float[np.ndarray, "joints"]
    speed: Sequence[float] | Float[np.ndarray, "joints"]
    posture: Sequence[float] | Float[np.ndarray, "joints"]
    T_base_mount: Float[np.ndarray, "4 4"] = field(default_factory=lambda: np.eye(4))
    T_flange_tip: Float[np.ndarray, "4 4"] = field(default_factory=lambda: np.eye(4))

    def __post_init__(self) -> None:
        object.__setattr__(self, "names", tuple(self.names))
        for name in PARAMETERS:
            values = checked_vector(name, getattr(self, name), len(self.names), "one for each joint")
            object.__setattr__(self, name, _read_only(values))
        for name in ("T_base_mount", "T_flange_tip"):
            check_transform(name, getattr(self, name))
            object.__setattr__(self, name, _read_only(getattr(self, name)))
        if not (np.asarray(self.lower) < np.asarray(self.upper)).all() or not (np.asarray(self.speed) > 0).all():
            raise InputError(
                f"Expected lower below upper limits and speeds above zero, got {list(self.lower)}, {list(self.upper)} "
                f"and {list(self.speed)}."
            )
        if not self.allows(self.posture).all():
            raise InputError(f"Expected the posture within the joint limits, got {list(self.posture)}.")

    @property
    def num_joints(self) -> int:
        """J."""
        return len(self.names)

    def allows(self, joints: Sequence[float] | Float[np.ndarray, "*batch joints"], slack: float = 1e-9):
        """Which joint angles (*batch, J), rad, are within their limits, give or take `slack`, rad."""
        q = np.asarray(joints)
        return (q >= np.asarray(self.lower) - slack) & (q <= np.asarray(self.upper) + slack)

    def frames(self, joints: Float[np.ndarray, "*batch joints"]) -> Float[np.ndarray, "*batch links 4 4"]:
        """Poses in the base, T_base_link, of the mount and of the frame after each joint: J + 1 links.

        Args:
            joints: (*batch, J), rad.

        Raises:
            ShapeError: another number of joints.
            InputError: NaN or infinity.
        """
        q = checked_rows("joints", joints, self.num_joints, "one for each joint")
        poses = np.empty((*q.shape[:-1], self.num_joints + 1, 4, 4))
        poses[..., 0, :, :] = self.T_base_mount
        steps = self._steps(q)
        for i in range(self.num_joints):
            poses[..., i + 1, :, :] = poses[..., i, :, :] @ steps[..., i, :, :]
        return poses

    def tip(self, joints: Float[np.ndarray, "*batch joints"]) -> Float[np.ndarray, "*batch 3"]:
        """Where the tool's tip is in the base, m, for joint angles (*batch, J), rad."""
        return self.frames(joints)[..., -1, :3, :] @ np.asarray(self.T_flange_tip)[:, 3]

    def jacobian(self, joints: Float[np.ndarray, "*batch joints"]) -> Float[np.ndarray, "*batch 3 joints"]:
        """Derivative of the tip's position by the joint angles, m/rad: column i is z_i x (tip - o_i).

        Args:
            joints: (*batch, J), rad.
        """
        poses = self.frames(joints)
        tip = poses[..., -1, :3, :] @ np.asarray(self.T_flange_tip)[:, 3]
        axes, origins = poses[..., :-1, :3, 2], poses[..., :-1, :3, 3]
        return np.swapaxes(np.cross(axes, tip[..., None, :] - origins), -1, -2)

    @cached_property
    def constants(self) -> Float[np.ndarray, "rows 12"]:
        """What compiled loops read, (J + 2, 12), read-only.

        A row for each joint: d, a, cos and sin of alpha, theta0, lower, upper, speed, posture and the weight of its
        steps, speed over the largest speed; then the first three rows of T_base_mount and T_flange_tip, flat.
        """
        alpha, speed = np.asarray(self.alpha), np.asarray(self.speed)
        columns = (self.d, self.a, np.cos(alpha), np.sin(alpha), self.theta0, self.lower, self.upper, speed)
        rows = np.zeros((self.num_joints + 2, 12))
        rows[:-2, :10] = np.column_stack((*columns, self.posture, speed / speed.max()))
        rows[-2], rows[-1] = self.T_base_mount[:3].reshape(-1), self.T_flange_tip[:3].reshape(-1)
        return _read_only(rows)

    def _steps(self, q: np.ndarray) -> np.ndarray:
        """T_i of every joint, (*batch, J, 4, 4)."""
        cos, sin = np.cos(q + self.theta0), np.sin(q + self.theta0)
        cos_alpha, sin_alpha = self.constants[:-2, 2], self.constants[:-2, 3]
        zero, one = np.zeros_like(q), np.ones_like(q)
        rows = [
            [cos, -sin * cos_alpha, sin * sin_alpha, self.a * cos],
            [sin, cos * cos_alpha, -cos * sin_alpha, self.a * sin],
            [zero, zero + sin_alpha, zero + cos_alpha, zero + self.d],
            [zero, zero, zero, one],
        ]
        return np.stack([np.stack(row, -1) for row in rows], -2)


def _read_only(values: np.ndarray) -> np.ndarray:
    copy = np.array(values, dtype=np.float64)
    copy.setflags(write=False)
    return copy

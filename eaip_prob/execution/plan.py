"""The path that a prediction means for the gripper where it is now."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import torch
from jaxtyping import Float

from eaip_prob.checks import as_float64, check_count, check_finite, check_positive, check_type
from eaip_prob.errors import InputError, ShapeError
from eaip_prob.execution.following import HASTE, MotionLimits, between, followed, free_response, lateness
from eaip_prob.forecast import Prediction
from eaip_prob.primitives import DMP

SIGNALS = ("x", "y", "z")
NUDGE = 1e-4  # s, steps after a time for a velocity: far above round-off, far below what changes in a motion
_SETTLED = 6.0  # times 1 / rate after which 2 % of a distance from the path are left


@dataclass(frozen=True, eq=False)
class RobotCommand:
    """Where the gripper shall be at a time, and how fast; a measured state is written in the same way.

    Args:
        time: s.
        position: (3,), x, y, z in the robot's base, m.
        velocity: (3,), m/s.

    Raises:
        ShapeError: not three numbers.
        InputError: NaN or infinity.

    Example:
        >>> RobotCommand(0.0, [0.4, -0.6, -0.2], [0.0, 0.0, 0.0]).position.tolist()
        [0.4, -0.6, -0.2]
    """

    time: float
    position: Float[np.ndarray, "3"]
    velocity: Float[np.ndarray, "3"]

    def __post_init__(self) -> None:
        check_finite("time", as_float64("time", self.time), advice="Give the robot's clock in seconds.")
        for name in ("position", "velocity"):
            values = as_float64(name, getattr(self, name))
            if values.shape != (3,):
                raise ShapeError(f"Expected {name} with shape (3,), x, y and z, got {tuple(values.shape)}.")
            check_finite(name, values, advice="Keep the last state that was measured.")
            object.__setattr__(self, name, values.detach().numpy())


@dataclass(frozen=True, eq=False)
class Plan:
    """A predicted path, and how the gripper would take it from where it is.

    Args:
        time: (S,), s, from the present on.
        mean: (S, 3), the expected path, m.
        mean_velocity: (S, 3), m/s.
        path: (S, 3), of the gripper, which starts where it is, m.
        velocity: (S, 3), of the gripper, m/s.
        rate: of the attractor, 1/s.
        prediction: what the plan was made of.
        late: how late the gripper is on the predicted motion at the plan's beginning, s.
        haste: by how much faster than the clock its own time runs at most.

    Example:
        >>> from eaip_prob.data import Trajectory
        >>> from eaip_prob.execution import known_path
        >>> across = known_path(Trajectory([0.0, 8.0], [[0.4, -0.6, 0.3], [0.4, 0.6, 0.3]], ("x", "y", "z")))
        >>> plan = planned(across, RobotCommand(0.0, [0.4, -0.6, 0.3], [0.0, 0.0, 0.0]), MotionLimits())
        >>> plan.expected(99.0)[0].round(3).tolist(), plan.commanded(0.0)[0].tolist()
        ([0.4, 0.6, 0.3], [0.4, -0.6, 0.3])
    """

    time: Float[np.ndarray, "times"]
    mean: Float[np.ndarray, "times 3"]
    mean_velocity: Float[np.ndarray, "times 3"]
    path: Float[np.ndarray, "times 3"]
    velocity: Float[np.ndarray, "times 3"]
    rate: float
    prediction: Prediction
    late: float = 0.0
    haste: float = HASTE

    def lateness(self, time: Float[np.ndarray, "*times"] | float) -> Float[np.ndarray, "*times"]:
        """By how much the gripper is late on the predicted motion at some times, s.

        Args:
            time: s, from the plan's beginning on.
        """
        return lateness(self.late, np.asarray(time, float) - self.time[0], self.haste)

    def expected(self, time: float) -> Float[np.ndarray, "2 3"]:
        """Position, m, and velocity, m/s, on the expected path at one time, s; after the end at rest there."""
        return between(self.time, self.mean, self.mean_velocity, time)

    def commanded(self, time: float) -> Float[np.ndarray, "2 3"]:
        """Position, m, and velocity, m/s, that the gripper would have at one time, s, were this plan followed."""
        return between(self.time, self.path, self.velocity, time)

    def distance_left(self, position: Float[np.ndarray, "3"], time: float) -> float:
        """How far the rest of the expected path leads away from a position at most, m.

        Args:
            position: (3,), m.
            time: s, from which on the path is looked at.
        """
        rest = self.mean[np.searchsorted(self.time, time) :]
        points = np.concatenate([rest, self.expected(time)[:1]])
        return float(np.linalg.norm(points - position, axis=-1).max())


def planned(
    prediction: Prediction,
    start: RobotCommand,
    limits: MotionLimits,
    num_times: int = 50,
    late: float = 0.0,
    haste: float = HASTE,
) -> Plan:
    """How the gripper would take a predicted path from where it is, until the motion is over and it has caught up.

    The robot has one clock, whatever the hypotheses about the tempo (`Prediction.in_step`). One law serves every
    primitive: the expected path plus the free response of a critically damped attractor from the distance at the start.
    Its rate is the DMP's own, alpha_y / (2 duration), so that with one hypothesis about the tempo, beta_y = alpha_y / 4
    and nothing to make up for it is `DMP.rollout`; for other primitives it is that of the default alpha_y. Where that
    is faster than the limits allow the gripper falls behind the path, and catches up.

    Args:
        prediction: of one motion, with the signals x, y and z in m.
        start: where the gripper is.
        limits: of speed and acceleration.
        num_times: S, evenly over what is left.
        late: how late the gripper is on the motion, having waited, s; it makes up for it along the path (`lateness`).
        haste: by how much faster than the clock its own time may run meanwhile, above zero.

    Raises:
        InputError: other signals, a negative or infinite lateness, a predicted path that is not finite, or fewer than
            two times.
        ShapeError: a batch of motions.

    Example:
        >>> from eaip_prob.data import Trajectory
        >>> from eaip_prob.execution import known_path
        >>> share = torch.linspace(0.0, 1.0, 30)[:, None]
        >>> sweep = torch.tensor([0.4, -0.6, 0.3]) + share**2 * (3.0 - 2.0 * share) * torch.tensor([0.0, 1.2, 0.0])
        >>> across = known_path(Trajectory(8.0 * share[:, 0], sweep, ("x", "y", "z")))
        >>> plan = planned(across, RobotCommand(1.0, [0.4, -0.6, 0.2], [0.0, 0.0, 0.0]), MotionLimits())
        >>> plan.path[[0, -1]].round(2).tolist()
        [[0.4, -0.6, 0.2], [0.4, 0.6, 0.3]]
    """
    order, rate = _signals(prediction), attractor_rate(prediction)
    prediction = prediction.in_step()
    check_count("num_times", num_times, least=2)
    check_positive("haste", haste)
    if not 0.0 <= late < np.inf:
        raise InputError(f"Expected late of at least 0 and finite, in s, got {late}.")
    end = max(_end(prediction) + late, start.time + _SETTLED / rate)
    time = np.linspace(start.time, end, num_times)
    asked = np.concatenate([time, time + NUDGE, time + 2.0 * NUDGE])
    asked = asked - lateness(late, asked - start.time, haste)
    mean = prediction.at(torch.from_numpy(asked)).mean[:, order]
    check_finite("the predicted path", mean, advice="Check the demonstrations and what was observed.")
    path, after, next_after = np.split(mean.detach().numpy(), 3)
    velocity = slope(path, after, next_after)
    return Plan(time, path, velocity, *_taken(time, path, velocity, start, rate, limits), rate, prediction, late, haste)


def slope(
    now: Float[np.ndarray, "*batch 3"], after: Float[np.ndarray, "*batch 3"], next_after: Float[np.ndarray, "*batch 3"]
) -> Float[np.ndarray, "*batch 3"]:
    """Velocity from positions at a time and one and two `NUDGE` later: forwards, since motions begin and end at rest.

    Args:
        now: (*batch, 3), m.
        after: (*batch, 3), m.
        next_after: (*batch, 3), m.

    Example:
        >>> slope(np.zeros(3), np.full(3, 1e-5), np.full(3, 2e-5)).round(9).tolist()
        [0.1, 0.1, 0.1]
    """
    return (4.0 * after - 3.0 * now - next_after) / (2.0 * NUDGE)


def attractor_rate(prediction: Prediction) -> float:
    """Rate of the attractor that draws the gripper to a predicted path, 1/s.

    Args:
        prediction: of one motion.

    Example:
        >>> from eaip_prob.data import Trajectory
        >>> from eaip_prob.execution import known_path
        >>> attractor_rate(known_path(Trajectory([0.0, 10.0], [[0.4, -0.6, 0.3], [0.4, 0.6, 0.3]], ("x", "y", "z"))))
        1.25
    """
    primitive = prediction.primitive
    alpha = primitive.alpha_y if isinstance(primitive, DMP) else DMP().alpha_y
    duration = float((prediction.posterior.weight * prediction.phase.duration).sum())
    return alpha / (2.0 * check_positive("the expected duration", duration))


def _signals(prediction: Prediction) -> list[int]:
    """Places of x, y and z among the signals."""
    check_type("prediction", prediction, Prediction, "Pass what predict or step of a predictor returned.")
    missing = [name for name in SIGNALS if name not in prediction.names]
    if missing:
        raise InputError(
            f"Expected a prediction of the signals {SIGNALS}, the gripper's position in m, got {prediction.names}. "
            "Name the robot's signals so in the demonstrations."
        )
    if prediction.posterior.log_weight.ndim > 1:
        batch = tuple(prediction.posterior.log_weight.shape[:-1])
        raise ShapeError(f"Expected the prediction of one motion, got a batch {batch}. Predict one motion.")
    return [prediction.names.index(name) for name in SIGNALS]


def _end(prediction: Prediction) -> float:
    """Time at which a motion on one clock ends, s."""
    phase = prediction.phase
    left = (prediction.primitive.limit - phase.paths[..., 0, -1]) * phase.duration[..., 0]
    return float(phase.time[..., -1] + left)


def _taken(
    time: np.ndarray,
    mean: np.ndarray,
    mean_velocity: np.ndarray,
    start: RobotCommand,
    rate: float,
    limits: MotionLimits,
) -> tuple[np.ndarray, np.ndarray]:
    """(positions, velocities) of the gripper along the way."""
    distance, change = free_response(time - time[0], rate)
    apart = np.stack([start.position - mean[0], start.velocity - mean_velocity[0]])
    path, velocity = mean + distance @ apart, mean_velocity + change @ apart
    if limits.keeps(velocity, time):
        return path, velocity
    taken, points = [np.stack([start.position, start.velocity])], np.stack([mean, mean_velocity], 1)
    for k in range(len(time) - 1):
        taken.append(followed(taken[-1], points[k : k + 2], time[k + 1] - time[k], rate, limits))
    return np.stack(taken)[:, 0], np.stack(taken)[:, 1]

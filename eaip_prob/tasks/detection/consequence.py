"""What errors of detected features do to a prediction: motions that lift something over the object and set it down.

The person's hand and the robot's rise until they clear the object's top, and the robot's crosses over it. How high is
in the object, and little of it in the first fifth of the person's motion, so that the environment decides.
"""

from __future__ import annotations

import warnings
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import torch
from jaxtyping import Float

from eaip_prob.data import Demonstration, DemonstrationSet, EnvironmentFeatures, Trajectory
from eaip_prob.errors import ExtrapolationWarning
from eaip_prob.phase import ElapsedClock
from eaip_prob.prediction import InteractionPredictor

_SAMPLES, _DURATION, _SEEN = 50, 2.0, 10
_CLEARANCE, _VARIED = 0.15, 0.02  # metres above the object's top: mean, and from motion to motion
_START, _AWAY = -0.6, 0.45  # height, and y beside the object, at which motions start, m
_STARTS, _TRACKED = 0.02, 0.002  # metres by which starts vary, and by which a tracked hand is off
ENVIRONMENTS = ("true", "detected", "detected_as_exact", "none")


@dataclass(frozen=True, eq=False)
class Lift:
    """One motion over an object, and what was said of the object.

    Args:
        place: (6,), centre and edge lengths of the object in the world, m.
        true: its features without error.
        detected: its features as detected.

    Example:
        >>> box = EnvironmentFeatures(("height",), [0.9])
        >>> lift = Lift(np.array([0.95, 0.0, -0.48, 0.6, 0.3, 0.9]), box, box)
        >>> lift.motion(np.random.default_rng(0)).robot.names
        ('y', 'z')
    """

    place: Float[np.ndarray, "6"]
    true: EnvironmentFeatures
    detected: EnvironmentFeatures

    def motion(self, generator: np.random.Generator) -> Demonstration:
        """A person's and a robot's hand, 2 s, with the detected features.

        Args:
            generator: of clearance and starts.
        """
        top = self.place[2] + self.place[5] / 2.0
        peak = top + _CLEARANCE + generator.normal(0.0, _VARIED)
        starts = _START + generator.normal(0.0, _STARTS, 2)
        time = np.linspace(0.0, _DURATION, _SAMPLES)
        share = time / _DURATION
        rise = np.sin(np.pi * share**2.5) ** 2  # next to nothing in the first fifth, and back at the end
        across = share**6 * (10.0 - 15.0 * share**2 + 6.0 * share**4)  # over the middle at the peak
        human = starts[0] + (peak - starts[0]) * rise + generator.normal(0.0, _TRACKED, _SAMPLES)
        robot = starts[1] + (peak - starts[1]) * rise
        y = self.place[1] + _AWAY * (1.0 - 2.0 * across)
        clock = torch.from_numpy(time)
        return Demonstration(
            Trajectory(clock, torch.from_numpy(human[:, None]), ("hand_z",)),
            Trajectory(clock, torch.from_numpy(np.column_stack([y, robot])), ("y", "z")),
            self.detected,
        )


def consequence(training: Sequence[Lift], test: Sequence[Lift], seed: int) -> dict[str, dict[str, float]]:
    """Error (rmse, m) and coverage of 90 % intervals of the robot's path after a fifth of the person's, by environment.

    Learnt from detected features; asked with true ones, detected ones with their covariance, detected ones as if they
    were exact, and none.

    Args:
        training: objects of the demonstrations, one motion each.
        test: other objects, or other placements.
        seed: of the motions.

    Example:
        >>> generator = np.random.default_rng(0)
        >>> def lift(height):
        ...     seen = EnvironmentFeatures(("height",), [height], [[1e-4]])
        ...     return Lift(np.array([0.95, 0.0, height / 2 - 0.93, 0.5, 0.4, height]), seen, seen)
        >>> found = consequence([lift(h) for h in generator.uniform(0.5, 1.1, 12)], [lift(0.6), lift(1.0)], seed=0)
        >>> found["true"]["rmse"] < found["none"]["rmse"]
        True
    """
    generator = np.random.default_rng(seed)
    demonstrations = DemonstrationSet([lift.motion(generator) for lift in training])
    predictor = InteractionPredictor(phase=ElapsedClock()).fit(demonstrations)
    motions = [lift.motion(generator) for lift in test]
    return {name: _scores(predictor, motions, [_environment(lift, name) for lift in test]) for name in ENVIRONMENTS}


def _scores(
    predictor: InteractionPredictor, motions: Sequence[Demonstration], environments: Sequence[EnvironmentFeatures]
) -> dict[str, float]:
    """Each is predicted on its own, since the scene may have been observed in some and not in others."""
    errors, inside = [], []
    for motion, environment in zip(motions, environments, strict=True):
        assert motion.human is not None and motion.robot is not None
        truth = motion.robot.values[_SEEN:]
        # What a detector sees amiss, far from the demonstrated objects too, is what is studied.
        with warnings.catch_warnings(action="ignore", category=ExtrapolationWarning):
            prediction = predictor.predict(motion.human.first(_SEEN), environment, motion.robot.time[_SEEN:])
        lower, upper = prediction.interval(0.9)
        errors.append((prediction.mean - truth).square().mean())
        inside.append(((lower <= truth) & (truth <= upper)).double().mean())
    return {"rmse": float(torch.stack(errors).mean().sqrt()), "coverage90": float(torch.stack(inside).mean())}


def _environment(lift: Lift, name: str) -> EnvironmentFeatures:
    if name == "true":
        return lift.true
    if name == "none":
        return EnvironmentFeatures.unseen(lift.detected.names)
    if name == "detected":
        return lift.detected
    return EnvironmentFeatures(lift.detected.names, lift.detected.value, observed=lift.detected.observed)

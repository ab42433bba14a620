from __future__ import annotations

import dataclasses
from collections.abc import Callable

import torch

from eaip_prob.data.demonstrations import Demonstration, DemonstrationSet
from eaip_prob.data.environment import EnvironmentFeatures
from eaip_prob.data.features import RawFeatures
from eaip_prob.data.trajectory import Trajectory
from eaip_prob.models import GaussianJointModel, ShrinkageCovariance
from eaip_prob.phase import AbstractPhaseEstimator, DTWClock, ElapsedClock, ExpectedClock, MarginalClock
from eaip_prob.prediction import InteractionPredictor
from eaip_prob.primitives import ProMP

HUMAN, ROBOT = ProMP(num_basis=5), ProMP(num_basis=4)
SIGNALS, SCENE = ("x", "y"), ("distance", "height")
SHRINKAGE = ShrinkageCovariance(0.05)
CLOCKS: dict[str, Callable[[], AbstractPhaseEstimator]] = {
    "elapsed": ElapsedClock,
    "expected": lambda: ExpectedClock(RawFeatures()),
    "marginal": lambda: MarginalClock(num_durations=5),
    "dtw": lambda: DTWClock(num_samples=40),
}


def motions(num: int, seed: int = 0, groups: int = 3, samples: int = 25, unit: float = 1.0) -> DemonstrationSet:
    """Reaches whose length and duration follow the scene; the robot comes to meet them.

    Args:
        unit: of time, in seconds.
    """
    draw = torch.Generator().manual_seed(seed)
    phase = torch.linspace(0.0, 1.0, samples, dtype=torch.float64)
    reach = phase**2 * (3.0 - 2.0 * phase)
    result = []
    for _ in range(num):
        distance, height, bow, own, tempo = torch.randn(5, generator=draw, dtype=torch.float64)
        goal = torch.stack([2.0 + 0.4 * distance + 0.1 * own, 0.8 + 0.3 * height + 0.1 * bow])
        bulge = torch.stack([0.1 * bow, 0.2 + 0.3 * own]) * torch.sin(torch.pi * phase)[:, None]
        human = torch.tensor([0.3, -0.2]) + reach[:, None] * goal + bulge
        robot = torch.stack([3.0 - reach * (3.0 - goal[0]), reach * goal[1], 0.5 * bow * reach + 0.2 * own], -1)
        time = 1.7 + unit * phase * 1.4 * torch.exp(0.2 * distance + 0.05 * tempo)
        scene = EnvironmentFeatures(SCENE, torch.stack([0.6 + 0.1 * distance, 90.0 + 8.0 * height]))
        result.append(Demonstration(Trajectory(time, human, SIGNALS), Trajectory(time, robot, ("u", "v", "w")), scene))
    return DemonstrationSet(result, [i * groups // num for i in range(num)])


def quick(clock: str = "elapsed", **arguments: object) -> InteractionPredictor:
    """Fits in a moment: nothing is searched."""
    given = {"human": HUMAN, "robot": ROBOT, "phase": CLOCKS[clock](), "model": GaussianJointModel(SHRINKAGE)}
    given |= {"features": RawFeatures(), "noise": [0.03, 0.02], "environment_noise": [0.02, 1.5]}
    return InteractionPredictor(**(given | arguments))  # pyright: ignore[reportArgumentType]


def with_fitted(predictor: InteractionPredictor, **changes: object) -> InteractionPredictor:
    """With what was learnt changed, of the joint of the motions alone too."""
    fitted = predictor.require_fitted()
    alone = fitted.alone and dataclasses.replace(fitted.alone, **changes)  # pyright: ignore[reportArgumentType]
    changed = dataclasses.replace(fitted, alone=alone, **changes)  # pyright: ignore[reportArgumentType]
    return dataclasses.replace(predictor, fitted=changed)

from __future__ import annotations

import torch
from prediction_world import PLAIN

from eaip_prob.data.demonstrations import Demonstration, DemonstrationSet
from eaip_prob.data.environment import EnvironmentFeatures
from eaip_prob.data.trajectory import Trajectory
from eaip_prob.models import GaussianJointModel, ShrinkageCovariance
from eaip_prob.phase import ElapsedClock
from eaip_prob.prediction import InteractionPredictor
from eaip_prob.primitives import ProMP
from eaip_prob.training import Fitted

BASIS, SAMPLES, DURATION = ProMP(num_basis=4), 12, 2.5

FIXED = ShrinkageCovariance(0.05)


def demonstrations(
    num: int, seed: int = 0, groups: int = 2, sensor: float = 0.3, tempo: float = 0.0, feature_noise: float = 0.5
) -> DemonstrationSet:
    """Both agents follow a hidden shape; one feature tells part of it."""
    generator = torch.Generator().manual_seed(seed)
    shape = torch.randn(num, 4, generator=generator, dtype=torch.float64)
    mixing = torch.randn(4, 8, generator=generator, dtype=torch.float64)
    robot = shape @ mixing + 0.3 * torch.randn(num, 8, generator=generator, dtype=torch.float64)
    noise = sensor * torch.randn(num, SAMPLES, 1, generator=generator, dtype=torch.float64)
    feature = 100.0 + 20.0 * (shape[:, 0] + feature_noise * torch.randn(num, generator=generator, dtype=torch.float64))
    length = torch.exp(tempo * torch.randn(num, generator=generator, dtype=torch.float64))
    phase = torch.linspace(0, 1, SAMPLES, dtype=torch.float64)
    result = []
    for i in range(num):
        time = phase * DURATION * length[i]
        human = Trajectory(time, BASIS.decode(6.0 * shape[i], phase) + noise[i], ("x",))
        scene = EnvironmentFeatures(("width",), feature[i, None])
        result.append(Demonstration(human, Trajectory(time, BASIS.decode(robot[i], phase), ("u", "v")), scene))
    return DemonstrationSet(result, [i * groups // num for i in range(num)])


def predictor(**arguments: object) -> InteractionPredictor:
    arguments = {"phase": ElapsedClock(), "model": GaussianJointModel(FIXED)} | PLAIN | arguments
    return InteractionPredictor(human=BASIS, robot=BASIS, **arguments)  # pyright: ignore[reportArgumentType]


def fit(motions: DemonstrationSet, **arguments: object) -> Fitted:
    fitted = predictor(**arguments).fit(motions).fitted
    assert fitted is not None
    return fitted


def deviation(motions: DemonstrationSet) -> tuple[float, float]:
    values, scene = motions.trajectories("human").values.numpy(), motions.environments
    assert scene is not None
    return float(values.std()), float(scene.value.numpy().std())

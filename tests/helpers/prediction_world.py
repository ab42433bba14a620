from __future__ import annotations

import dataclasses
from collections.abc import Callable

import numpy as np
import torch

from eaip_prob.data.demonstrations import Demonstration, DemonstrationSet
from eaip_prob.data.environment import EnvironmentFeatures
from eaip_prob.data.features import RawFeatures
from eaip_prob.data.trajectory import Trajectory
from eaip_prob.evidence import ForcingEvidence
from eaip_prob.models import EmpiricalCovariance, GaussianJointModel
from eaip_prob.phase import DTWClock, ElapsedClock
from eaip_prob.prediction import InteractionPredictor
from eaip_prob.primitives import DMP, AbstractPrimitive, ProMP

HUMAN, ROBOT = ProMP(num_basis=5), ProMP(num_basis=4)
# One joint that answers everything and believes all of it, as textbooks have it.
PLAIN = {"features": RawFeatures(), "gate": False, "trust": False, "separate": False}

DURATION, SAMPLES, SENSOR = 2.5, 30, 0.005

Make = Callable[[Demonstration], Demonstration]


def world() -> tuple[torch.Tensor, torch.Tensor]:
    """(mean, root of the covariance) of [human, robot, features]: robot = linear(human, scene) + own."""
    generator = torch.Generator().manual_seed(11)
    root = torch.zeros(15, 15, dtype=torch.float64)
    human, scene = slice(0, 5), slice(13, 15)
    root[human, human] = torch.randn(5, 5, generator=generator, dtype=torch.float64)
    root[scene, scene] = torch.tensor([[1.0, 0.0], [0.0, 20.0]])
    root[scene, human] = torch.randn(2, 5, generator=generator, dtype=torch.float64) * torch.tensor([[0.3], [8.0]])
    root[5:13, human] = 2.0 * torch.randn(8, 5, generator=generator, dtype=torch.float64)
    root[5:13, scene] = 1.5 * torch.randn(8, 2, generator=generator, dtype=torch.float64)
    root[5:13, 5:13] = 0.4 * torch.eye(8, dtype=torch.float64)
    mean = torch.cat([torch.arange(5.0), 5.0 - torch.arange(8.0), torch.tensor([3.0, 200.0])]).double()
    return mean, root


def demonstrations(num: int, seed: int = 0, groups: int | None = 3, ragged: bool = False) -> DemonstrationSet:
    generator = torch.Generator().manual_seed(seed)
    mean, root = world()
    weights = mean + torch.randn(num, 15, generator=generator, dtype=torch.float64) @ root.mT
    length = torch.exp(0.15 * ragged * torch.randn(num, generator=generator, dtype=torch.float64))
    noise = SENSOR * torch.randn(num, SAMPLES, 1, generator=generator, dtype=torch.float64)
    result = []
    phase = torch.linspace(0, 1, SAMPLES, dtype=torch.float64)
    for i in range(num):
        time = phase * DURATION * length[i]
        human = HUMAN.decode(weights[i, :5], phase) + noise[i]
        scene = EnvironmentFeatures(("width", "height"), weights[i, 13:])
        robot = Trajectory(time, ROBOT.decode(weights[i, 5:13], phase), ("u", "v"))
        result.append(Demonstration(Trajectory(time, human, ("x",)), robot, scene))
    return DemonstrationSet(result, None if groups is None else [i * groups // num for i in range(num)])


def changed(demonstrations: DemonstrationSet, change: Make) -> DemonstrationSet:
    return DemonstrationSet([change(one) for one in demonstrations], demonstrations.groups)


def scaled(trajectory: Trajectory, factor: float) -> Trajectory:
    return dataclasses.replace(trajectory, values=trajectory.values * factor)


def predictor(robot: AbstractPrimitive = ROBOT, **arguments: object) -> InteractionPredictor:
    """With one joint that believes everything, unless arguments say otherwise."""
    arguments = {"phase": ElapsedClock()} | PLAIN | arguments
    return InteractionPredictor(human=HUMAN, robot=robot, **arguments)  # pyright: ignore[reportArgumentType]


def full(robot: AbstractPrimitive = ROBOT, **arguments: object) -> InteractionPredictor:
    """With the package's own joints, gate and trust."""
    own = InteractionPredictor()
    return predictor(robot, **{name: getattr(own, name) for name in PLAIN} | arguments)


def paper(target: str = "robot") -> InteractionPredictor:
    model = GaussianJointModel(EmpiricalCovariance(), "regression")
    dmp = DMP(num_basis=6, boundary="given")
    parts: dict[str, object] = {"human": dmp, "robot": dmp, "evidence": ForcingEvidence(), "model": model}
    arguments = {"phase": DTWClock(num_samples=60), "target": target, "criterion": "evidence", "num_samples": 40}
    return InteractionPredictor(**parts | arguments | PLAIN)  # pyright: ignore[reportArgumentType]


def growth(model: InteractionPredictor, scene: EnvironmentFeatures, num: int) -> np.ndarray:
    """1 + d^2 / n of scenes (*batch, 2) of which everything was observed, of n that were demonstrated."""
    fitted = model.fitted
    assert fitted is not None
    covariance = fitted.model.prior.block_covariance("environment").numpy()
    total = covariance + np.diag(fitted.environment_noise.numpy() ** 2) + scene.covariance.numpy()
    away = scene.value.numpy() - fitted.model.prior.block_mean("environment").numpy()
    return 1.0 + np.einsum("...i,...ij,...j->...", away, np.linalg.inv(total), away) / num


def observation(seed: int = 3, seen: int = 12) -> tuple[Trajectory, EnvironmentFeatures]:
    motion = demonstrations(1, seed=seed, groups=None)[0]
    assert motion.human is not None and motion.environment is not None
    return motion.human.first(seen), motion.environment

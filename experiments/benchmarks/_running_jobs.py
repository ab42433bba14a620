"""Updates of a prediction that runs while a person moves, as `core.py` times them; nothing heavy at the top."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    import numpy as np
    from _core_jobs import Pair, Problem
    from torch import Tensor

    from eaip_prob.data import EnvironmentFeatures
    from eaip_prob.models import AbstractJointModel
    from eaip_prob.prediction import InteractionPredictor
    from eaip_prob.streaming import Stream

NUM_SEEN, NUM_AHEAD = 100, 20
TEMPO = 0.2  # of the logarithm of the duration, for one standard deviation of the first feature


def jobs(problem: Problem, seed: int) -> Mapping[str, Pair]:
    """One more frame after 100 samples, to the robot's weights, and to its positions and variances ahead."""
    from eaip_prob.models import GaussianJointModel, KernelJointModel, ShrinkageCovariance

    scenes = environments(seed)
    shrinkage = ShrinkageCovariance(0.1)
    gaussian = predictor(problem, scenes, GaussianJointModel(shrinkage))
    kernel = predictor(problem, scenes, KernelJointModel(shrinkage, bandwidth=1.5))
    return {
        "update_expected_clock": update(problem, gaussian, scenes),
        "update_kernel": update(problem, kernel, scenes),
        "stream_step": step(problem, gaussian, scenes),
    }


def environments(seed: int) -> EnvironmentFeatures:
    """Three features for each demonstration and for the new motion, which is the last."""
    import torch
    from _core_jobs import NUM_DEMONSTRATIONS

    from eaip_prob.data import EnvironmentFeatures

    generator = torch.Generator().manual_seed(seed)
    values = torch.randn(NUM_DEMONSTRATIONS + 1, 3, generator=generator, dtype=torch.float64)
    return EnvironmentFeatures(("distance", "width", "height"), values)


def predictor(problem: Problem, scenes: EnvironmentFeatures, model: AbstractJointModel) -> InteractionPredictor:
    """Fitted to motions whose tempo follows the first feature, on the expected clock, with squares and products."""
    from _core_jobs import NOISE, NUM_BASIS, NUM_DEMONSTRATIONS

    from eaip_prob.data import Demonstration, DemonstrationSet, QuadraticFeatures, Trajectory
    from eaip_prob.phase import ExpectedClock
    from eaip_prob.prediction import InteractionPredictor
    from eaip_prob.primitives import DMP, ProMP

    demonstrations = []
    for place in range(NUM_DEMONSTRATIONS):
        scene = scenes[place]
        time = problem.time * (TEMPO * scene.value[0]).exp()
        human, robot = Trajectory(time, problem.human[place]), Trajectory(time, problem.robot[place])
        demonstrations.append(Demonstration(human, robot, scene))
    unfitted = InteractionPredictor(
        ProMP(num_basis=NUM_BASIS),
        DMP(num_basis=NUM_BASIS),
        ExpectedClock(),
        model=model,
        features=QuadraticFeatures(),
        noise=NOISE,
        environment_noise=0.1,
        gate=False,
        trust=False,
        recalibrate=False,
    )
    return unfitted.fit(DemonstrationSet(demonstrations))


def following(problem: Problem, fitted: InteractionPredictor, scenes: EnvironmentFeatures) -> Stream:
    """The state after 100 samples."""
    _, state = fitted.step(problem.new.first(NUM_SEEN), fitted.init(scenes[-1]))
    return state


def plain_terms(
    problem: Problem, state: Stream
) -> tuple[tuple[np.ndarray, np.ndarray], tuple[np.ndarray, np.ndarray, np.ndarray]]:
    """((mean, covariance) once the scene is known, (design, values, deviation) of the samples) in numpy."""
    from _core_jobs import DURATION

    joint, seen = state.belief.components, problem.new.first(NUM_SEEN + 1)
    phase = state.fitted.phase.estimate(seen, state.scene.environment)
    design, _ = state.fitted.primitives["human"].design(phase.paths[0], DURATION)
    prior = joint.mean.numpy().reshape(-1), joint.covariance.numpy().reshape(joint.mean.shape[-1], -1)
    return prior, (design.numpy(), seen.values.numpy(), state.fitted.noise.numpy())


def update(problem: Problem, fitted: InteractionPredictor, scenes: EnvironmentFeatures) -> Pair:
    """One more frame to the mean and covariance of the robot's weights."""
    import _core_plain as plain
    from _core_jobs import Pair

    state, frame = following(problem, fitted, scenes), problem.new.first(NUM_SEEN + 1).last(1)
    prior, seen = plain_terms(problem, state)

    def package() -> tuple[Tensor, Tensor]:
        components = fitted.step(frame, state)[0].posterior.components
        return components.mean, components.covariance

    return Pair(package, lambda: plain.condition(*prior, *seen))


def step(problem: Problem, fitted: InteractionPredictor, scenes: EnvironmentFeatures) -> Pair:
    """One more frame to the robot's positions and their variances at 20 times ahead."""
    import _core_plain as plain
    from _core_jobs import Pair

    state, frame = following(problem, fitted, scenes), problem.new.first(NUM_SEEN + 1).last(1)
    prior, seen = plain_terms(problem, state)
    ahead = problem.time[NUM_SEEN + 1 :: (len(problem.time) - NUM_SEEN) // NUM_AHEAD]
    estimate = state.fitted.phase.estimate(problem.new.first(NUM_SEEN + 1), state.scene.environment)
    design = state.fitted.primitives["robot"].design(estimate.at(ahead)[0], estimate.duration[0])[0].numpy()
    factor, residual = float(state.scene.growth), state.fitted.residual.numpy()

    def package() -> tuple[Tensor, Tensor]:
        prediction, _ = fitted.step(frame, state, time=ahead)
        return prediction.mean, prediction.variance

    def plainly() -> tuple[np.ndarray, np.ndarray]:
        mean, variance = plain.predict(prior, seen, design, residual)
        return mean, factor * variance

    return Pair(package, plainly)

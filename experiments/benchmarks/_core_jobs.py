"""The problem that `core.py` times, and its operations beside the plain ones; nothing heavy is imported at the top."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    import numpy as np
    from torch import Tensor

    from eaip_prob.data import Trajectory
    from eaip_prob.prediction import InteractionPredictor
    from eaip_prob.training import Fitted

NUM_SAMPLES, NUM_BASIS, NUM_HUMAN, NUM_ROBOT = 200, 20, 6, 3
DURATION = 2.0  # s
NOISE = 0.005  # m
RIDGE = 1e-6
NUM_DEMONSTRATIONS, NUM_MANY, NUM_ROLLOUTS = 90, 1000, 500


@dataclass(frozen=True)
class Pair:
    """One operation done by the package and in plain numpy; both answer with the same quantities."""

    package: Callable[[], Any]
    plain: Callable[[], Any]


@dataclass(frozen=True, eq=False)
class Problem:
    """Synthetic reaches of two agents, in metres, and a predictor fitted to some of them.

    Args:
        time: (T,), seconds.
        human: (N, T, 6).
        robot: (N, T, 3).
        new: (T, 6), a motion of the human that is not among them.
        predictor: fitted.
    """

    time: Tensor
    human: Tensor
    robot: Tensor
    new: Trajectory
    predictor: InteractionPredictor

    @classmethod
    def of(cls, seed: int) -> Problem:
        """The problem of a seed."""
        import torch

        from eaip_prob.data import Trajectory

        time = torch.linspace(0.0, DURATION, NUM_SAMPLES, dtype=torch.float64)
        human, robot = motions(NUM_MANY + 1, time / DURATION, seed).split((NUM_HUMAN, NUM_ROBOT), -1)
        return cls(time, human[:-1], robot[:-1], Trajectory(time, human[-1]), predictor(time, human, robot))

    @property
    def phase(self) -> Tensor:
        """(T,), of all motions."""
        return self.time / DURATION

    @property
    def fitted(self) -> Fitted:
        """What the predictor has learnt."""
        assert self.predictor.fitted is not None
        return self.predictor.fitted

    @property
    def prior(self) -> tuple[np.ndarray, np.ndarray]:
        """(mean, covariance) of all weights, for the plain operations."""
        joint = self.fitted.model.prior
        return joint.mean.numpy(), joint.covariance.numpy()

    def seen(self, num: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """(design, values, deviation of the noise) of the new motion's first samples, for the plain operations."""
        design, _ = self.fitted.primitives["human"].design(self.phase[:num], DURATION)
        return design.numpy(), self.new.values[:num].numpy(), self.fitted.noise.numpy()


def motions(num: int, phase: Tensor, seed: int) -> Tensor:
    """(num, T, 9) reaches of minimum jerk from varied starts to varied goals, with a bow and a waver of their own."""
    import torch

    generator = torch.Generator().manual_seed(seed)
    causes = torch.randn(num, 8, generator=generator, dtype=torch.float64)
    mixing = torch.randn(4, 8, NUM_HUMAN + NUM_ROBOT, generator=generator, dtype=torch.float64)
    start, reach, bow, waver = causes @ mixing
    progress = phase**3 * (10.0 - 15.0 * phase + 6.0 * phase**2)
    bend, wave = (torch.pi * phase).sin().square(), (7.0 * phase).sin()
    shapes = torch.stack([torch.full_like(phase, 0.05), 0.2 * progress, 0.05 * bend, 0.02 * wave])
    return torch.einsum("pnd,pt->ntd", torch.stack([start, reach + 2.0, bow, waver]), shapes)


def predictor(time: Tensor, human: Tensor, robot: Tensor) -> InteractionPredictor:
    """A predictor with one phase path and a given noise, fitted to the first motions."""
    from eaip_prob.data import Demonstration, DemonstrationSet, Trajectory
    from eaip_prob.phase import ElapsedClock
    from eaip_prob.prediction import InteractionPredictor
    from eaip_prob.primitives import DMP, ProMP

    demonstrations = [
        Demonstration(Trajectory(time, human[i]), Trajectory(time, robot[i])) for i in range(NUM_DEMONSTRATIONS)
    ]
    primitives = ProMP(num_basis=NUM_BASIS), DMP(num_basis=NUM_BASIS)
    unfitted = InteractionPredictor(*primitives, phase=ElapsedClock(), noise=NOISE, trust=False, recalibrate=False)
    return unfitted.fit(DemonstrationSet(demonstrations))


def jobs(seed: int) -> dict[str, Pair]:
    """All operations on the problem of a seed."""
    import _running_jobs

    problem = Problem.of(seed)
    pairs = {f"encode_{num}": encode(problem, num) for num in (NUM_DEMONSTRATIONS, NUM_MANY)}
    pairs |= {f"condition_{num}": condition(problem, num) for num in (20, 100, 200)}
    pairs |= {f"rollout_{num}": rollout(problem, num, NUM_ROBOT) for num in (1, NUM_ROLLOUTS)}
    pairs[f"rollout_{NUM_ROLLOUTS}_9"] = rollout(problem, NUM_ROLLOUTS, NUM_HUMAN + NUM_ROBOT)
    pairs["dtw_200"], pairs["dtw_step"] = align(problem)
    pairs["predict"] = predict(problem, 100)
    return pairs | dict(_running_jobs.jobs(problem, seed))


def encode(problem: Problem, num: int) -> Pair:
    """Complete motions, on one clock, to weights."""
    import _core_plain as plain

    from eaip_prob.data import Trajectory

    human, robot = Trajectory(problem.time, problem.human[:num]), Trajectory(problem.time, problem.robot[:num])
    promp, dmp = (problem.fitted.primitives[agent] for agent in ("human", "robot"))
    phase = problem.phase
    designs = [primitive.design(phase, DURATION)[0].numpy() for primitive in (promp, dmp)]
    values = [part.values.numpy() for part in (human, robot)]
    return Pair(
        lambda: (promp.encode(human, phase, DURATION), dmp.encode(robot, phase, DURATION)),
        lambda: tuple(plain.encode(design, value, RIDGE) for design, value in zip(designs, values, strict=True)),
    )


def condition(problem: Problem, num: int) -> Pair:
    """The first samples of the human to the robot's weights."""
    import _core_plain as plain
    import torch

    from eaip_prob.evidence import PositionEvidence

    promp, noise, joint = problem.fitted.primitives["human"], problem.fitted.noise, problem.fitted.model.prior
    evidence, seen, phase = PositionEvidence(), problem.new.first(num), problem.phase[None, :num]
    duration = torch.full((1,), DURATION, dtype=torch.float64)
    prior, arrays = problem.prior, problem.seen(num)

    def package() -> tuple[Tensor, Tensor]:
        observation = evidence.observe(promp, "human", seen, phase, duration, noise)
        assert observation is not None
        posterior, _ = joint.update([observation], keep=("robot",))
        return posterior.mean, posterior.covariance

    return Pair(package, lambda: plain.condition(*prior, *arrays))


def rollout(problem: Problem, num: int, signals: int) -> Pair:
    """Weights of one or many motions of `signals` signals to positions."""
    import _core_plain as plain

    from eaip_prob.data import Trajectory
    from eaip_prob.primitives import DMP

    dmp, phase = DMP(num_basis=NUM_BASIS), problem.phase
    weights = dmp.encode(Trajectory(problem.time, problem.robot[:num]), phase, DURATION)
    weights = weights.repeat(1, signals // NUM_ROBOT) if num > 1 else weights[0]
    arrays, forcing = dmp.per_signal(weights).numpy(), dmp.forcing_design(phase)[:, :NUM_BASIS].numpy()
    return Pair(
        lambda: (dmp.decode(weights, phase, DURATION),),
        lambda: (plain.rollout(arrays, forcing, DURATION, dmp.alpha_y, dmp.beta_y),),
    )


def align(problem: Problem) -> tuple[Pair, Pair]:
    """(all samples, one more sample) of a motion against another."""
    import _core_plain as plain
    import numpy as np

    from eaip_prob.phase.alignment import OpenEnd, open_end

    query, reference = problem.new.values, problem.human[0]
    samples, columns, mask = query.numpy(), reference.numpy(), np.ones(NUM_HUMAN, dtype=bool)
    alignment = OpenEnd.start(reference)
    state, last = alignment.initial, []
    for sample in samples[:-1]:
        _, _, state = alignment.step(sample, mask, state)
        _, _, last = plain.dtw_step(sample, columns, last)

    def whole() -> tuple[int, float]:
        end_index, cost = open_end(query, reference)
        return int(end_index[-1]), float(cost[-1])

    return (
        Pair(whole, lambda: plain.dtw(samples, columns)),
        Pair(lambda: alignment.step(samples[-1], mask, state), lambda: plain.dtw_step(samples[-1], columns, last)),
    )


def predict(problem: Problem, num: int) -> Pair:
    """The first samples of the human to the robot's positions and their variances."""
    import _core_plain as plain

    design = problem.fitted.primitives["robot"].design(problem.phase, DURATION)[0].numpy()
    residual, predictor, seen = problem.fitted.residual.numpy(), problem.predictor, problem.new.first(num)
    prior, arrays = problem.prior, problem.seen(num)

    def package() -> tuple[Tensor, Tensor]:
        prediction = predictor.predict(seen, time=problem.time)
        return prediction.mean, prediction.variance

    return Pair(package, lambda: plain.predict(prior, arrays, design, residual))

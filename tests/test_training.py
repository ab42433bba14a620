from __future__ import annotations

import pytest
import torch

from eaip_prob.data.demonstrations import Demonstration, DemonstrationSet
from eaip_prob.data.trajectory import Trajectory
from eaip_prob.encoding import encode
from eaip_prob.errors import HeldOutWarning
from eaip_prob.models import GaussianJointModel, ShrinkageCovariance
from eaip_prob.phase import ElapsedClock
from eaip_prob.prediction import InteractionPredictor
from eaip_prob.primitives import DMP, ProMP

SAMPLES = 40


def demonstrations(num: int, duration: float, sensor: float = 0.0) -> DemonstrationSet:
    generator = torch.Generator().manual_seed(0)
    phase = torch.linspace(0.0, 1.0, SAMPLES, dtype=torch.float64)
    shapes = torch.stack([torch.ones_like(phase), phase, torch.sin(3 * phase), torch.cos(5 * phase)])
    result = []
    for _ in range(num):
        hidden = 2.0 * torch.randn(2, 4, generator=generator, dtype=torch.float64)
        length = duration * (1.0 + 0.4 * torch.rand(1, generator=generator, dtype=torch.float64))
        noise = sensor * torch.randn(SAMPLES, 2, generator=generator, dtype=torch.float64)
        human = Trajectory(phase * length, (hidden[:1] @ shapes).mT, ("x",))
        result.append(Demonstration(human, Trajectory(phase * length, (hidden @ shapes).mT + noise, ("u", "v"))))
    return DemonstrationSet(result, ["one"] * num)


@pytest.mark.parametrize("duration", [0.3, 4.0])
@pytest.mark.parametrize("amount", [0.1, 0.6])
def test_shrinkage_keeps_the_spread_of_the_robots_motions_at_any_tempo(duration: float, amount: float) -> None:
    motions = demonstrations(16, duration, sensor=0.3)
    model = GaussianJointModel(ShrinkageCovariance(amount))
    given = InteractionPredictor(ProMP(num_basis=5), DMP(num_basis=12), ElapsedClock(), model=model)
    with pytest.warns(HeldOutWarning, match="one group"):
        fit = given.fit(motions).fitted
    assert fit is not None and isinstance(fit.phase, ElapsedClock) and fit.phase.duration is not None
    primitive, robot = fit.primitives["robot"], motions.trajectories("robot")
    weights = encode(primitive, robot, fit.phase.encoding(motions.trajectories("human")), fit.phase.limit).weights
    phase = torch.linspace(0.0, primitive.limit, 200, dtype=torch.float64)
    shown = primitive.decode(weights, phase, fit.phase.duration).var(0, correction=0).mean(0)
    covariance = fit.model.prior.block_covariance("robot").unflatten(-1, (2, -1)).unflatten(-3, (2, -1))
    design = primitive.design(phase, fit.phase.duration)[0]
    came = torch.stack([((design @ covariance[d, :, d]) * design).sum(-1).mean() for d in range(2)])
    torch.testing.assert_close(came, shown, rtol=1e-5, atol=0)

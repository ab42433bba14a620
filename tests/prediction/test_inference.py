from __future__ import annotations

import dataclasses

import numpy as np
import pytest
import torch
from stream_world import CLOCKS, SHRINKAGE, SIGNALS, motions, quick, with_fitted

from eaip_prob.data.environment import EnvironmentFeatures
from eaip_prob.data.trajectory import Trajectory
from eaip_prob.inference import SceneEvidence, seen_share
from eaip_prob.models import KernelJointModel
from eaip_prob.prediction import InteractionPredictor
from eaip_prob.slope import Slope
from eaip_prob.trust import Trust

DOUBT = Trust((0.2, 0.6), (Slope(0.3), Slope(0.8)))
TIMES = torch.tensor([1.2, 1.9, 2.8, 4.5], dtype=torch.float64)


@pytest.fixture(scope="module")
def models() -> dict[str, InteractionPredictor]:
    fast = {"trust": False, "recalibrate": False}
    made = {name: quick(name, **fast) for name in CLOCKS}
    made["kernel"] = quick("expected", model=KernelJointModel(SHRINKAGE, bandwidth=1.5), **fast)
    return {name: with_fitted(model.fit(motions(15)), scene_trust=Trust()) for name, model in made.items()}


def new() -> tuple[Trajectory, EnvironmentFeatures]:
    test = motions(1, seed=9)[0]
    assert test.human is not None and test.environment is not None
    return test.human, test.environment


@pytest.mark.parametrize("way", ["elapsed", "expected", "kernel"])
@pytest.mark.parametrize("known", [True, False])
@pytest.mark.parametrize("seen", [2, 11, 25])
def test_trust_lies_between_the_scene_alone_and_all_evidence(
    models: dict[str, InteractionPredictor], way: str, known: bool, seen: int
) -> None:
    human, scene = new()
    model, told = models[way], scene if known else None
    without = model.predict(human.first(seen).hide(SIGNALS), told, TIMES)
    everything = model.predict(human.first(seen), told, TIMES)
    came = with_fitted(model, trust=DOUBT).predict(human.first(seen), told, TIMES)
    share = float(human.time[seen - 1] - human.time[0]) / float(everything.phase.duration)
    g = np.interp(share, [0.2, 0.6], [0.3, 0.8])
    mean = without.mean + g * (everything.mean - without.mean)
    covariance = without.covariance - (2 * g - g**2) * (without.covariance - everything.covariance)
    torch.testing.assert_close(came.mean, mean, rtol=1e-8, atol=1e-9)
    torch.testing.assert_close(came.covariance, covariance, rtol=1e-7, atol=1e-10)
    assert torch.equal(came.log_evidence, everything.log_evidence)


@pytest.mark.parametrize("trust", [Trust(), DOUBT])
@pytest.mark.parametrize("seen", [2, 25])
def test_trust_in_the_scene_lies_between_the_motion_alone_and_both(
    models: dict[str, InteractionPredictor], trust: Trust, seen: int
) -> None:
    human, scene = new()
    model = with_fitted(models["elapsed"], trust=trust)
    # The joint of motion and scene, nothing told of the scene: the clock is the same, the variance does not grow.
    joint = dataclasses.replace(models["elapsed"].require_fitted(), alone=None)
    blind = dataclasses.replace(models["elapsed"], fitted=joint).predict(human.first(seen), None, TIMES)
    everything = model.predict(human.first(seen), scene, TIMES)
    came = with_fitted(model, scene_trust=DOUBT).predict(human.first(seen), scene, TIMES)
    share = float(human.time[seen - 1] - human.time[0]) / float(everything.phase.duration)
    g = np.interp(share, [0.2, 0.6], [0.3, 0.8])
    before, growth = blind.covariance, float(everything.inflation)
    covariance = growth * before - (2 * g - g**2) * (growth * before - everything.covariance)
    torch.testing.assert_close(came.mean, blind.mean + g * (everything.mean - blind.mean), rtol=1e-8, atol=1e-9)
    torch.testing.assert_close(came.covariance, covariance, rtol=1e-7, atol=1e-10)
    unseen = with_fitted(model, scene_trust=DOUBT).predict(human.first(seen).hide(SIGNALS), scene, TIMES)
    torch.testing.assert_close(unseen.mean, model.predict(human.first(seen).hide(SIGNALS), scene, TIMES).mean)


def test_each_motion_of_a_batch_is_trusted_by_its_own_share(models: dict[str, InteractionPredictor]) -> None:
    human, scene = new()
    for way in ("marginal", "expected"):
        model = with_fitted(models[way], trust=DOUBT)
        hidden = Trajectory(human.time, human.values, SIGNALS, (torch.arange(25) < 6)[:, None].expand(25, 2))
        scenes = EnvironmentFeatures(scene.names, scene.value.expand(2, 2))
        together = model.predict([hidden, human], scenes, TIMES)
        for place, motion in enumerate((hidden, human)):
            alone = model.predict(motion, scene, TIMES)
            torch.testing.assert_close(together.mean[place], alone.mean)
            torch.testing.assert_close(together.covariance[place], alone.covariance)
        # Samples that were not seen are no evidence: time goes on, the share does not.
        assert float(seen_share(hidden, together.phase).max()) < 0.3


@pytest.mark.parametrize("way", ["expected", "kernel"])
def test_the_clock_knows_the_scene(models: dict[str, InteractionPredictor], way: str) -> None:
    human, scene = new()
    model, clock = models[way], models[way].require_fitted().phase
    far = EnvironmentFeatures(scene.names, scene.value + torch.tensor([0.15, 0.0]))
    durations = []
    for told in (None, scene, far):
        came = model.predict(human.first(5), told)
        knowing = model.require_fitted().alone.phase if told is None else clock  # pyright: ignore
        torch.testing.assert_close(came.phase.duration, knowing.estimate(human.first(5), told).duration)
        streamed, _ = model.step(human.first(5), model.init(told))
        torch.testing.assert_close(streamed.phase.duration, came.phase.duration)
        durations.append(float(came.phase.duration))
    assert len(set(durations)) == 3 and durations[2] > durations[1]


@pytest.mark.parametrize("gate", [0.25, 0.7, 1.0])
@pytest.mark.parametrize("observed", [(True, True), (False, True)])
def test_a_gate_scales_the_cross_covariances_of_the_scene(
    models: dict[str, InteractionPredictor], gate: float, observed: tuple[bool, bool]
) -> None:
    human, scene = new()
    fitted = with_fitted(models["elapsed"], gate=Slope(gate, gate, 0.0, 0.3)).require_fitted()
    error = torch.tensor([[4e-4, 0.01], [0.01, 2.0]], dtype=torch.float64)
    told = EnvironmentFeatures(scene.names, scene.value, error, torch.tensor(observed))
    joint = fitted.model.prior
    mean, covariance = joint.mean.numpy(), joint.covariance.numpy().copy()
    place = np.r_[joint.layout.slice("environment")]
    rest = np.r_[joint.layout.slice("human"), joint.layout.slice("robot")]
    covariance[np.ix_(rest, place)] *= gate
    covariance[np.ix_(place, rest)] *= gate
    kept = place[list(observed)]
    noise = (error.numpy() + np.diag(fitted.environment_noise.numpy() ** 2))[np.ix_(observed, observed)]
    innovation = covariance[np.ix_(kept, kept)] + noise
    gain = np.linalg.solve(innovation, covariance[kept]).T
    deviation = scene.value.numpy()[list(observed)] - mean[kept]
    came = fitted.model.posterior(SceneEvidence.of(fitted, told).observations, keep=("human", "robot"))
    expected = covariance - gain @ covariance[kept]
    np.testing.assert_allclose(came.components.mean[0], (mean + gain @ deviation)[rest], rtol=1e-6, atol=1e-8)
    np.testing.assert_allclose(
        came.components.covariance.reshape(len(rest), -1), expected[np.ix_(rest, rest)], atol=1e-8
    )
    growth = 1.0 + deviation @ np.linalg.solve(innovation, deviation) / 15
    assert float(SceneEvidence.of(fitted, told).growth) == pytest.approx(growth, rel=1e-9)


@pytest.mark.parametrize("way", list(CLOCKS))
def test_default_times_reach_the_expected_end_at_the_demonstrated_step(
    models: dict[str, InteractionPredictor], way: str
) -> None:
    human, scene = new()
    for seen in (1, 9, 25):
        came, step = models[way].predict(human.first(seen), scene), models[way].require_fitted().step
        expected = human.time[0] + float(came.phase.duration.max())
        end = max(float(expected), float(human.time[seen - 1]))
        assert came.time[0] == human.time[0]
        torch.testing.assert_close(came.time.diff(), torch.full_like(came.time[1:], step))
        assert end - 1e-5 * step <= float(came.time[-1]) < end + step

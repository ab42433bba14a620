from __future__ import annotations

import dataclasses

import pytest
import torch
from prediction_world import DURATION, demonstrations, observation, predictor, scaled

from eaip_prob.data.demonstrations import Demonstration, DemonstrationSet
from eaip_prob.data.environment import EnvironmentFeatures
from eaip_prob.data.trajectory import Trajectory
from eaip_prob.observation import LinearObservation
from eaip_prob.prediction import InteractionPredictor
from eaip_prob.primitives import DMP, initial_boundary


def test_nothing_detected_is_ip_to_the_last_digit(fitted: InteractionPredictor) -> None:
    seen, scene = observation()
    nothing = torch.zeros(2, dtype=torch.bool)
    ip = fitted.predict(seen)
    for other in (
        EnvironmentFeatures.unseen(("width", "height")),
        EnvironmentFeatures.unseen(("height", "width")),
        dataclasses.replace(scene, observed=nothing),
    ):
        came = fitted.predict(seen, other)
        assert torch.equal(came.mean, ip.mean)
        assert torch.equal(came.covariance, ip.covariance)
        assert torch.equal(came.log_evidence, ip.log_evidence)


def test_hidden_human_without_a_scene_is_the_prior(fitted: InteractionPredictor) -> None:
    seen, _ = observation()
    came = fitted.predict(seen.hide(["x"]))
    assert fitted.fitted is not None
    prior = fitted.fitted.model.prior
    robot = fitted.fitted.primitives["robot"]
    expected = robot.decode(prior.block_mean("robot"), came.time / DURATION)
    torch.testing.assert_close(came.mean, expected, rtol=1e-12, atol=1e-12)
    assert float(came.log_evidence) == 0.0
    assert bool((came.variance >= fitted.predict(seen).variance - 1e-9).all())


def test_hidden_human_with_a_scene_is_the_scene_alone(fitted: InteractionPredictor) -> None:
    seen, scene = observation()
    came = fitted.predict(seen.hide(["x"]), scene)
    other = fitted.predict(scaled(seen, -7.0).hide(["x"]), scene)
    assert torch.equal(came.mean, other.mean)
    assert not torch.allclose(came.mean, fitted.predict(seen.hide(["x"])).mean)


def test_one_feature_of_two(fitted: InteractionPredictor) -> None:
    seen, scene = observation()
    part = dataclasses.replace(scene, observed=torch.tensor([True, False]))
    joint = fitted.fitted
    assert joint is not None
    row = LinearObservation(
        {"environment": torch.tensor([[1.0, 0.0]])},
        torch.zeros(1),
        scene.value[:1],
        joint.environment_noise[:1].square(),
    )
    came, expected = fitted.predict(seen, part), fitted.predict(seen, also=[row])
    torch.testing.assert_close(came.mean, expected.mean, rtol=1e-8, atol=1e-8)
    torch.testing.assert_close(came.log_evidence, expected.log_evidence)


def test_order_of_the_features_does_not_matter(fitted: InteractionPredictor) -> None:
    seen, scene = observation()
    scene = dataclasses.replace(scene, covariance=torch.tensor([[0.1, 0.2], [0.2, 9.0]]))
    one, other = (fitted.predict(seen, part) for part in (scene, scene.ordered_as(("height", "width"))))
    assert torch.equal(one.mean, other.mean)
    assert torch.equal(one.covariance, other.covariance)


def test_sensor_covariance_of_the_scene_counts(fitted: InteractionPredictor) -> None:
    seen, scene = observation()
    vague = dataclasses.replace(scene, covariance=1e12 * torch.eye(2))
    torch.testing.assert_close(fitted.predict(seen, vague).mean, fitted.predict(seen).mean, rtol=1e-5, atol=1e-5)


@pytest.mark.parametrize("which", ["fitted", "ragged", "papers"])
def test_batch_equals_loop(which: str, request: pytest.FixtureRequest) -> None:
    model = request.getfixturevalue(which)
    model = model["robot"] if which == "papers" else model
    motions = demonstrations(6, seed=8, ragged=which != "fitted")
    humans, scenes = motions.trajectories("human"), motions.environments
    assert scenes is not None
    batch = humans.first(11)
    time = torch.linspace(0, 3.0, 7, dtype=torch.float64)
    whole = model.predict(batch, scenes, time=time)
    assert whole.mean.shape == (6, 7, 2)
    shape = (2, 3)
    folded = model.predict(
        Trajectory(batch.time.expand(6, 11).reshape(*shape, 11), batch.values.reshape(*shape, 11, 1), ("x",)),
        EnvironmentFeatures(scenes.names, scenes.value.reshape(*shape, 2)),
        time=time,
    )
    torch.testing.assert_close(folded.mean.flatten(0, 1), whole.mean, rtol=1e-8, atol=1e-8)
    torch.testing.assert_close(
        folded.covariance.flatten(0, 1), whole.covariance.expand(6, -1, -1, -1), rtol=1e-7, atol=1e-8
    )
    for i in range(6):
        one = model.predict(batch[i], scenes[i], time=time)
        torch.testing.assert_close(whole.mean[i], one.mean, rtol=1e-8, atol=1e-8)
        torch.testing.assert_close(whole.variance.expand(6, -1, -1)[i], one.variance, rtol=1e-7, atol=1e-8)
        torch.testing.assert_close(whole.log_evidence[i], one.log_evidence)


def test_list_of_motions_of_several_lengths(ragged: InteractionPredictor) -> None:
    seen = [
        one.human.first(n)
        for one, n in zip(demonstrations(3, seed=8, ragged=True), (4, 20, 9), strict=True)
        if one.human
    ]
    time = torch.linspace(0, 3.0, 7, dtype=torch.float64)
    whole = ragged.predict(seen, time=time)
    for i, one in enumerate(seen):
        alone = ragged.predict(one, time=time)
        torch.testing.assert_close(whole.mean[i], alone.mean, rtol=1e-7, atol=1e-7)
        torch.testing.assert_close(whole.log_evidence[i], alone.log_evidence, rtol=1e-7, atol=1e-7)


@pytest.mark.parametrize("target", ["human", "robot"])
def test_paper_set_up(papers: dict[str, InteractionPredictor], target: str) -> None:
    model = papers[target]
    motions = demonstrations(8, seed=4, ragged=True)
    humans = motions.trajectories("human")
    truth = motions.trajectories(target)
    came = model.predict(humans.first(20), motions.environments, time=truth.time)
    prior = model.predict(humans.first(20).hide(["x"]), time=truth.time)
    assert came.mean.shape == truth.values.shape
    error, without = (
        (part.mean - truth.values)[truth.mask.expand_as(part.mean)].square().mean() for part in (came, prior)
    )
    assert error < 0.6 * without


def test_paper_motion_starts_where_it_was_seen(papers: dict[str, InteractionPredictor]) -> None:
    seen, scene = observation(seen=9)
    came = papers["human"].predict(seen, scene, time=seen.time)
    torch.testing.assert_close(came.mean[0], seen.values[0], rtol=1e-9, atol=1e-9)
    hidden = papers["human"].predict(seen.hide(["x"]), scene, time=seen.time)
    assert papers["human"].fitted is not None
    torch.testing.assert_close(hidden.mean[0], papers["human"].fitted.boundary.start, rtol=1e-9, atol=1e-9)


def test_positions_of_a_motion_whose_start_is_given() -> None:
    given = predictor(noise=0.1, environment_noise=1.0, recalibrate=False)
    model = dataclasses.replace(given, human=DMP(num_basis=6, boundary="given")).fit(demonstrations(12))
    assert model.fitted is not None
    seen, _ = observation(seen=9)
    start = initial_boundary(seen)
    design, offset = model.fitted.primitives["human"].design(seen.time / DURATION, DURATION, start)
    rows = LinearObservation({"human": design}, offset[0], seen.values[:, 0], torch.full((9,), 0.01))
    came, expected = model.predict(seen), model.predict(seen.hide(["x"]), also=[rows])
    torch.testing.assert_close(came.mean, expected.mean, rtol=1e-7, atol=1e-7)
    torch.testing.assert_close(came.log_evidence, expected.log_evidence)


def test_forces_need_three_samples(papers: dict[str, InteractionPredictor]) -> None:
    seen, _ = observation(seen=2)
    assert float(papers["robot"].predict(seen).log_evidence) == 0.0


def test_own_motion_follows_what_was_seen() -> None:
    motions = demonstrations(24, groups=2)
    alone = DemonstrationSet([Demonstration(one.human, environment=one.environment) for one in motions], motions.groups)
    model = predictor(target="human").fit(alone)
    seen, scene = observation(seen=20)
    came = model.predict(seen, scene, time=seen.time)
    assert came.names == ("x",)
    assert (came.mean - seen.values).abs().max() < 0.2
    assert bool((came.variance < model.predict(seen.first(2), scene, time=seen.time).variance + 1e-9).all())


def test_other_noise_without_another_fit(fitted: InteractionPredictor) -> None:
    seen, scene = observation()
    assert fitted.fitted is not None
    assert torch.equal(fitted.with_noise().predict(seen, scene).mean, fitted.predict(seen, scene).mean)
    deaf = fitted.with_noise(noise=1e6, environment_noise=torch.tensor([1e6, 1e6]))
    prior = fitted.predict(seen.hide(["x"]))
    torch.testing.assert_close(deaf.predict(seen, scene).mean, prior.mean, rtol=1e-5, atol=1e-5)
    assert float(fitted.fitted.noise) < 1e3

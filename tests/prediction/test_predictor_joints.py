from __future__ import annotations

import dataclasses

import pytest
import torch
from prediction_world import changed, demonstrations, full, observation, predictor

from eaip_prob.data.demonstrations import Demonstration, DemonstrationSet
from eaip_prob.data.environment import EnvironmentFeatures
from eaip_prob.data.features import RawFeatures
from eaip_prob.data.trajectory import Trajectory
from eaip_prob.errors import InputError
from eaip_prob.forecast import Prediction
from eaip_prob.prediction import InteractionPredictor
from eaip_prob.slope import Slope
from eaip_prob.trust import Trust


def same(one: Prediction, other: Prediction, tolerance: float = 1e-12) -> None:
    for name in ("time", "mean", "covariance", "log_evidence"):
        torch.testing.assert_close(getattr(one, name), getattr(other, name), rtol=tolerance, atol=tolerance, msg=name)


@pytest.fixture(scope="module")
def motions() -> DemonstrationSet:
    return demonstrations(18, groups=3, ragged=True)


@pytest.fixture(scope="module")
def both(motions: DemonstrationSet) -> InteractionPredictor:
    return full().fit(motions)


def test_documented_defaults(both: InteractionPredictor) -> None:
    assert both.gate and both.trust and both.separate and len(both.maps) == 2
    assert both.fitted is not None and both.fitted.alone is not None
    assert both.fitted.gate.value > 0.5 and both.fitted.alone.alone is None


def test_without_a_scene_it_is_the_predictor_fitted_without_one(
    both: InteractionPredictor, motions: DemonstrationSet
) -> None:
    alone = full().fit(motions.without_environment())
    new = demonstrations(5, seed=9, ragged=True).trajectories("human")
    for seen in (new.first(3), new.first(14), new[2].first(9), new.first(9).hide(["x"])):
        same(both.predict(seen, None), alone.predict(seen))


@pytest.mark.parametrize("make", [predictor, full])
def test_a_scene_of_which_nothing_was_observed_is_none(make, motions: DemonstrationSet) -> None:
    model = make(noise=0.05, environment_noise=0.5).fit(motions)
    new = demonstrations(4, seed=9, ragged=True)
    seen, scenes = new.trajectories("human").first(11), new.environments
    assert scenes is not None
    # What stands in the place of a feature that was not observed must not matter, nor must the order.
    unseen = EnvironmentFeatures(("height", "width"), scenes.value * 1e3, observed=torch.zeros(4, 2, dtype=torch.bool))
    same(model.predict(seen, unseen), model.predict(seen, None))
    same(model.predict(seen[1], EnvironmentFeatures.unseen(("width", "height"))), model.predict(seen[1]))


def gated(model: InteractionPredictor, value: float) -> InteractionPredictor:
    assert model.fitted is not None
    return dataclasses.replace(model, fitted=dataclasses.replace(model.fitted, gate=Slope(value=value)))


def test_a_gate_of_zero_is_a_prediction_without_the_scene(both: InteractionPredictor) -> None:
    closed, (seen, scene) = gated(both, 0.0), observation(seen=9)
    same(closed.predict(seen, scene), both.predict(seen))
    # The variance grows with nothing that was not used, and nobody is warned of it.
    same(closed.predict(seen, dataclasses.replace(scene, value=scene.value * 50.0)), both.predict(seen))
    assert (both.predict(seen, scene).mean - both.predict(seen).mean).abs().max() > 0.01


def test_a_gate_of_zero_in_one_joint_moves_no_mean(motions: DemonstrationSet) -> None:
    model = predictor(noise=0.05, environment_noise=0.5).fit(motions)
    seen, scene = observation(seen=9)
    one, other = gated(model, 0.0).predict(seen, scene), model.predict(seen)
    torch.testing.assert_close(one.mean, other.mean, rtol=1e-12, atol=1e-12)
    torch.testing.assert_close(
        one.posterior.covariance("robot"), other.posterior.covariance("robot"), rtol=1e-12, atol=1e-12
    )


def foreign(motions: DemonstrationSet, seed: int) -> DemonstrationSet:
    """Every motion with a scene that has nothing to do with it."""
    generator = torch.Generator().manual_seed(seed)
    scenes = torch.randn(len(motions), 2, generator=generator, dtype=torch.float64) * 20.0 + 100.0
    return DemonstrationSet(
        [
            Demonstration(one.human, one.robot, EnvironmentFeatures(("width", "height"), scenes[i]))
            for i, one in enumerate(motions)
        ],
        motions.groups,
    )


# A gate opens above one standard error, which one useless scene in six reaches by chance.
@pytest.mark.parametrize("seed", [3, 5])
def test_a_scene_that_tells_nothing_is_not_used(seed: int) -> None:
    motions = demonstrations(30, seed=seed, groups=10)
    given = full(noise=0.05, environment_noise=1.0, features=RawFeatures())
    told, blind = (given.fit(part) for part in (motions, foreign(motions, 1000 + seed)))
    assert told.fitted is not None and blind.fitted is not None
    assert told.fitted.gate.value > 0.5 and told.fitted.gate.explained > 0.2
    assert blind.fitted.gate.value == 0.0 and blind.fitted.gate.explained == 0.0
    seen, scene = observation(seed=40 + seed)
    same(blind.predict(seen, scene), blind.predict(seen))


def test_scenes_of_some_motions_only(both: InteractionPredictor, motions: DemonstrationSet) -> None:
    new = demonstrations(6, seed=9)
    seen, scenes = new.trajectories("human").first(11), new.environments
    assert scenes is not None
    observed = torch.ones(6, 2, dtype=torch.bool)
    observed[[1, 4]] = False
    observed[0, 1] = False
    part = dataclasses.replace(scenes, observed=observed)
    with pytest.raises(InputError, match=r"for all motions of a batch or for none, got 4 of 6\. .* two calls"):
        both.predict(seen, part)
    same(gated(both, 0.0).predict(seen, part), both.predict(seen))
    model = predictor(noise=0.05, environment_noise=0.5).fit(motions)
    whole = model.predict(seen, part, time=seen.time)
    for i in range(6):
        one = model.predict(seen[i], part[i], time=seen[i].time)
        torch.testing.assert_close(whole.mean[i], one.mean, rtol=1e-9, atol=1e-9)
        torch.testing.assert_close(whole.variance[i], one.variance, rtol=1e-9, atol=1e-9)
    same(both.predict(seen[[1, 4]], part[[1, 4]]), both.predict(seen[[1, 4]]))


def test_a_batch_that_was_partly_observed_is_its_members(both: InteractionPredictor) -> None:
    new = demonstrations(6, seed=9, ragged=True)
    humans, scenes = new.trajectories("human").first(11), new.environments
    assert scenes is not None
    observed = torch.ones(6, 2, dtype=torch.bool)
    observed[[0, 3], [1, 0]] = False
    part = dataclasses.replace(scenes, observed=observed)
    time = torch.linspace(0, 3.0, 7, dtype=torch.float64)
    folded = both.predict(
        Trajectory(humans.time.expand(6, 11).reshape(2, 3, 11), humans.values.reshape(2, 3, 11, 1), ("x",)),
        EnvironmentFeatures(part.names, part.value.reshape(2, 3, 2), observed=observed.reshape(2, 3, 2)),
        time=time,
    )
    for i in range(6):
        one = both.predict(humans[i], part[i], time=time)
        torch.testing.assert_close(folded.mean[i // 3, i % 3], one.mean, rtol=1e-8, atol=1e-8)
        torch.testing.assert_close(folded.covariance[i // 3, i % 3], one.covariance, rtol=1e-7, atol=1e-8)


def test_other_noise_reaches_both_joints(both: InteractionPredictor) -> None:
    seen, scene = observation()
    # Beside a motion that tells nothing the scene would be believed less: that is another matter.
    both = dataclasses.replace(both, fitted=dataclasses.replace(both.require_fitted(), scene_trust=Trust()))
    deaf = both.with_noise(noise=1e6)
    hidden = seen.hide(["x"])
    for features in (None, scene):
        one, other = deaf.predict(seen, features), both.predict(hidden, features)
        torch.testing.assert_close(one.mean, other.mean, rtol=1e-5, atol=1e-5)
    blind = both.with_noise(environment_noise=torch.tensor([1.0, 2.0]))
    same(blind.predict(seen), both.predict(seen))
    assert not torch.allclose(blind.predict(seen, scene).mean, both.predict(seen, scene).mean)


def test_without_scenes_there_is_one_joint() -> None:
    motions = changed(demonstrations(9), lambda one: dataclasses.replace(one, environment=None))
    fitted = full(noise=0.05).fit(motions).fitted
    assert fitted is not None and fitted.alone is None and fitted.features is None and fitted.scenes is None
    assert fitted.gate == Slope()


def test_one_joint_where_another_is_not_wanted(motions: DemonstrationSet) -> None:
    model = full(separate=False, noise=0.05).fit(motions)
    assert model.fitted is not None and model.fitted.alone is None
    seen, _ = observation()
    assert torch.isfinite(model.predict(seen).mean).all()

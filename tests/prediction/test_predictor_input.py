from __future__ import annotations

import dataclasses
from collections.abc import Callable
from contextlib import AbstractContextManager, nullcontext

import numpy as np
import pytest
import torch
from prediction_world import ROBOT, SAMPLES, changed, demonstrations, full, observation, predictor, scaled

from eaip_prob.data.demonstrations import Demonstration, DemonstrationSet
from eaip_prob.data.environment import EnvironmentFeatures
from eaip_prob.data.trajectory import Trajectory
from eaip_prob.errors import ExtrapolationWarning, HeldOutWarning, InputError, NotFittedError
from eaip_prob.prediction import InteractionPredictor
from eaip_prob.primitives import DMP, AbstractPrimitive


@pytest.mark.parametrize("make", [predictor, full])
def test_deterministic_and_without_side_effects(make: Callable[..., InteractionPredictor]) -> None:
    motions = demonstrations(12)
    before = [one.human.values.clone() for one in motions if one.human]
    given = make(noise=0.05)
    models = [given.fit(motions) for _ in range(2)]
    assert given.fitted is None
    assert all(torch.equal(one.human.values, b) for one, b in zip(motions, before, strict=True) if one.human)
    seen, scene = observation()
    values, features = seen.values.clone(), scene.value.clone()
    first, second, third = (
        models[0].predict(seen, scene),
        models[0].predict(seen, scene),
        models[1].predict(seen, scene),
    )
    assert torch.equal(first.mean, second.mean) and torch.equal(first.mean, third.mean)
    assert torch.equal(first.covariance, third.covariance)
    assert torch.equal(seen.values, values) and torch.equal(scene.value, features)


def in_other_units(one: Demonstration, robot: float, human: float, scene: float) -> Demonstration:
    assert one.human is not None and one.robot is not None and one.environment is not None
    factor = torch.tensor([scene, 1.0], dtype=torch.float64)
    features = EnvironmentFeatures(one.environment.names, one.environment.value * factor)
    return Demonstration(scaled(one.human, human), scaled(one.robot, robot), features)


@pytest.fixture(scope="module")
def small() -> dict[str, InteractionPredictor]:
    motions = demonstrations(8, groups=2)
    made = {"promp": predictor(), "dmp": predictor(DMP(num_basis=5)), "full": full()}
    return {name: one.fit(motions) for name, one in made.items()}


@pytest.mark.parametrize(
    ("name", "factors"),
    [
        ("promp", (1000.0, 1.0, 1.0)),
        ("promp", (1.0, 1000.0, 1.0)),
        ("promp", (1.0, 1.0, 1000.0)),
        ("dmp", (1e-3, 50.0, 7.0)),
        ("full", (1e-3, 50.0, 7.0)),
    ],
)
def test_units_change_nothing_but_the_units(
    small: dict[str, InteractionPredictor], name: str, factors: tuple[float, float, float]
) -> None:
    motions, new = demonstrations(8, groups=2), demonstrations(1, seed=3, groups=None)[0]
    given = dataclasses.replace(small[name], fitted=None)
    models = [small[name], given.fit(changed(motions, lambda one: in_other_units(one, *factors)))]
    told = [new, in_other_units(new, *factors)]
    one, other = (
        model.predict(t.human.first(9), t.environment) for model, t in zip(models, told, strict=True) if t.human
    )
    assert models[0].fitted is not None and models[1].fitted is not None
    np.testing.assert_allclose(models[1].fitted.inflation, models[0].fitted.inflation, rtol=1e-6)
    torch.testing.assert_close(models[1].fitted.noise, models[0].fitted.noise * factors[1], rtol=1e-9, atol=0)
    torch.testing.assert_close(other.mean, one.mean * factors[0], rtol=1e-6, atol=1e-6 * factors[0])
    torch.testing.assert_close(other.variance, one.variance * factors[0] ** 2, rtol=1e-5, atol=0)


def constant(one: Demonstration, agent: str, value: float) -> Demonstration:
    trajectory = getattr(one, agent)
    values = trajectory.values.clone()
    values[:, -1] = value
    return dataclasses.replace(one, **{agent: dataclasses.replace(trajectory, values=values)})


DEGENERATE: dict[str, Callable[[DemonstrationSet], DemonstrationSet]] = {
    "two": lambda motions: motions[:2],
    "three": lambda motions: DemonstrationSet(list(motions)[:3]),
    "one group": lambda motions: DemonstrationSet(list(motions), ["a"] * len(motions)),
    "all equal": lambda motions: DemonstrationSet([motions[0]] * 6, [0, 0, 0, 1, 1, 1]),
    "zero robot signal": lambda motions: changed(motions, lambda one: constant(one, "robot", 0.0)),
    "constant robot signal": lambda motions: changed(motions, lambda one: constant(one, "robot", 0.7)),
    "constant human": lambda motions: changed(motions, lambda one: constant(one, "human", 0.7)),
    "short robot": lambda motions: changed(
        motions, lambda one: dataclasses.replace(one, robot=one.robot.first(2) if one.robot else None)
    ),
    "constant features": lambda motions: changed(
        motions, lambda one: dataclasses.replace(one, environment=EnvironmentFeatures(("width", "height"), [0.1, 0.0]))
    ),
    "beginnings not seen": lambda motions: changed(
        motions,
        lambda one: dataclasses.replace(
            one, human=dataclasses.replace(one.human, mask=(torch.arange(SAMPLES) > 8)[:, None]) if one.human else None
        ),
    ),
}


WARNED = {"two": (HeldOutWarning, "of one group"), "one group": (HeldOutWarning, r"of one group \('a'\)")}
# A scene that told nothing of groups left out is not used, however far it is.
FAR = {"two", "all equal", "constant features"}


def warned(kind: type[Warning], message: str | None) -> AbstractContextManager[object]:
    return nullcontext() if message is None else pytest.warns(kind, match=message)


@pytest.mark.parametrize("make", [predictor, full])
@pytest.mark.parametrize("primitive", [ROBOT, DMP(num_basis=5)])
@pytest.mark.parametrize("kind", list(DEGENERATE))
def test_degenerate_demonstrations(
    kind: str, primitive: AbstractPrimitive, make: Callable[..., InteractionPredictor]
) -> None:
    with warned(*WARNED.get(kind, (Warning, None))):
        model = make(primitive).fit(DEGENERATE[kind](demonstrations(8, groups=2)))
    seen, scene = observation()
    for features in (None, scene):
        used = model.fitted is not None and model.fitted.gate.value > 0
        far = "lies far outside the demonstrations" if features is not None and used and kind in FAR else None
        with warned(ExtrapolationWarning, far):
            came = model.predict(seen, features)
        assert bool(torch.isfinite(came.mean).all() and torch.isfinite(came.log_evidence).all())
        assert bool((came.variance > 0).all() and torch.isfinite(came.variance).all())


def test_demonstrations_without_a_scene() -> None:
    motions = changed(demonstrations(8, groups=2), lambda one: dataclasses.replace(one, environment=None))
    model = predictor().fit(motions)
    seen, scene = observation()
    assert torch.isfinite(model.predict(seen).mean).all()
    with pytest.raises(InputError, match="the demonstrations had none"):
        model.predict(seen, scene)


def test_input_that_cannot_be_used(fitted: InteractionPredictor) -> None:
    seen, scene = observation()
    with pytest.raises(InputError, match=r"human signals \('x',\), as fitted, got \('y',\)"):
        fitted.predict(dataclasses.replace(seen, names=("y",)))
    with pytest.raises(InputError, match="Expected environment features"):
        fitted.predict(seen, EnvironmentFeatures(("width", "depth"), scene.value))
    with pytest.raises(InputError, match="at least one trajectory"):
        fitted.predict([])
    with pytest.raises(InputError, match="finite numbers in values"):
        fitted.predict(Trajectory(seen.time, seen.values * torch.nan, ("x",)))
    with pytest.raises(NotFittedError, match="fitted predictor"):
        predictor().predict(seen)
    with pytest.raises(NotFittedError, match="fitted predictor"):
        predictor().with_noise(1.0)
    with pytest.raises(InputError, match="at least two demonstrations"):
        predictor().fit(demonstrations(1, groups=None))
    with pytest.raises(InputError, match="target 'human' or 'robot'"):
        predictor(target="table")
    with pytest.raises(InputError, match="criterion 'prediction' or 'evidence'"):
        predictor(criterion="luck")
    with pytest.raises(InputError, match="noise as one standard deviation or 1 of them"):
        predictor(noise=[0.1, 0.2]).fit(demonstrations(4))
    with pytest.raises(InputError, match="environment_noise as one standard deviation or 2"):
        predictor(environment_noise=-1.0).fit(demonstrations(4))


def test_agents_that_are_missing() -> None:
    humans = changed(demonstrations(4), lambda one: dataclasses.replace(one, robot=None))
    robots = changed(demonstrations(4), lambda one: dataclasses.replace(one, human=None))
    for motions in (humans, robots):
        with pytest.raises(InputError, match="of the target 'robot'"):
            predictor().fit(motions)

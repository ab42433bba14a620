from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from stream_world import CLOCKS, SCENE, SHRINKAGE, SIGNALS, motions, quick, with_fitted
from torch import Tensor

from eaip_prob.data.environment import EnvironmentFeatures
from eaip_prob.data.trajectory import Trajectory
from eaip_prob.errors import InputError, NotFittedError
from eaip_prob.forecast import Prediction
from eaip_prob.models import KernelJointModel
from eaip_prob.prediction import InteractionPredictor
from eaip_prob.slope import Slope
from eaip_prob.trust import Trust

DOUBT = Trust((0.2, 0.6), (Slope(0.3), Slope(0.8)))
HALF = Trust((0.1, 0.7), (Slope(0.9), Slope(0.4)))
TIMES = torch.tensor([1.2, 1.9, 2.8, 4.5], dtype=torch.float64)


@pytest.fixture(scope="module")
def models() -> dict[str, InteractionPredictor]:
    kernel, seen = KernelJointModel(SHRINKAGE, bandwidth=1.5), motions(15)
    fast = {"trust": False, "recalibrate": False}
    found = {name: quick(name, **fast).fit(seen) for name in CLOCKS}
    return found | {f"{name}, kernel": quick(name, model=kernel, **fast).fit(seen) for name in ("expected", "marginal")}


def assert_same(came: Prediction, expected: Prediction) -> None:
    pairs = [(getattr(came, name), getattr(expected, name)) for name in ("time", "mean", "variance", "covariance")]
    pairs += [(came.log_evidence, expected.log_evidence), (came.quantile(0.2), expected.quantile(0.2))]
    for one, other in pairs:
        assert one.shape == other.shape
        assert float((one - other).abs().max()) <= 1e-9 * max(1.0, float(other.abs().max()))


@dataclass(frozen=True)
class Arrivals:
    """Frames in the order in which they came, the scenes that came with them, and what is known in the end."""

    frames: Sequence[Trajectory]
    scenes: Sequence[EnvironmentFeatures | None]

    @property
    def scene(self) -> EnvironmentFeatures | None:
        return next((scene for scene in reversed(self.scenes) if scene is not None), None)

    @property
    def together(self) -> Trajectory:
        """Entry by entry, the later arrival over the earlier one; errors of two frames are independent."""
        found: dict[float, tuple[list[float], list[bool], np.ndarray]] = {}
        for frame in self.frames:
            for row, time in enumerate(frame.time.tolist()):
                values, mask, noise = found.setdefault(time, ([0.0, 0.0], [False, False], np.zeros((2, 2))))
                for i in (i for i in range(2) if frame.mask[row, i]):
                    values[i], mask[i] = float(frame.values[row, i]), True
                    noise[i] = noise[:, i] = 0.0
                    for j in (j for j in range(2) if frame.noise is not None and frame.mask[row, j]):
                        noise[i, j] = noise[j, i] = float(frame.noise[row, i, j])  # pyright: ignore
        times = sorted(found)
        values, mask, noise = (np.array([found[time][part] for time in times]) for part in range(3))
        given = None if self.frames[0].noise is None else torch.tensor(noise)
        return Trajectory(times, torch.tensor(values), SIGNALS, torch.tensor(mask), given)


@st.composite
def arrivals(draw: st.DrawFn, scenes: bool = True) -> Arrivals:
    gaps = draw(st.lists(st.floats(0.002, 0.4), min_size=1, max_size=8))
    clock = 1.7 + np.cumsum(gaps)
    noise = draw(st.sampled_from(["none", "independent", "correlated"]))
    random = np.random.default_rng(draw(st.integers(0, 2**31)))
    places = draw(st.lists(st.lists(st.integers(0, len(gaps) - 1), min_size=1, max_size=3), min_size=1, max_size=8))
    frames = []
    for chosen in places:
        times = clock[sorted(set(chosen))]
        mask = torch.tensor([draw(st.tuples(st.booleans(), st.booleans())) for _ in times])
        root = 0.05 * random.normal(size=(len(times), 2, 2))
        covariance = {"none": None, "independent": np.eye(2) * root**2, "correlated": root @ root.transpose(0, 2, 1)}
        values = torch.tensor(random.normal([1.0, 0.3], [0.8, 0.5], (len(times), 2)))
        frames.append(Trajectory(times, values, SIGNALS, mask, covariance[noise]))
    told = [draw(st.none() | seen_scenes()) if scenes else None for _ in frames]
    return Arrivals(frames, told)


@st.composite
def seen_scenes(draw: st.DrawFn) -> EnvironmentFeatures:
    value = [draw(st.floats(0.45, 0.75)), draw(st.floats(78.0, 102.0))]
    observed = torch.tensor(draw(st.tuples(st.booleans(), st.booleans())))
    error = torch.diag(torch.tensor([0.01, 2.0])) ** 2 * draw(st.sampled_from([0.0, 1.0]))
    scene = EnvironmentFeatures(SCENE, value, error, observed)
    return scene.ordered_as(SCENE[::-1]) if draw(st.booleans()) else scene


def followed(model: InteractionPredictor, came: Arrivals, time: Tensor | None = None) -> Prediction:
    state = model.init(came.scenes[0])
    prediction = None
    for place, (frame, scene) in enumerate(zip(came.frames, came.scenes, strict=True)):
        prediction, state = model.step(frame, state, scene if place else None, time)
    assert prediction is not None
    return prediction


WAYS = [*CLOCKS, "expected, kernel", "marginal, kernel"]


@pytest.mark.parametrize("way", WAYS)
@pytest.mark.parametrize("doubt", [False, True])
def test_a_stream_equals_the_prediction_from_all_of_it(
    models: dict[str, InteractionPredictor], way: str, doubt: bool
) -> None:
    model = with_fitted(
        models[way], inflation=0.6, trust=DOUBT if doubt else Trust(), scene_trust=HALF if doubt else Trust()
    )

    @settings(max_examples=20, deadline=None, derandomize=True, database=None)
    @given(arrivals(), st.booleans())
    def check(came: Arrivals, asked: bool) -> None:
        time = TIMES if asked else None
        assert_same(followed(model, came, time), model.predict(came.together, came.scene, time=time))

    check()


@pytest.mark.parametrize("target", ["robot", "human"])
@pytest.mark.parametrize("separate", [True, False])
def test_every_step_of_a_motion(target: str, separate: bool) -> None:
    model = with_fitted(
        quick("expected", target=target, separate=separate).fit(motions(12)), trust=DOUBT, scene_trust=HALF
    )
    test = motions(1, seed=9)[0]
    assert test.human is not None
    for scene in (None, test.environment):
        state = model.init(scene)
        for place in range(1, 26, 3):
            frame = test.human.first(min(place + 2, 25)).last(min(3, 26 - place))
            prediction, state = model.step(frame, state)
            assert_same(prediction, model.predict(test.human.first(min(place + 2, 25)), scene))


def told(width: float = 0.7, observed: tuple[bool, bool] = (True, True)) -> EnvironmentFeatures:
    return EnvironmentFeatures(SCENE, [width, 95.0], observed=torch.tensor(observed))


@pytest.mark.parametrize("way", ["expected", "marginal, kernel"])
def test_a_scene_that_comes_changes_and_goes(models: dict[str, InteractionPredictor], way: str) -> None:
    model, test = with_fitted(models[way], trust=DOUBT, scene_trust=HALF), motions(1, seed=9)[0].human
    assert test is not None
    history = [None, told(), None, told(0.5), told(0.5, (True, False)), EnvironmentFeatures.unseen(SCENE), None, told()]
    state, known, means = model.init(), None, []
    for place, scene in enumerate(history):
        known = known if scene is None else scene
        prediction, state = model.step(test.first(place + 1).last(1), state, scene, TIMES)
        assert_same(prediction, model.predict(test.first(place + 1), known, TIMES))
        means.append(prediction.mean)
    assert_same(model.step(test.first(9).last(1), state, time=TIMES)[0], model.predict(test.first(9), told(), TIMES))
    assert all(float((one - two).abs().max()) > 1e-4 for one, two in zip(means, means[1:], strict=False))


@pytest.mark.parametrize("way", ["expected", "marginal"])
def test_a_gate_that_is_closed(models: dict[str, InteractionPredictor], way: str) -> None:
    model, test = with_fitted(models[way], gate=Slope(0.0, 0.0, 1.0, 0.0)), motions(1, seed=9)[0].human
    assert test is not None
    prediction, _ = model.step(test.first(5), model.init(told()), time=TIMES)
    assert_same(prediction, model.predict(test.first(5), None, TIMES))


def test_states_are_values(models: dict[str, InteractionPredictor]) -> None:
    model, test = with_fitted(models["marginal"], trust=DOUBT, scene_trust=HALF), motions(1, seed=9)[0]
    assert test.human is not None
    states, predictions = [model.init(test.environment)], []
    for place in range(6):
        prediction, state = model.step(test.human.first(place + 1).last(1), states[-1])
        states.append(state)
        predictions.append(prediction)
    away, _ = model.step(test.human.last(2), states[3], told(0.5))
    for place in reversed(range(6)):
        again, _ = model.step(test.human.first(place + 1).last(1), states[place])
        assert torch.equal(again.mean, predictions[place].mean)
        assert torch.equal(again.covariance, predictions[place].covariance)
    assert float((away.mean[0] - predictions[3].mean[0]).abs().max()) > 1e-4
    # Two people at a time, each with a state of their own.
    other, _ = model.step(test.human.last(1), model.init())
    assert states[0].observed is None and other.mean.shape[-1] == 3


@pytest.mark.parametrize("way", WAYS)
def test_frames_on_which_nothing_was_seen(models: dict[str, InteractionPredictor], way: str) -> None:
    model, test = with_fitted(models[way], trust=DOUBT, scene_trust=HALF), motions(1, seed=9)[0]
    assert test.human is not None
    hidden = dataclasses.replace(test.human, mask=test.human.mask & (torch.arange(25) >= 4)[:, None])
    state = model.init(test.environment)
    for place in range(8):
        prediction, state = model.step(hidden.first(place + 1).last(1), state)
        assert_same(prediction, model.predict(hidden.first(place + 1), test.environment))
        if place < 4:
            nothing = model.predict(hidden.first(1), test.environment, prediction.time)
            torch.testing.assert_close(prediction.mean, nothing.mean)


def test_what_cannot_be_followed(models: dict[str, InteractionPredictor]) -> None:
    model, test = models["expected"], motions(3, seed=9)
    human, scenes = test.trajectories("human"), test.environments
    state, first = model.init(), human[0].first(1)
    with pytest.raises(InputError, match=r"one environment for a motion that is followed, got a batch \(3, 2\)"):
        model.init(scenes)
    with pytest.raises(InputError, match=r"one environment for a motion that is followed, got a batch \(3, 2\)"):
        model.step(first, state, scenes)
    for seen in (state, model.step(first, state)[1]):
        with pytest.raises(InputError, match=r"single .*\(3,\)"):
            model.step(human.first(2), seen)
        with pytest.raises(InputError, match=r"human signals \('x', 'y'\), as fitted, got \('y', 'x'\)"):
            model.step(first.select(("y", "x")), seen)
    with pytest.raises(InputError, match=r"environment features \('distance', 'height'\), got \('width',\)"):
        model.init(EnvironmentFeatures(("width",), [1.0]))
    with pytest.raises(InputError, match="environment as EnvironmentFeatures, got dict"):
        model.step(first, state, {"distance": 0.6})  # pyright: ignore[reportArgumentType]
    with pytest.raises(InputError, match="noise for all samples or for none"):
        noisy = dataclasses.replace(human[0].first(2).last(1), noise=0.01 * torch.eye(2).expand(1, 2, 2))
        model.step(noisy, model.step(first, state)[1])
    with pytest.raises(NotFittedError, match="Expected a fitted predictor"):
        quick().init()
    with pytest.raises(NotFittedError, match="Expected a fitted predictor"):
        quick().step(first, state)
    alone = quick().fit(motions(6).without_environment())
    with pytest.raises(InputError, match="the demonstrations had none"):
        alone.init(told())

from __future__ import annotations

import dataclasses
import functools
import warnings

import pytest
import torch
from stream_world import CLOCKS, HUMAN, ROBOT, SCENE, SHRINKAGE, SIGNALS, motions, quick, with_fitted

from eaip_prob.data.demonstrations import Demonstration, DemonstrationSet
from eaip_prob.data.environment import EnvironmentFeatures
from eaip_prob.data.features import QuadraticFeatures, RawFeatures
from eaip_prob.data.trajectory import Trajectory
from eaip_prob.errors import ExtrapolationWarning, HeldOutWarning, InputError
from eaip_prob.models import GaussianJointModel, KernelJointModel
from eaip_prob.phase import ElapsedClock
from eaip_prob.prediction import InteractionPredictor
from eaip_prob.primitives import DMP
from eaip_prob.slope import Slope
from eaip_prob.trust import Trust

pytestmark = pytest.mark.filterwarnings("ignore:The person has been watched")
NEAR = 0.05  # seconds after the last sample


@functools.cache
def fitted(clock: str, target: str = "human", trust: bool = True) -> InteractionPredictor:
    return quick(clock, target=target, trust=trust, recalibrate=False).fit(motions(18))


@functools.cache
def the_motion() -> Demonstration:
    return motions(1, seed=9)[0]


def longer(one: Demonstration, factor: float) -> Demonstration:
    human, robot = (dataclasses.replace(part, time=part.time * factor) for part in (one.human, one.robot) if part)
    return Demonstration(human, robot, one.environment)


def first_changed(change: object) -> DemonstrationSet:
    seen = motions(6)
    return DemonstrationSet([change(seen[0]), *list(seen)[1:]], seen.groups)  # pyright: ignore[reportCallIssue]


@pytest.mark.parametrize("clock", list(CLOCKS))
def test_recordings_that_were_not_stopped_or_not_started(clock: str) -> None:
    long, short = first_changed(lambda one: longer(one, 200.0)), first_changed(lambda one: longer(one, 1 / 200.0))
    for seen in (long, short):
        with pytest.raises(
            InputError, match=r"comparable durations, got .* s for motion \(0,\) at a median of 1\.\d+ s"
        ):
            quick(clock).fit(seen)
    still = first_changed(lambda one: dataclasses.replace(one, human=one.human.first(1)))
    hidden = first_changed(lambda one: dataclasses.replace(one, human=one.human.hide(SIGNALS)))
    for seen in (still, hidden):
        with pytest.raises(InputError, match=r"at least two seen samples, got a duration of 0 s for motion \(0,\)"):
            quick(clock).fit(seen)


@pytest.mark.parametrize("robot", [ROBOT, DMP(num_basis=5)])
@pytest.mark.parametrize("clock", list(CLOCKS))
def the_motions_of_hours_are_predicted_like_those_of_seconds(clock: str, robot: object) -> None:
    seconds, hours = (quick(clock, robot=robot).fit(motions(9, unit=unit)) for unit in (1.0, 3600.0))
    seen, scene = the_motion().human, the_motion().environment
    assert seen is not None
    slow = dataclasses.replace(seen, time=1.7 + 3600.0 * (seen.time - 1.7))
    one, other = seconds.predict(seen.first(9), scene), hours.predict(slow.first(9), scene)
    torch.testing.assert_close(other.time, 1.7 + 3600.0 * (one.time - 1.7), rtol=1e-9, atol=1e-6)
    torch.testing.assert_close(other.mean, one.mean, rtol=1e-6, atol=1e-7)
    torch.testing.assert_close(other.variance, one.variance, rtol=1e-5, atol=1e-10)


def scene_at(steps: float, feature: int = 0) -> EnvironmentFeatures:
    """So many widths of the demonstrated range above it; the other feature is in the middle."""
    scenes = motions(18).environments
    assert scenes is not None
    low, high = scenes.value.amin(0), scenes.value.amax(0)
    value = 0.5 * (low + high)
    value[feature] = high[feature] + steps * (high - low)[feature]
    return EnvironmentFeatures(SCENE, value)


@pytest.mark.parametrize("feature", [0, 1])
@pytest.mark.parametrize("features", [RawFeatures(), QuadraticFeatures()])
@pytest.mark.parametrize("kernel", [False, True])
def test_variance_grows_with_the_distance_of_the_scene(kernel: bool, features: object, feature: int) -> None:
    model = KernelJointModel(SHRINKAGE, bandwidth=1.5) if kernel else GaussianJointModel(SHRINKAGE)
    trained = quick("elapsed", features=features, model=model, trust=False, recalibrate=False).fit(motions(18))
    seen, time = the_motion().human, torch.tensor([2.0, 2.7], dtype=torch.float64)
    assert seen is not None
    inside = trained.predict(seen.first(6), scene_at(-0.5, feature), time).variance
    last = trained.predict(seen.first(6), scene_at(0.4, feature), time).variance
    # A kernel leaves the neighbours of the range only after some distance.
    for steps in (4.0, 8.0, 20.0, 100.0, 1e4) if kernel else (0.6, 1.0, 2.0, 4.0, 8.0, 20.0, 100.0, 1e4):
        with pytest.warns(ExtrapolationWarning, match=f"{SCENE[feature]} = .* lies far outside the demonstrations"):
            came = trained.predict(seen.first(6), scene_at(steps, feature), time)
        assert bool((came.variance > 1.02 * last).all() and (came.variance > inside).all())
        assert bool(came.mean.isfinite().all() and came.variance.isfinite().all())
        last = came.variance


def test_the_warning_begins_half_the_range_outside() -> None:
    trained, seen = fitted("elapsed"), the_motion().human
    assert seen is not None
    for steps in (0.49, -1.49, 0.0):
        trained.predict(seen.first(3), scene_at(steps))
    for steps in (0.51, -1.51):
        with pytest.warns(ExtrapolationWarning, match="distance = "):
            trained.init(scene_at(steps))
    far = scene_at(50.0)
    trained.predict(seen.first(3), dataclasses.replace(far, observed=torch.tensor([False, True])))
    batch = EnvironmentFeatures(SCENE, torch.stack([scene_at(0.0).value, scene_at(3.0, 1).value]))
    with pytest.warns(ExtrapolationWarning, match=f"height = {float(batch.value[1, 1]):g} lies far outside"):
        trained.predict([seen.first(3), seen.first(3)], batch)


def test_one_group_leaves_stated_defaults() -> None:
    seen = motions(10, groups=1)
    with pytest.warns(HeldOutWarning, match=r"All 10 demonstrations are of one group \(0\): nothing can be left out"):
        trained = InteractionPredictor(human=HUMAN, robot=ROBOT, model=GaussianJointModel(SHRINKAGE)).fit(seen)
    found, human, scenes = trained.require_fitted(), seen.trajectories("human"), seen.environments
    assert scenes is not None and found.alone is not None
    torch.testing.assert_close(found.noise, 0.02 * human.values.flatten(0, 1).std(0, correction=0))
    torch.testing.assert_close(found.environment_noise, 0.1 * scenes.value.std(0, correction=0))
    assert isinstance(found.phase, ElapsedClock) and isinstance(found.features, RawFeatures)
    assert isinstance(found.alone.phase, ElapsedClock)
    for part in (found, found.alone):
        assert (part.gate, part.trust, part.inflation, part.num_folds) == (Slope(), Trust(), 1.0, 0)
    came = trained.predict(human[0].first(5), scenes[0])
    assert bool(came.mean.isfinite().all() and (came.variance > 0).all())


def behaved(kind: str, factor: float = 3.0) -> Trajectory:
    """A person who stops on the way, goes back to the start, waits before moving, or stays at the end."""
    whole = the_motion().human
    assert whole is not None
    count = int(25 * factor)
    time = whole.time[0] + (whole.time[1] - whole.time[0]) * torch.arange(count, dtype=torch.float64)
    ways = {
        "stops": [*range(10)] + [10] * count,
        "goes back": [*range(13), *range(12, 0, -1)] + [0] * count,
        "waits": [0] * 40 + [*range(25)] + [24] * count,
        "stays": [*range(25)] + [24] * count,
    }
    return Trajectory(time, whole.values[ways[kind][:count]], SIGNALS)


@pytest.mark.parametrize("clock", list(CLOCKS))
@pytest.mark.parametrize("kind", ["stops", "goes back", "waits", "stays"])
@pytest.mark.parametrize("target", ["human", "robot"])
def test_whatever_a_person_does_the_prediction_is_a_density(clock: str, kind: str, target: str) -> None:
    model, motion = fitted(clock, target), behaved(kind)
    state, step = model.init(the_motion().environment), model.require_fitted().step
    for place in range(motion.num_samples):
        came, state = model.step(motion.first(place + 1).last(1), state)
        assert bool(came.mean.isfinite().all() and came.log_evidence.isfinite())
        assert bool((came.variance > 0).all() and came.variance.isfinite().all())
        if place % 6 == 0:
            covariance = came.covariance
            assert float(torch.linalg.eigvalsh(covariance).min()) > -1e-9 * float(covariance.abs().max())
            whole = model.predict(motion.first(place + 1), the_motion().environment, came.time)
            torch.testing.assert_close(came.mean, whole.mean, rtol=1e-9, atol=1e-9)
        # Default times begin at the first sample and go at least to the last one.
        assert came.time[0] == motion.time[0]
        assert float(came.time[-1]) >= float(motion.time[place]) - 1e-5 * step


@pytest.mark.parametrize("clock", list(CLOCKS))
@pytest.mark.parametrize(("kind", "seen"), [("stops", 20), ("stops", 40), ("goes back", 27), ("goes back", 60)])
def test_strong_evidence_is_followed(clock: str, kind: str, seen: int) -> None:
    model, motion, scene = fitted(clock, trust=False), behaved(kind), the_motion().environment
    held, soon = motion.values[seen - 1], motion.time[seen - 1 : seen] + NEAR
    expected = model.predict(motion.first(1).hide(SIGNALS), scene, soon).mean[0]
    followed = model.predict(motion.first(seen), scene, soon).mean[0]
    assert float((followed - held).norm()) < 0.2 * float((expected - held).norm())


@pytest.mark.parametrize("clock", list(CLOCKS))
def test_long_after_the_expected_end(clock: str) -> None:
    model, motion = fitted(clock), behaved("stays", 9.0)
    scene = the_motion().environment
    with pytest.warns(ExtrapolationWarning, match=r"watched for \d.* s, the longest demonstration took 1\.\d* s"):
        came = model.predict(motion, scene)
    with pytest.warns(ExtrapolationWarning, match="watched"):
        model.step(motion, model.init(scene))
    longest = model.require_fitted().longest
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        model.predict(motion.first(int((motion.time - motion.time[0] <= 2.0 * longest).sum())), scene)
    ahead = came.at(motion.time[-1:] + torch.tensor([0.0, 1.0, 1e3]))
    assert bool(ahead.mean.isfinite().all() and (ahead.variance > 0).all())
    # Behind the limit of the clock a motion is at rest.
    if clock != "dtw":
        torch.testing.assert_close(ahead.mean[0], ahead.mean[2])
        torch.testing.assert_close(ahead.variance[0], ahead.variance[2])


def test_asking_only_for_the_past_or_long_before_it() -> None:
    model, seen = with_fitted(fitted("marginal"), inflation=2.0), the_motion().human
    assert seen is not None
    came = model.predict(seen.first(9), time=seen.time[:1] - torch.tensor([1e4, 1.0, 0.1]).double())
    assert bool(came.mean.isfinite().all() and (came.variance > 0).all())

"""What `perception.py` times of the loop of the bag task: one frame, from cached pixels to a checked plan."""

from __future__ import annotations

import itertools
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from omegaconf import DictConfig

_FIRST, _COUNT = 30, 12  # steps of the simulation; the second in which the robot begins to move


def loop_jobs(cfg: DictConfig) -> dict[str, Callable[[], Any]]:
    """`ms/loop/{gloves,detector,phase,posterior,plan,total,look}` for a covering of the object of the benchmark.

    Nothing is rendered while the time is taken. `detector` is class and box in the image and the place from the depth
    of all cameras, `posterior` the prediction of all samples so far by the clock's hypotheses, `plan` the path, its
    check against the object and the arm, and the next command. A frame follows the gloves and either looks for the
    object, in the first second, or plans: `look` is the one, the gloves beside the detector on two cores, and `total`
    the other.
    """
    from eaip_prob.config import build
    from eaip_prob.data import RawFeatures
    from eaip_prob.detection import MetricBoxEncoder
    from eaip_prob.phase import ExpectedMarginalClock
    from eaip_prob.prediction import InteractionPredictor
    from eaip_prob.robot import baxter_left_arm
    from eaip_prob.tasks.bag_covering import CoveringLoop, KinectPerception
    from eaip_prob.tasks.bag_covering.cases import Room
    from eaip_prob.tasks.bag_covering.demonstrating import instants
    from eaip_prob.tasks.bag_covering.people import TEST
    from eaip_prob.tasks.bag_covering.recorded import demonstration_set, shipped

    encoder, workspace = MetricBoxEncoder(), build(cfg.workspace)
    # Nothing is chosen on held-out motions: that takes a minute, and the time of a prediction does not depend on it.
    given = {"noise": 0.005, "environment_noise": 0.01, "gate": False, "trust": False, "recalibrate": False}
    predictor = InteractionPredictor(phase=ExpectedMarginalClock(num_durations=15), features=RawFeatures(), **given)
    predictor = predictor.fit(demonstration_set(shipped(), encoder))
    perception = KinectPerception(
        build(cfg.rig),
        build(cfg.camera),
        build(cfg.detector_camera),
        build(cfg.kinect_noise),
        build(cfg.tracker),
        build(cfg.detector),
    )
    room = Room({"brown_bookshelf": workspace.thing}, {"brown_bookshelf": "bookshelf"}, workspace)
    (case,) = room.cases(["brown_bookshelf"], TEST, 1, cfg.seed)
    loop = CoveringLoop(predictor, "eaip", encoder, baxter_left_arm(), period=0.0)

    kept, state, seeing = [], loop.init(case.motion.gripper[0]), perception.init(case.site, case.seed)
    for number, instant in enumerate(itertools.islice(instants(case, 30.0), _FIRST + _COUNT)):
        before = seeing.tracks
        sighting, seeing = perception.see(instant, seeing)
        if number >= _FIRST:
            frames = perception.frames(instant, seeing, perception.cameras)
            beside = [frame for frame in frames if frame.name != perception.detecting.name]
            looked = [*beside, *perception.frames(instant, seeing, [perception.detecting])]
            kept.append((sighting, before, state, frames, looked))
        _, state = loop.step(sighting, instant.time, state)
    return _stages(loop, perception, kept)


def _stages(loop: Any, perception: Any, kept: list[Any]) -> dict[str, Callable[[], Any]]:
    places, beside = itertools.count(), ThreadPoolExecutor(1)

    def moment() -> Any:
        return kept[next(places) % len(kept)]

    def gloves() -> Any:
        sighting, before, _, frames, _ = moment()
        return perception.tracker.step(frames, before, sighting.time)

    def posterior() -> Any:
        state = moment()[2]
        return loop.predictor.predict(loop.observed(state), loop.environment(state)).mean

    def phase() -> Any:
        state = moment()[2]
        fitted, environment = loop.predictor.serving(loop.environment(state))
        return fitted.phase.estimate(loop.observed(state), environment)

    predictions = [loop.predictor.predict(loop.observed(state), loop.environment(state)) for _, _, state, *_ in kept]

    def plan() -> Any:
        place = next(places) % len(kept)
        sighting, _, state, *_ = kept[place]
        path = loop.execution.plan(state.execution, predictions[place])
        verdict = loop.verdict(path, state, sighting.time)
        return loop.execution.step(state.execution, path, verdict, sighting.time)

    def look() -> Any:
        sighting, before, _, frames, looked = moment()
        found = beside.submit(perception.detector.detect, looked)
        return perception.tracker.step(frames, before, sighting.time), found.result()

    def total() -> Any:
        sighting, before, state, frames, _ = moment()
        hands, _ = perception.tracker.step(frames, before, sighting.time)
        return loop.step(replace(sighting, hands=hands, detections=None), sighting.time, state)

    return {
        "ms/loop/gloves": gloves,
        "ms/loop/detector": lambda: perception.detector.detect(moment()[4]),
        "ms/loop/phase": phase,
        "ms/loop/posterior": posterior,
        "ms/loop/plan": plan,
        "ms/loop/total": total,
        "ms/loop/look": look,
    }

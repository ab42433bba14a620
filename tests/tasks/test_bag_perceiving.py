"""What the robot is told of a trial, from pixels and by ideal sensors."""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from itertools import islice

import numpy as np
import pytest
from covering_world import _run, case, perception, shared

from eaip_prob.config import build
from eaip_prob.errors import InputError
from eaip_prob.tasks.bag_covering.demonstrating import instants
from eaip_prob.tasks.bag_covering.perceiving import Instant, KinectPerception
from eaip_prob.tasks.bag_covering.seeing import TRACKING_STD
from eaip_prob.tasks.bag_covering.trial import Looks, Trial

KINECTS = "perception=kinects"


@cache
def shown() -> tuple[Instant, ...]:
    """The first second of a trial, the bag with it."""
    return tuple(islice(instants(case("folding_table"), 10.0), 10))


@cache
def from_pixels(*overrides: str) -> KinectPerception:
    return build(_run.compose([KINECTS, *overrides]).perception)


def seen(perceiving, looks=True):
    """Hands and detections at each time of the first second."""
    one = case("folding_table")
    state, sightings = perceiving.init(one.site, one.seed), []
    for instant in shown():
        sighting, state = perceiving.see(instant, state, looks)
        sightings.append(sighting)
    return sightings


def hand_errors(sightings):
    pairs = [
        (one.hands, instant.hands) for one, instant in zip(sightings, shown(), strict=True) if one.hands is not None
    ]
    return np.concatenate([np.linalg.norm(hands.position - true, axis=-1)[hands.seen] for hands, true in pairs])


def test_hands_and_object_are_where_they_are():
    sightings = seen(from_pixels())
    errors = hand_errors(sightings)
    assert len(errors) >= 16 and np.median(errors) < 0.003 and errors.max() < 0.02  # m
    place = np.array([one.detections.place[0] for one in sightings])
    truth = case("folding_table").site.place
    assert np.abs(np.median(place, axis=0) - truth).max() < 0.05
    assert {label for one in sightings for label in one.detections.labels} == {"table"}


def test_between_looks_no_object_is_sought():
    assert all(one.detections is None for one in seen(from_pixels(), looks=False))


def test_a_lost_camera_costs_a_view_and_not_the_hands():
    whole, less = seen(from_pixels()), seen(from_pixels("perception.lost=[overhead]"))
    assert np.median(hand_errors(less)) < 0.003
    place, other = (np.array([one.detections.place[0] for one in many]) for many in (whole, less))
    assert np.isfinite(other).any() and not np.array_equal(place, other)


def test_without_the_detectors_camera_nothing_is_detected():
    sightings = seen(from_pixels("perception.lost=[right]"))
    assert all(len(one.detections) == 0 for one in sightings)
    assert all(one.detections.image_size == (960, 540) for one in sightings)


@pytest.mark.parametrize("override", ["perception.lost=[rigth]", "+perception.detecting=rigth"])
def test_a_camera_that_is_not_there_is_named(override):
    with pytest.raises(InputError, match=r"\['left', 'overhead', 'right'\].* as \w+, got 'rigth'"):
        build(_run.compose([KINECTS, override]).perception)


def test_ideal_sensors_err_by_what_they_say():
    one, deviations = case("folding_table"), []
    for seed in range(40):
        state = perception().init(one.site, seed)
        for instant in shown():
            hands, state = perception().track(instant, state)
            deviations.append(hands.position - instant.hands)
    assert np.std(deviations) == pytest.approx(TRACKING_STD, rel=0.05)  # of 2400 numbers: 1.4 % standard error


def test_a_trial_from_pixels_looks_first_and_then_plans():
    one, setting = case("folding_table"), replace(shared(), perception=from_pixels())
    trial = Trial(one.site, one.motion, setting.perception, one.seed, Looks(5.0, 5.0, 1.5), bag=None)
    loop = setting.loop("eaip")
    steps = list(islice(trial.steps(loop), 45))
    looked = [step.instant.time for step in steps if step.sighting is not None and step.sighting.detections is not None]
    assert np.allclose(looked, np.arange(0.0, loop.looking - 1e-6, 0.2))
    planned = [step.report for step in steps if step.report.verdict is not None]
    assert planned and all(
        report.environment is not None and bool(report.environment.observed.all()) for report in planned
    )

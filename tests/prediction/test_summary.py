from __future__ import annotations

import dataclasses
import functools

import pytest
from stream_world import motions, quick, with_fitted

from eaip_prob.errors import HeldOutWarning
from eaip_prob.prediction import InteractionPredictor
from eaip_prob.slope import Slope
from eaip_prob.trust import Trust

TRUST = Trust((0.043, 0.52), (Slope(0.0, 0.1, 0.4, 0.0), Slope(0.57, 0.57, 0.1, 0.214)))
FULL = Trust((0.31,), (Slope(1.0, 1.2, 0.1, 0.926),))


@functools.cache
def trained() -> InteractionPredictor:
    return with_fitted(quick("expected").fit(motions(9)), trust=TRUST, scene_trust=Trust(), inflation=1.44)


def lines(gate: Slope) -> list[str]:
    return with_fitted(trained(), gate=gate).summary().split("\n")


@pytest.mark.parametrize(
    ("gate", "first"),
    [
        (Slope(1.0, 1.1, 0.1, 0.834), "explains 83 % of the robot's variation in new groups."),
        (Slope(0.6, 0.6, 0.1, 0.276), "explains 28 % of the robot's variation in new groups, believed to 60 %."),
        (Slope(0.0, 0.1, 0.4, 0.0), "tells nothing of the robot's motion in new groups: not used."),
    ],
)
def test_what_the_environment_tells(gate: Slope, first: str) -> None:
    came = lines(gate)
    assert came[0] == f"The environment (distance, height) {first}"
    assert not any("one group" in line for line in came)


def test_what_the_motion_tells_with_the_environment_and_without() -> None:
    tells = "tells nothing of what follows of the robot's in new groups"
    explains = "explains 21 % of what is left of the robot's, believed to 57 %"
    assert lines(Slope())[1:] == [
        "With the environment: ExpectedClock, RawFeatures (2), GaussianJointModel, standard deviations times 1.20 "
        "(3 folds).",
        f"  4 % of the motion, the environment known, {tells}.",
        f"  52 % of the motion, the environment known, {explains}.",
        "Without it: ElapsedClock, GaussianJointModel, standard deviations times 1.20 (3 folds).",
        f"  4 % of the motion {tells}.",
        f"  52 % of the motion {explains}.",
    ]


def test_what_the_environment_tells_beside_the_motion() -> None:
    scene_trust = Trust((0.1, 0.8), (Slope(1.0, 1.0, 0.1, 0.31), Slope(0.7, 0.6, 0.2, 0.02)))
    fitted = trained().require_fitted()
    came = dataclasses.replace(trained(), fitted=dataclasses.replace(fitted, scene_trust=scene_trust)).summary()
    beside = [line for line in came.split("\n") if "beside" in line]
    assert beside == [
        "  The environment, beside 10 % of the motion, explains 31 % of what is left of the robot's.",
        "  The environment, beside 80 % of the motion, explains 2 % of what is left of the robot's, believed to 70 %.",
    ]


def test_full_trust_and_the_person_as_target() -> None:
    model = with_fitted(quick("elapsed", target="human", separate=False).fit(motions(9)), trust=FULL)
    model = with_fitted(model, scene_trust=Trust(), inflation=0.25)
    came = with_fitted(model, gate=Slope(1.0, 1.0, 0.1, 0.5)).summary().split("\n")
    assert came == [
        "The environment (distance, height) explains 50 % of the human's variation in new groups.",
        "With the environment: ElapsedClock, RawFeatures (2), GaussianJointModel, standard deviations times 0.50 "
        "(3 folds).",
        "  31 % of the motion, the environment known, explains 93 % of what is left of the human's.",
    ]


def test_without_an_environment() -> None:
    model = quick("marginal").fit(motions(9).without_environment())
    came = with_fitted(model, trust=FULL, inflation=4.0).summary().split("\n")
    assert came == [
        "Chosen: MarginalClock, GaussianJointModel, standard deviations times 2.00 (3 folds).",
        "  31 % of the motion explains 93 % of what is left of the robot's.",
    ]


@pytest.mark.parametrize("scene", [True, False])
def test_one_group(scene: bool) -> None:
    seen = motions(5, groups=1)
    with pytest.warns(HeldOutWarning, match="one group"):
        model = quick("elapsed").fit(seen if scene else seen.without_environment())
    came = model.summary().split("\n")
    assert came[-1] == "There is one group, so nothing could be left out: these are defaults, and not calibrated."
    assert not any("%" in line or "folds" in line or "times" in line for line in came)
    if scene:
        known = "Whether the environment (distance, height) tells of new groups is not known; it is believed."
        assert came[:2] == [known, "With the environment: ElapsedClock, RawFeatures (2), GaussianJointModel."]
    else:
        assert came[0] == "Chosen: ElapsedClock, GaussianJointModel."


def test_the_numbers_are_those_of_what_was_fitted() -> None:
    model = quick("elapsed").fit(motions(9))
    fitted, text = model.require_fitted(), model.summary()
    assert fitted.alone is not None and fitted.gate.value > 0
    assert f"explains {100 * fitted.gate.explained:.0f} % of the robot's variation" in text
    for part, known in ((fitted, ", the environment known,"), (fitted.alone, "")):
        assert f"standard deviations times {part.inflation**0.5:.2f} ({part.num_folds} folds)" in text
        for share, slope in zip(part.trust.shares, part.trust.slopes, strict=True):
            said = f"  {100 * share:.0f} % of the motion{known} explains {100 * slope.explained:.0f} % of what is left"
            silent = f"  {100 * share:.0f} % of the motion{known} tells nothing"
            assert (silent if slope.value == 0.0 else said) in text

from __future__ import annotations

import numpy as np
import pytest
import torch
from omegaconf import OmegaConf

from eaip_prob.config import build, conf_dir
from eaip_prob.detection.base import CLASSES, Detections
from eaip_prob.detection.encoder import ObjectChoice
from eaip_prob.detection.encoders import (
    BoxEncoder,
    MetricBoxEncoder,
    NoEncoder,
    OneHotEncoder,
    PaperEncoder,
    label_covariance,
)
from eaip_prob.detection.encoders_noise import feature_errors
from eaip_prob.errors import InputError

SIZE = (960, 540)
BOX = np.array([[400.0, 300.0, 120.0, 200.0], [700.0, 260.0, 90.0, 160.0], [500.0, 100.0, 40.0, 60.0]])
PLACE = np.array([[0.9, 0.1, -0.5, 0.6, 0.3, 0.9], [1.4, -0.6, -0.6, 0.5, 0.5, 0.7], [np.nan] * 6])
ENCODERS = [PaperEncoder(), OneHotEncoder(), BoxEncoder(), MetricBoxEncoder(), NoEncoder()]


def three(**changed) -> Detections:
    covariance = np.stack([np.diag([1.0, 2.0, 3.0, 4.0]), np.eye(4), np.eye(4)])
    place_covariance = np.stack([0.01 * np.eye(6), 0.02 * np.eye(6), np.full((6, 6), np.nan)])
    known = {"labels": ("table", "chair", "bookshelf"), "score": np.array([0.7, 0.9, 0.8]), "box": BOX}
    known |= {"box_covariance": covariance, "place": PLACE, "place_covariance": place_covariance}
    return Detections(**(known | {"image_size": SIZE} | changed))


def test_features_are_those_of_the_task_s_object_in_float64():
    one = three()[slice(0, 1)]
    expected = {
        PaperEncoder: [2.0, *BOX[0]],
        OneHotEncoder: [0.0, 0.0, 1.0, 0.0, *BOX[0]],
        BoxEncoder: [*BOX[0]],
        MetricBoxEncoder: [*PLACE[0]],
        NoEncoder: [],
    }
    for encoder in ENCODERS:
        features = encoder.encode(one)
        assert features.names == encoder.names and features.value.dtype == torch.float64
        assert features.value.tolist() == expected[type(encoder)] and bool(features.observed.all())
        assert len(set(encoder.names)) == len(encoder.names)
    assert PaperEncoder().names == ("label", "center_x", "center_y", "width", "height")


def test_the_covariance_is_that_of_label_and_box():
    paper, hot = (encoder.encode(three()[slice(0, 1)]).covariance for encoder in ENCODERS[:2])
    # A table (2) with 0.7, a chair (0), stepladder (1) or bookshelf (3) with 0.1 each.
    assert paper[0, 0].item() == pytest.approx(0.1 * (4 + 1 + 1))
    assert hot.diagonal()[:4].tolist() == pytest.approx([0.1, 0.1, 0.3, 0.1])
    assert hot[0, 2].item() == pytest.approx(-0.1) and hot[0, 1].item() == 0.0
    for covariance, at in ((paper, 1), (hot, 4)):
        assert covariance[at:, at:].diagonal().tolist() == [1.0, 2.0, 3.0, 4.0] and not covariance[:at, at:].any()
    place = MetricBoxEncoder().encode(three()[slice(1, 2)]).covariance
    assert place.tolist() == (0.02 * np.eye(6)).tolist()


@pytest.mark.parametrize("codes", [np.arange(4.0)[:, None], np.eye(4)], ids=["numbers", "indicators"])
def test_label_covariance_is_the_mean_squared_error_over_draws(codes):
    generator, score, answer = np.random.default_rng(0), 0.8, 1
    truth = np.where(generator.random(60000) < score, answer, (answer + generator.integers(1, 4, 60000)) % 4)
    error = codes[answer] - codes[truth]
    assert label_covariance(codes, answer, score) == pytest.approx(error.T @ error / len(error), abs=0.02)
    assert not label_covariance(codes, answer, 1.0).any()
    assert not label_covariance(codes[:1], 0, 0.4).any()
    probability = np.array([0.2 / 3, 0.8, 0.2 / 3, 0.2 / 3])
    away = codes[answer] - probability @ codes
    categorical = codes.T @ (np.diag(probability) - np.outer(probability, probability)) @ codes
    assert label_covariance(codes, answer, score) == pytest.approx(categorical + np.outer(away, away))


def test_a_detector_that_knows_no_error_of_its_boxes_gets_a_stated_one():
    unknown = three(box_covariance=None)[slice(0, 1)]
    for encoder in (PaperEncoder(box_std=0.1), OneHotEncoder(box_std=0.1), BoxEncoder(box_std=0.1)):
        assert encoder.encode(unknown).covariance.diagonal()[-4:].sqrt().tolist() == pytest.approx([12, 20, 12, 20])
    with pytest.raises(InputError, match="box_std"):
        BoxEncoder(box_std=-0.1)


@pytest.mark.parametrize("encoder", ENCODERS[:4], ids=lambda encoder: type(encoder).__name__)
def test_what_is_not_found_is_not_observed(encoder):
    for nothing in (Detections.none(SIZE), three(labels=("chair",) * 3)):
        wanted = type(encoder)(choice=ObjectChoice(wanted=["table"]))
        features = wanted.encode(nothing)
        assert features.names == encoder.names and not features.observed.any()


def test_a_place_that_is_not_known_is_not_observed():
    for unknown in (three()[slice(2, 3)], three(place=None, place_covariance=None)):
        features = MetricBoxEncoder().encode(unknown)
        assert not features.observed.any() and not features.covariance.any()
    partly = three(place=PLACE[[0, 1, 1]] * [1, 1, np.nan, 1, 1, 1], place_covariance=np.stack([np.eye(6)] * 3))
    assert MetricBoxEncoder().encode(partly).observed.tolist() == [True, True, False, True, True, True]


@pytest.mark.parametrize(
    ("choice", "expected"),
    [
        (ObjectChoice(), 1),
        (ObjectChoice(wanted=["table", "bookshelf"]), 2),
        (ObjectChoice(region=(0.3, 0.4, 0.6, 1.0)), 0),
        (ObjectChoice(region=(0.0, 0.0, 0.6, 0.3)), 2),
        (ObjectChoice(workspace=((0.5, 1.2), (-0.5, 0.5), (-1.0, 0.0))), 0),
        (ObjectChoice(workspace=((0.5, 1.2), (-0.5, 0.5), (-1.0, 0.0)), wanted=["chair"]), None),
    ],
)
def test_the_task_s_object_is_the_most_certain_of_those_admitted(choice, expected):
    found = three()
    assert choice.choose(found) == expected
    order = np.array([2, 0, 1])
    again = choice.choose(found[order])
    assert (None if again is None else order[again]) == expected


def test_labels_and_choices_that_do_not_exist_are_refused():
    with pytest.raises(InputError, match=r"got \['sofa'\].*detector"):
        BoxEncoder().encode(three(labels=("table", "sofa", "chair")))
    more = ObjectChoice(classes=(*CLASSES, "sofa"))
    assert OneHotEncoder(more).encode(three(labels=("table", "sofa", "chair"))).value[:5].tolist() == [0, 0, 0, 0, 1]
    for wrong in ({"wanted": ["sofa"]}, {"wanted": []}, {"classes": []}, {"region": (0.5, 0.0, 0.2, 1.0)}):
        with pytest.raises(InputError, match="wanted|region"):
            ObjectChoice(**wrong)
    with pytest.raises(InputError, match="workspace"):
        ObjectChoice(workspace=((0.0, 1.0), (1.0, 0.0), (0.0, 1.0)))
    assert ObjectChoice(workspace=((0.0, 1.0),) * 3).choose(three(place=None, place_covariance=None)) is None


def noisy(generator, count, claimed):
    std = np.array([3.0, 4.0, 5.0, 6.0])
    truth = Detections(("table",), np.ones(1), BOX[:1], SIZE)
    covariance = np.diag((claimed * std) ** 2)[None]
    drawn = [BOX[:1] + generator.normal(2.0, std) for _ in range(count)]
    return [Detections(("table",), np.ones(1), box, SIZE, covariance) for box in drawn], [truth] * count


def test_the_noise_study_tells_bias_spread_and_calibration():
    detected, truth = noisy(np.random.default_rng(1), 800, claimed=2.0)
    errors = feature_errors(BoxEncoder(), [*detected, Detections.none(SIZE)], [*truth, truth[0]])
    assert errors.bias == pytest.approx([2.0] * 4, abs=0.8) and errors.std == pytest.approx([3, 4, 5, 6], rel=0.1)
    assert errors.predicted == pytest.approx([6, 8, 10, 12]) and (errors.num_views, errors.num_missed) == (800, 1)
    expected = np.mean([(s**2 + 4.0) / (4.0 * s**2) for s in (3.0, 4.0, 5.0, 6.0)])
    assert errors.mahalanobis == pytest.approx(expected, rel=0.1)


def test_indicators_count_in_the_dimensions_in_which_they_vary():
    generator, count = np.random.default_rng(2), 600
    right = generator.random(count) < 0.7
    found = [Detections((label,), np.array([0.7]), BOX[:1], SIZE) for label in np.where(right, "table", "chair")]
    truth = Detections(("table",), np.ones(1), BOX[:1], SIZE)
    errors = feature_errors(OneHotEncoder(box_std=0.0), found, [truth] * count)
    # Each answer is one of three wrong ones with the same distance, so the mean is the share of wrong answers over s.
    wrong = [feature_errors(OneHotEncoder(box_std=0.0), [one], [truth]).mahalanobis for one in found[:40]]
    assert {round(value, 6) for value in wrong} == {0.0, round(max(wrong), 6)}
    assert errors.mahalanobis == pytest.approx((~right).mean() * max(wrong)) and max(wrong) == pytest.approx(10.0 / 3.0)
    sure = Detections(("chair",), np.ones(1), BOX[:1], SIZE)
    assert feature_errors(OneHotEncoder(box_std=0.0), [sure], [truth]).mahalanobis == np.inf


@pytest.mark.parametrize("name", ["paper", "one_hot", "box", "metric_box", "none"])
def test_every_encoder_is_built_from_its_configuration(name):
    encoder = build(OmegaConf.load(conf_dir() / "encoder" / f"{name}.yaml"))
    assert encoder.encode(three()).names == encoder.names


def test_a_noise_study_of_nothing_is_refused():
    detected, truth = noisy(np.random.default_rng(3), 3, claimed=1.0)
    for arguments in ((BoxEncoder(), detected[:2], truth), (NoEncoder(), detected, truth)):
        with pytest.raises(InputError, match="as many detections"):
            feature_errors(*arguments)
    with pytest.raises(InputError, match="none of 3"):
        feature_errors(MetricBoxEncoder(), detected, truth)

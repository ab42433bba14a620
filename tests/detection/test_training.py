from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import torch
from detector_world import SMALL, rectangles

from eaip_prob.detection.validation import Judgement, calibration, judged
from eaip_prob.detection.yolo.augmentation import Augmentation
from eaip_prob.detection.yolo.detector import YoloDetector
from eaip_prob.detection.yolo.training import Trainer, Training
from eaip_prob.detection.yolo.weights_file import write_weights
from eaip_prob.errors import DataFileError, InputError

SHORT = Training(epochs=3, batch=5, near=0.6, near_size=(64, 64), augmentation=Augmentation(paste=1))


def state(trainer: Trainer) -> dict[str, torch.Tensor]:
    return {**trainer.network.state_dict(), **{f"a/{k}": v for k, v in trainer.averaged.state_dict().items()}}


def test_a_training_that_was_stopped_ends_as_one_that_was_not(tmp_path):
    images = rectangles(12)
    whole = Trainer(images, SMALL, SHORT)
    losses = [loss for _, loss in whole.epochs()]
    stopped = Trainer(images, SMALL, SHORT, tmp_path)
    next(stopped.epochs())
    after = Trainer(images, SMALL, SHORT, tmp_path)
    assert [epoch for epoch, _ in after.epochs()] == [1, 2]
    assert after.losses == losses
    assert all(torch.equal(value, state(after)[name]) for name, value in state(whole).items())
    assert list(Trainer(images, SMALL, SHORT, tmp_path).epochs()) == []


def test_a_seed_gives_one_training():
    images, losses = rectangles(8), []
    for seed in (0, 0, 1):
        trainer = Trainer(images, SMALL, Training(epochs=1, batch=4, seed=seed))
        losses.append(next(trainer.epochs())[1])
    assert losses[0] == losses[1] != losses[2]


def test_the_state_of_another_training_is_refused(tmp_path):
    next(Trainer(rectangles(4), SMALL, SHORT, tmp_path).epochs())
    for images, plan in [(rectangles(4, seed=1), SHORT), (rectangles(4), Training(epochs=4, batch=5))]:
        with pytest.raises(DataFileError, match="another one"):
            Trainer(images, SMALL, plan, tmp_path)
    path = next(tmp_path.iterdir())
    path.write_bytes(path.read_bytes()[:1000])
    with pytest.raises(DataFileError, match="damaged.*Remove it"):
        Trainer(rectangles(4), SMALL, SHORT, tmp_path)


@pytest.mark.parametrize("change", [{"epochs": 0}, {"batch": 0}, {"rate": 0.0}, {"average": 1.0}])
def test_bad_plans_are_refused(change):
    with pytest.raises(InputError, match="at least one epoch"):
        Training(**change)


@pytest.mark.slow
def test_rectangles_are_learnt(tmp_path):
    settings = replace(SMALL, width=1 / 8)
    change = Augmentation(zoom=1.0, stretch=1.0, recolor=0.0, cover=0.0, blur=0.0, noise=2.0, paste=0)
    plan = Training(epochs=48, batch=8, near=0.0, rate=5e-3, average=0.9, augmentation=change, half=False)
    trainer = Trainer(rectangles(96, seed=1), settings, plan)
    losses = [loss for _, loss in trainer.epochs()]
    assert losses[-1] < 0.4 * losses[3]
    path = write_weights(tmp_path / "w.safetensors", trainer.averaged, settings, {})
    found = judged(YoloDetector(path, threshold=0.05), rectangles(40, seed=9))
    assert found.accuracy() >= 0.9 and found.mean_iou() >= 0.6  # a fourth of the classes, and 0.2, by chance


def test_judgements_count_what_was_said():
    truth, said = np.array([0, 1, 1, 2]), np.array([0, 1, 0, -1])
    iou, score = np.array([0.9, 0.4, 0.8, 0.0]), np.array([0.9, 0.8, 0.7, 0.0])
    one = Judgement(truth, said, iou, score, np.full((4, 4), np.nan))
    assert one.right.tolist() == [True, False, False, False]
    metrics = one.metrics()
    assert metrics["accuracy/all"] == 0.5 and metrics["accuracy/stepladder"] == 0.5 and metrics["accuracy/table"] == 0.0
    assert metrics["mean_iou/all"] == pytest.approx(0.525) and "accuracy/bookshelf" not in metrics


def test_calibrated_scores_are_shares_of_right_answers():
    rng = np.random.default_rng(0)
    score = rng.uniform(0.02, 0.98, 6000)
    logit = np.log(score / (1 - score))
    right = rng.random(6000) < 1 / (1 + np.exp(-(2.0 * logit + 0.7)))
    assert calibration(score, right) == pytest.approx((2.0, 0.7), abs=0.15)
    slope, offset = calibration(np.full(20, 0.9), np.ones(20, bool))
    certain = 1 / (1 + np.exp(-(slope * np.log(9.0) + offset)))
    assert certain == pytest.approx(21 / 22, abs=1e-3)

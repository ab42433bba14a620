from __future__ import annotations

import importlib.util
from pathlib import Path

import numpy as np
import pytest
from detector_world import SMALL, rectangles
from omegaconf import OmegaConf

from eaip_prob.config import conf_dir
from eaip_prob.data.frames import Intrinsics
from eaip_prob.detection.yolo.augmentation import Augmentation
from eaip_prob.detection.yolo.training import Training
from eaip_prob.detection.yolo.weights_file import read_weights
from eaip_prob.errors import InputError
from eaip_prob.simulation import Bookshelf, KinectModel, Rig
from eaip_prob.tasks.detection.training_pictures import draw_boxes, draw_losses
from eaip_prob.tasks.detection.training_study import calibrated, settings_for, train
from eaip_prob.tasks.detection.training_views import DEMONSTRATED, SETS, planned_views

ROOT = Path(__file__).parents[2]
CAMERA = Intrinsics(96, 54, 53.0, 52.9, 47.4, 25.6)
MODEL = KinectModel(CAMERA, CAMERA, (-0.05, 0.0, 0.0))
RIG = Rig({"right": (0.55, -1.75, 1.15)}, {"right": (0.95, 0.0, -0.15)})
SHELF = Bookshelf(0.6, 0.29, 0.9, 2, 0.02, (0.42, 0.26, 0.15), (0.34, 0.21, 0.13))
NUMBERS = {"training": 8, "validation": 4, "unusual": 4, "demonstrated": 2}


def test_sets_share_no_view_and_only_one_is_unusual():
    plans = planned_views(RIG, MODEL, {"brown_bookshelf": SHELF}, NUMBERS)
    assert len({plan.seed for plan in plans.values()}) == len({plan.key() for plan in plans.values()}) == 4
    assert [name for name, plan in plans.items() if plan.unusual] == ["unusual"]
    assert [name for name, plan in plans.items() if plan.things] == ["demonstrated"]
    other = planned_views(RIG, MODEL, {"brown_bookshelf": SHELF}, NUMBERS, seed=1)
    assert {plan.seed for plan in plans.values()}.isdisjoint({plan.seed for plan in other.values()})


def test_objects_that_were_never_demonstrated_are_refused():
    novel = OmegaConf.load(conf_dir() / "objects" / "novel.yaml").defaults
    for name in (next(iter(entry.values())) for entry in novel):
        assert name not in DEMONSTRATED
        with pytest.raises(InputError, match=name):
            planned_views(RIG, MODEL, {name: SHELF}, NUMBERS)
    text = (ROOT / "conf" / "train_detector.yaml").read_text()
    assert "objects: training" in text and set(OmegaConf.create(text).views) == set(SETS)
    with pytest.raises(InputError, match="'testing'"):
        planned_views(RIG, MODEL, {}, {"testing": 3})
    with pytest.raises(InputError, match="'above'"):
        planned_views(RIG, MODEL, {}, NUMBERS, camera="above")


def test_anchors_are_in_cells_of_the_input():
    images = rectangles(8, size=(192, 128))
    settings = settings_for(images, 0.25, (96, 64), 2)
    assert sorted(settings.anchors) == [(0.25, 0.5), (0.5, 0.25)]  # 16 x 32 px in an image of twice the input
    assert settings.input_size == (96, 64)


def test_scores_and_boxes_are_measured_on_views_that_were_not_trained_on(tmp_path):
    plan = Training(epochs=2, batch=8, near=0.0, augmentation=Augmentation(paste=0))
    trainer = train(rectangles(16), SMALL, plan, tmp_path, progress=False)
    views = {
        "validation": rectangles(6, seed=1),
        "unusual": rectangles(6, seed=2),
        "demonstrated": rectangles(4, seed=3),
    }
    path, judgements = calibrated(trainer, views, tmp_path, {"seed": "0"})
    _, settings = read_weights(path)
    assert set(judgements) == set(views) and [len(one.said) for one in judgements.values()] == [6, 6, 4]
    assert settings.score_slope != SMALL.score_slope and settings.anchors == SMALL.anchors
    assert np.isfinite(settings.box_errors).all()
    assert draw_boxes(tmp_path, "views", views["validation"]).is_file()
    assert draw_losses(tmp_path, trainer.losses).is_file()


@pytest.mark.slow
def test_the_experiment_runs_and_runs_again(tmp_path):
    spec = importlib.util.spec_from_file_location("train_detector", ROOT / "experiments" / "train_detector.py")
    assert spec is not None and spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    small = [f"views.{name}={number}" for name, number in NUMBERS.items()] + ["camera.color_size=[96,54]"]
    small += ["network.width=0.0625", "network.input_size=[96,64]", "training.epochs=2", "network.num_anchors=2"]
    cfg = module.run.compose([*small, f"views_dir={tmp_path / 'views'}"])
    first = module.run.execute(cfg, tmp_path / "first")
    second = module.run.execute(cfg, tmp_path / "second")
    assert first is not None and second is not None
    assert {"seconds/training", "demonstrated/accuracy/all", "unusual/mean_iou/chair"} <= set(first)
    same = [name for name in first if not name.startswith("seconds/")]
    assert {name: first[name] for name in same} == {name: second[name] for name in same}
    assert len(list((tmp_path / "first" / "figures").iterdir())) == 5

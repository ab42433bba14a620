"""Trains YOLO v2 on rendered views of the four demonstrated pieces of furniture (Sec. 4.2.1), and measures it.

A run that was stopped goes on from its last epoch when the same command is started again with its run_dir. The weights
are in furniture.safetensors; export_onnx=FILE writes them as ONNX too.
"""

from __future__ import annotations

import time
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

from eaip_prob.runs import experiment

if TYPE_CHECKING:
    from omegaconf import DictConfig


@experiment("train_detector")
def run(cfg: DictConfig, folder: Path) -> Mapping[str, Any]:
    """Renders or reads the views, trains, calibrates, judges, draws; returns the metrics."""
    from eaip_prob.config import build, repository_path
    from eaip_prob.detection.yolo.detector import YoloDetector
    from eaip_prob.detection.yolo.export import export_onnx
    from eaip_prob.tables import text_table
    from eaip_prob.tasks.detection.training_pictures import draw_boxes, draw_losses
    from eaip_prob.tasks.detection.training_study import calibrated, settings_for, train
    from eaip_prob.tasks.detection.training_views import planned_views, rendered_views

    objects = {name: build(cfg.objects[name]) for name in cfg.objects}
    plans = planned_views(build(cfg.rig), build(cfg.camera), objects, cfg.views, cfg.seed)
    started = time.perf_counter()
    views = rendered_views(plans, repository_path(cfg.views_dir))
    seconds = {"seconds/views": time.perf_counter() - started}
    started = time.perf_counter()
    settings = settings_for(views["training"], **cfg.network, seed=cfg.seed)
    trainer = train(views["training"], settings, build(cfg.training, seed=cfg.seed), folder)
    # What a part before an interruption took is not known to the part after it.
    seconds["seconds/training"] = time.perf_counter() - started
    notes = {"made by": "experiments/train_detector.py", "epochs": str(cfg.training.epochs), "seed": str(cfg.seed)}
    held_out = {name: images for name, images in views.items() if name != "training"}
    path, judgements = calibrated(trainer, held_out, folder, notes)
    metrics = {name: one.metrics() for name, one in judgements.items()}
    print(text_table([{"views": name, **row} for name, row in metrics.items()]))
    draw_losses(folder, trainer.losses)
    draw_boxes(folder, "views_training", views["training"])
    for name, images in held_out.items():
        draw_boxes(folder, f"views_{name}", images, YoloDetector(path))
    if cfg.export_onnx is not None:
        export_onnx(path, repository_path(cfg.export_onnx))
    return {**metrics, **seconds}


if __name__ == "__main__":
    run()

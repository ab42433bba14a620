"""Table 1: an object detector while a bag comes over the object: the four objects it was trained on, and four others.

Every object is covered in several placements before the right Kinect. Printed are the accuracy of the class over the
first half and over the whole task, the share of the object that is hidden, the boxes' IoU and what was answered
instead; the accuracy by how much is hidden; then the error of the encoded features over the first half, and what it
does to a prediction.
"""

from __future__ import annotations

import time
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

from eaip_prob.runs import experiment

if TYPE_CHECKING:
    from omegaconf import DictConfig

    from eaip_prob.simulation import Kinect
    from eaip_prob.tasks.detection import AbstractCoveringViews


@experiment("detection")
def run(cfg: DictConfig, folder: Path) -> Mapping[str, Any]:
    """Renders or reads the frames, detects, draws; returns the metrics."""
    from tqdm import tqdm

    from eaip_prob.config import build, repository_path
    from eaip_prob.tables import text_table
    from eaip_prob.tasks.detection import ObjectScores, by_cover, feature_study, sighting, table_1
    from eaip_prob.tasks.detection.covering_pictures import draw_boxes, draw_over_time, draw_table_1

    started, detector, encoder = time.perf_counter(), build(cfg.detector), build(cfg.encoder)
    trials = list(planned(cfg))
    sightings, frames = {}, {}
    for name, views in tqdm(trials, "trials", disable=None):
        shown = views.frames(repository_path(cfg.clip_dir))
        frames.setdefault(name, []).append(shown)
        sightings.setdefault(name, []).append([sighting(detector, frame) for frame in shown])
    scores = {name: ObjectScores.of([one for trial in many for one in trial]) for name, many in sightings.items()}
    draw_boxes(folder, frames, sightings)
    draw_table_1(folder, scores)
    draw_over_time(folder, sightings)
    print(text_table(table_1(scores), digits=3))
    cover = by_cover([one for many in sightings.values() for trial in many for one in trial])
    print(text_table(cover, digits=3))
    metrics: dict[str, Any] = {
        "accuracy": {name: {"first_half": one.first_half, "whole": one.whole} for name, one in scores.items()},
        "covered": {name: one.covered for name, one in scores.items()},
        "iou": {name: one.iou for name, one in scores.items()},
        "by_cover": {
            f"{row['covered from']:.0%}".rstrip("%"): {"right": row["right"], "iou": row["IoU"]} for row in cover
        },
    }
    rows, predictions, features = feature_study(encoder, frames, sightings, list(cfg.training), cfg.seed)
    for table in (rows, predictions):
        print(text_table(table, digits=3) if table else "")
    return metrics | features | {"seconds/total": time.perf_counter() - started}


def planned(cfg: DictConfig) -> Iterator[tuple[str, AbstractCoveringViews]]:
    """Each object in all its placements."""
    from eaip_prob.config import build
    from eaip_prob.errors import InputError

    (camera,) = [one for one in build(cfg.rig).cameras(build(cfg.camera)) if one.name == cfg.detecting_camera]
    kinds = {"sheet": with_sheet, "cloth": with_cloth}
    if cfg.bag not in kinds:
        raise InputError(f"Expected bag as one of {list(kinds)}, got {cfg.bag!r}. Set bag=sheet or bag=cloth.")
    yield from kinds[cfg.bag](cfg, camera)


def with_sheet(cfg: DictConfig, camera: Kinect) -> Iterator[tuple[str, AbstractCoveringViews]]:
    """A sheet that is carried up, over and down; a placement's number gives every object the same one."""
    from dataclasses import replace

    import numpy as np

    from eaip_prob.config import build
    from eaip_prob.tasks.detection import CoveringViews, Placement

    room, noise = build(cfg.workspace), build(cfg.kinect_noise)
    for name, thing in {**cfg.training, **cfg.novel}.items():
        with_thing = replace(room, thing=build(thing))
        for trial in range(cfg.trials):
            placement = Placement.drawn(np.random.default_rng((cfg.seed, trial)))
            views = (cfg.classes[name], camera, cfg.frames, noise, cfg.seed + trial)
            yield name, CoveringViews(*views, with_thing, placement)


def with_cloth(cfg: DictConfig, camera: Kinect) -> Iterator[tuple[str, AbstractCoveringViews]]:
    """The simulated bag of the bag task, carried by partners that its robot has not met."""
    from eaip_prob.config import build
    from eaip_prob.tasks.bag_covering import setting
    from eaip_prob.tasks.bag_covering.cloth_views import ClothViews
    from eaip_prob.tasks.bag_covering.people import TEST

    room, noise = setting.room(cfg), build(cfg.kinect_noise)
    for case in room.cases(list(room.things), TEST, cfg.trials, cfg.seed):
        views = (case.site.label, camera, cfg.frames, noise, case.seed)
        yield case.site.name, ClothViews(*views, case)


if __name__ == "__main__":
    run()

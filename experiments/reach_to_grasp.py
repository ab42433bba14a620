"""Recorded reaches to grasp cubes: how far will the hand open? Predicted from elbow, wrist and the cube's size.

The person is one of two whom the fit has never seen. Compares watching, knowing the cube, both and neither with the
published method after 20, 50 and 80 % of the motion, of which the first 0.3 s (about 30 %) are rest. Reads
reach_cube_train.npz in data_dir.
"""

from __future__ import annotations

import time
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

from eaip_prob.runs import experiment

if TYPE_CHECKING:
    from omegaconf import DictConfig


@experiment("reach_to_grasp")
def run(cfg: DictConfig, folder: Path) -> Mapping[str, Any]:
    """Fits and measures fold by fold, draws and records; returns the metrics."""
    import torch
    from tqdm import tqdm

    from eaip_prob.config import build, repository_path
    from eaip_prob.data import DemonstrationSet, read_reach_to_grasp
    from eaip_prob.methods import METHODS, FittedMethods
    from eaip_prob.tasks.recorded import consecutive_folds, pictures, recordings, report, studied

    started = time.perf_counter()
    demonstrations = read_reach_to_grasp(repository_path(cfg.data_dir))

    models = {name: build(model) for name, model in cfg.models.items()}

    def fit(training: DemonstrationSet) -> FittedMethods:
        shuffle = torch.Generator().manual_seed(cfg.seed)
        return FittedMethods.fit(build(cfg.predictor), build(cfg.paper), training, shuffle, models)

    folds = tqdm(consecutive_folds(demonstrations, cfg.num_folds), "people left out", disable=None)
    study = studied(demonstrations, folds, fit, (*METHODS, *models), list(cfg.percent_seen), list(cfg.examples))
    text = report.text(study, "px", "people")
    pictures.draw(folder, study, "px")
    with build(
        cfg.recording,
        path=folder / "recording.rrd",
        application_id="reach_to_grasp",
        recording_id=f"reach_to_grasp-{cfg.seed}",
    ) as logger:
        recordings.record_reach(logger, study, text)
    print(text)
    return study.metrics() | {"seconds/total": time.perf_counter() - started}


if __name__ == "__main__":
    run()

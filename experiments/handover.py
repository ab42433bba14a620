"""Recorded hand-overs of a baton: where does the giver's hand go? Predicted from the taker's and the giver's start.

Recordings are left out in ten runs of consecutive ones; who took part is not recorded, so that one pair may be on both
sides of a cut, and intervals over recordings may be too narrow. Compares watching the taker, knowing where the giver
starts, both and neither with the published method after 20, 50 and 80 % of the motion. Reads kth_handover_train.npz in
data_dir.
"""

from __future__ import annotations

import time
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

from eaip_prob.runs import experiment

if TYPE_CHECKING:
    from omegaconf import DictConfig


@experiment("handover")
def run(cfg: DictConfig, folder: Path) -> Mapping[str, Any]:
    """Fits and measures fold by fold, draws and records; returns the metrics."""
    import torch
    from tqdm import tqdm

    from eaip_prob.config import build, repository_path
    from eaip_prob.data import DemonstrationSet, read_handover
    from eaip_prob.methods import METHODS, FittedMethods
    from eaip_prob.tasks.recorded import consecutive_folds, pictures, recordings, report, studied

    started = time.perf_counter()
    demonstrations = read_handover(repository_path(cfg.data_dir))

    models = {name: build(model) for name, model in cfg.models.items()}

    def fit(training: DemonstrationSet) -> FittedMethods:
        shuffle = torch.Generator().manual_seed(cfg.seed)
        return FittedMethods.fit(build(cfg.predictor), build(cfg.paper), training, shuffle, models)

    folds = tqdm(consecutive_folds(demonstrations, cfg.num_folds), "recordings left out", disable=None)
    study = studied(demonstrations, folds, fit, (*METHODS, *models), list(cfg.percent_seen), list(cfg.examples))
    text = report.text(study, "m", "recordings")
    pictures.draw(folder, study, "m")
    with build(
        cfg.recording, path=folder / "recording.rrd", application_id="handover", recording_id=f"handover-{cfg.seed}"
    ) as logger:
        recordings.record_handover(logger, study, text, torch.Generator().manual_seed(cfg.seed))
    print(text)
    return study.metrics() | {"seconds/total": time.perf_counter() - started}


if __name__ == "__main__":
    run()

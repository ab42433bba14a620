"""What the bag task withstands: success against errors of the detector, hidden hands, wrong classes, delays and tempos.

Each condition repeats the same trials with one thing wrong. Every run ends in a stated outcome. The study is long;
finished runs are kept in cache_dir, and the same command goes on where it was interrupted.
"""

from __future__ import annotations

import time
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

from eaip_prob.runs import experiment

if TYPE_CHECKING:
    from omegaconf import DictConfig


@experiment("bag_robustness")
def run(cfg: DictConfig, folder: Path) -> Mapping[str, Any]:
    """Runs the methods under every condition; returns `success|collisions|covered|held/{condition}/{method}`."""
    from eaip_prob.config import repository_path
    from eaip_prob.tables import text_table
    from eaip_prob.tasks.bag_covering import report, robustness, robustness_pictures, setting
    from eaip_prob.tasks.bag_covering.people import TEST
    from eaip_prob.tasks.bag_covering.running import all_performed

    started = time.perf_counter()
    room = setting.room(cfg)
    shared = setting.fitted(cfg, setting.demonstrations(cfg))
    cases = room.cases(list(room.things), TEST, cfg.trials, cfg.seed, cfg.cue)
    jobs = robustness.jobs(cfg, cases, shared)
    cache = repository_path(cfg.cache_dir)
    results = dict(report.followed(all_performed(jobs, cache, setting.context(cfg), cfg.processes), len(jobs)))
    metrics = robustness.outcomes(results)
    print(text_table(robustness.summary(metrics, cfg.methods)))
    robustness_pictures.draw(folder, metrics, cfg.methods)
    return {**metrics, "seconds/total": time.perf_counter() - started}


if __name__ == "__main__":
    run()

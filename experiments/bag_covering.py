"""Sec. 4.2.2 and 5 of the paper: Baxter and a person whom it has not met cover eight objects with a bag.

Each method plans the robot's left arm from the beginning of the person's motion; the environment-adaptive ones are also
told what a detector sees of the object. Every run is simulated to its end, with the bag, and is covered, uncovered,
collided, held or aborted. `perception=kinects` sees through three rendered Kinects, `perception=oracle` is quick.
Finished runs are kept in cache_dir; the same command goes on where it was interrupted.
"""

from __future__ import annotations

import time
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

from eaip_prob.runs import experiment

if TYPE_CHECKING:
    from omegaconf import DictConfig


@experiment("bag_covering")
def run(cfg: DictConfig, folder: Path) -> Mapping[str, Any]:
    """Fits, runs every method on every case, and measures; returns the metrics."""
    from eaip_prob.config import build, repository_path
    from eaip_prob.robot import baxter_left_arm
    from eaip_prob.tables import text_table
    from eaip_prob.tasks.bag_covering import cues, pictures, recording, report, setting, study
    from eaip_prob.tasks.bag_covering.people import TEST
    from eaip_prob.tasks.bag_covering.running import all_performed
    from eaip_prob.tasks.bag_covering.telling import tells

    started = time.perf_counter()
    room, recorded = setting.room(cfg), setting.demonstrations(cfg)
    shared = setting.fitted(cfg, recorded)
    metrics: dict[str, Any] = {"seconds/fit": time.perf_counter() - started}

    cases = room.cases(list(room.things), TEST, cfg.trials, cfg.seed, cfg.cue)
    jobs = setting.jobs(cases, cfg.methods, shared)
    cache = repository_path(cfg.cache_dir)
    results = dict(report.followed(all_performed(jobs, cache, setting.context(cfg), cfg.processes), len(jobs)))
    metrics |= report.outcomes(results) | {"seconds/runs": time.perf_counter() - started - metrics["seconds/fit"]}

    seen = setting.seen(results, shared)
    plans = study.table(shared.predictors, seen, baxter_left_arm(), cfg.methods)
    rows = list(report.followed(plans, len(seen) * len(cfg.methods), "plans"))
    metrics |= study.summary(rows) | tells(recorded)
    metrics |= cues.gaps(cfg, cfg.cues, shared.predictors.ours, cfg.processes) if cfg.cues else {}

    text = text_table(report.summary(metrics, cfg.methods, list(room.things)))
    print(text)
    pictures.draw_all(folder, room, recorded, cases, results, rows, metrics)
    nothing = cfg.recording._target_.endswith("NullLogger")
    for path, job in () if nothing else recording.recording_files(folder, results).items():
        name = job.case.site.name
        with build(
            cfg.recording, path=path, application_id="bag_covering", recording_id=f"{name}-{cfg.seed}"
        ) as logger:
            recording.record_run(logger, job, text)
    metrics["seconds/total"] = time.perf_counter() - started
    return metrics


if __name__ == "__main__":
    run()

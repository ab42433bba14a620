"""How much people vary in tempo, whether the scene explains it, and which clock copes with it: simulated people.

People who pass over a rectangle take a log-normal time; the rectangle explains all of its variance, most of it, or
nothing. Each clock is fitted to each kind of people and predicts the rest of their motions, in real time, after 20, 50
and 80 % of them. A run that was interrupted and is started again with the same run_dir goes on where it stopped.
"""

from __future__ import annotations

import time
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

from eaip_prob.runs import experiment

if TYPE_CHECKING:
    from omegaconf import DictConfig


@experiment("timing")
def run(cfg: DictConfig, folder: Path) -> Mapping[str, Any]:
    """Fits and measures condition by condition, draws and records; returns the metrics."""
    from omegaconf import OmegaConf
    from tqdm import tqdm

    from eaip_prob.config import build
    from eaip_prob.parts import completed
    from eaip_prob.tasks.sweeps import charts, timing

    started = time.perf_counter()
    settings: Any = OmegaConf.to_container(cfg, resolve=True)
    parts = timing.parts(settings)
    results = dict(tqdm(completed(folder, parts, timing.measure), "conditions", len(parts), disable=None))
    metrics = timing.metrics(settings, results)
    text = timing.report(settings, metrics)
    charts.draw(folder, timing.charts(settings, metrics, settings["percent_seen"]))
    with build(
        cfg.recording, path=folder / "recording.rrd", application_id="timing", recording_id=f"timing-{cfg.seed}"
    ) as logger:
        middle = settings["percent_seen"][len(settings["percent_seen"]) // 2]
        charts.record(logger, timing.charts(settings, metrics, [middle])[:2], text, scale=100.0)
    print(text)
    return metrics | {"seconds/total": time.perf_counter() - started}


if __name__ == "__main__":
    run()

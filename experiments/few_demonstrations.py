"""How many demonstrations it takes, for each covariance estimator, feature map and clock: simulated people.

Each demonstration passes over a rectangle of its own, of random width and height. Predictors are fitted to 5 to 80 of
them, several times to independent ones, and predict the rest of other people's motions over other rectangles, in real
time, after 20, 50 and 80 % of them. A run that was interrupted and is started again with the same run_dir goes on where
it stopped.
"""

from __future__ import annotations

import time
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

from eaip_prob.runs import experiment

if TYPE_CHECKING:
    from omegaconf import DictConfig


@experiment("few_demonstrations")
def run(cfg: DictConfig, folder: Path) -> Mapping[str, Any]:
    """Fits and measures condition by condition, draws and records; returns the metrics."""
    from omegaconf import OmegaConf
    from tqdm import tqdm

    from eaip_prob.config import build
    from eaip_prob.parts import completed
    from eaip_prob.tasks.sweeps import charts, few_demonstrations

    started = time.perf_counter()
    settings: Any = OmegaConf.to_container(cfg, resolve=True)
    parts = few_demonstrations.parts(settings)
    results = dict(tqdm(completed(folder, parts, few_demonstrations.measure), "fits", len(parts), disable=None))
    summary = few_demonstrations.summaries(settings, results)
    shown = few_demonstrations.charts(settings, summary)
    text = few_demonstrations.report(settings, summary)
    charts.draw(folder, shown)
    with build(
        cfg.recording,
        path=folder / "recording.rrd",
        application_id="few_demonstrations",
        recording_id=f"few_demonstrations-{cfg.seed}",
    ) as logger:
        charts.record(logger, shown, text)
    print(text)
    return few_demonstrations.metrics(summary) | {"seconds/total": time.perf_counter() - started}


if __name__ == "__main__":
    run()

"""One table and figures over the runs of a sweep, with means and intervals over seeds: report.py runs=FOLDER.

Also over a sweep that still runs or was stopped: finished runs count, all others are named. Writes report.md,
report.csv, report.parquet, runs.csv and figures into FOLDER/report, or into run_dir, and replaces what an earlier
report left there. In quotes: "baseline='model=kernel'", "metrics=['rmse/*']".
"""

from __future__ import annotations

import os
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

from eaip_prob.runs import experiment

if TYPE_CHECKING:
    from omegaconf import DictConfig


@experiment("report", repeatable=True)
def run(cfg: DictConfig, folder: Path) -> Mapping[str, Any]:
    """Reads the runs, writes tables and figures, prints the page's tables; returns counts."""
    from omegaconf import OmegaConf

    from eaip_prob import reports
    from eaip_prob.config import build
    from eaip_prob.errors import InputError
    from eaip_prob.files import write_text
    from eaip_prob.reports import charts

    if OmegaConf.is_missing(cfg, "runs"):
        raise InputError("Expected runs, the folder of a sweep or of one run, got none. Name it: runs=FOLDER.")
    place = Path(str(cfg.runs))
    settings: Any = OmegaConf.to_container(cfg)
    patterns = reports.checked_patterns(settings["metrics"])
    runs = reports.read_runs(place)
    sections = reports.sections(runs, None if cfg.baseline is None else str(cfg.baseline))
    figures = charts.draw(folder, sections, patterns, {name: build(axis) for name, axis in cfg.axes.items()})
    statistics = reports.statistics_table(sections)
    reports.write_csv(statistics, folder / "report.csv")
    reports.write_parquet(statistics, folder / "report.parquet")
    reports.write_csv(reports.runs_table(runs, sections), folder / "runs.csv")
    title = "/".join(place.resolve().parts[-2:])
    write_text(folder / "report.md", reports.page(title, runs, sections, patterns, figures))
    print(reports.page(title, runs, sections, patterns, {}))
    print(f"report.md, report.csv, report.parquet, runs.csv and figures/ are in {os.path.relpath(folder)}.")
    counts = {f"num_{state}": sum(run.state == state for run in runs) for state in reports.STATES}
    return counts | {"num_settings": sum(len(section.counted) for section in sections), "num_rows": len(statistics)}


if __name__ == "__main__":
    run()

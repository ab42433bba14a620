"""Run folders as experiments leave them, without running one."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import yaml


def leave_run(
    folder: Path,
    config: Mapping[str, Any],
    metrics: Mapping[str, float] | None = None,
    overrides: Sequence[str] = (),
    experiment: str = "passing_over",
    error: str | None = None,
) -> Path:
    folder.mkdir(parents=True)
    (folder / "config.yaml").write_text(yaml.safe_dump(dict(config)))
    environment = {"experiment": experiment, "overrides": sorted(overrides), "seed": config.get("seed")}
    (folder / "environment.json").write_text(json.dumps(environment))
    if metrics is not None:
        (folder / "metrics.json").write_text(json.dumps(dict(metrics)))
    if error is not None:
        (folder / "error.txt").write_text(error)
    return folder


def leave_sweep(
    folder: Path, values: Mapping[str, Mapping[int, Mapping[str, float]]], key: str = "model", **more: Any
) -> Path:
    """`values` is {choice: {seed: metrics}}."""
    for choice, seeds in values.items():
        for seed, metrics in seeds.items():
            overrides = [f"{key}={choice}", f"seed={seed}"]
            leave_run(folder / ",".join(overrides), {key: choice, "seed": seed}, metrics, overrides, **more)
    return folder

"""The same trials with one thing wrong at a time."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from eaip_prob.config import build
from eaip_prob.tasks.bag_covering.cases import Case
from eaip_prob.tasks.bag_covering.faults import Faults
from eaip_prob.tasks.bag_covering.outcome import SCORES
from eaip_prob.tasks.bag_covering.perceiving import AbstractPerception
from eaip_prob.tasks.bag_covering.running import Job, Result, Setting


def jobs(cfg: Any, cases: Sequence[Case], shared: Setting) -> list[Job]:
    """Every method on every case under every condition.

    Args:
        cfg: with `methods`, `conditions` and, of a perception that is ideal, `detector_errors`.
        cases: trials.
        shared: what runs share where nothing is wrong.
    """
    settings = {
        f"detector_error_{factor:g}": replace(shared, perception=_worse(cfg, factor)) for factor in _factors(cfg)
    }
    found = [_job(case, method, setting, name, Faults()) for name, setting in settings.items()
             for case in cases for method in cfg.methods]  # fmt: skip
    for name, arguments in cfg.conditions.items():
        faults = Faults(**arguments)
        found += [_job(case, method, shared, name, faults) for case in cases for method in cfg.methods]
    return found


def _job(case: Case, method: str, setting: Setting, condition: str, faults: Faults) -> Job:
    return Job(case, method, setting, faults, f"{method}: {case.name}", condition)


def _factors(cfg: Any) -> list[float]:
    return [] if cfg.perception.get("detector", {}).get("place_std") is None else list(cfg.detector_errors)


def _worse(cfg: Any, factor: float) -> AbstractPerception:
    from omegaconf import OmegaConf

    perception = OmegaConf.create(OmegaConf.to_container(cfg.perception, resolve=True))
    perception.detector.box_std = factor * perception.detector.box_std
    perception.detector.place_std = [factor * std for std in np.broadcast_to(perception.detector.place_std, 6).tolist()]
    return build(perception)


def outcomes(results: Mapping[Job, Result]) -> dict[str, float]:
    """`success|collisions|covered|held/{condition}/{method}`, shares of the runs.

    Args:
        results: of all jobs.
    """
    groups: dict[tuple[str, str], list[dict[str, float]]] = {}
    for job, result in results.items():
        groups.setdefault((job.condition, job.method), []).append(result.run.flags())
    return {
        f"{score}/{condition}/{method}": float(np.mean([flags[score] for flags in members]))
        for (condition, method), members in groups.items()
        for score in SCORES
    }


def summary(metrics: Mapping[str, float], methods: Sequence[str]) -> list[dict[str, Any]]:
    """Rows of a table: outcomes of each method under each condition.

    Args:
        metrics: of `outcomes`.
        methods: in the order of the columns.
    """
    conditions = dict.fromkeys(name.split("/")[1] for name in metrics)
    return [
        {"condition": condition}
        | {f"{score} {method}": metrics[f"{score}/{condition}/{method}"] for method in methods for score in SCORES}
        for condition in conditions
    ]

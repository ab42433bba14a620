"""Metrics and tables of many runs, and the bars that show how far they are."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from typing import Any, TypeVar

import numpy as np

from eaip_prob.evaluation import success_share
from eaip_prob.tasks.bag_covering.outcome import SCORES
from eaip_prob.tasks.bag_covering.running import Job, Result

_Row = TypeVar("_Row")


def followed(items: Iterable[_Row], total: int, name: str = "runs") -> Iterator[_Row]:
    """The items, with a progress bar.

    Args:
        items: as they come.
        total: number of them.
        name: of the bar.
    """
    from tqdm import tqdm

    return iter(tqdm(items, name, total, disable=None))


def outcomes(results: Mapping[Job, Result]) -> dict[str, float]:
    """`success|collisions|covered|held/{method}/{object}`, the same over all objects, and `act_seconds/{method}`.

    `success_low/{method}` and `success_high/{method}` are the 95 % interval of success over all objects.

    Args:
        results: of all jobs.
    """
    metrics: dict[str, float] = {}
    for method in dict.fromkeys(job.method for job in results):
        own = {job: result.run for job, result in results.items() if job.method == method}
        for name in (*dict.fromkeys(job.case.site.name for job in own), None):
            flags = [run.flags() for job, run in own.items() if name in (None, job.case.site.name)]
            place = method if name is None else f"{method}/{name}"
            metrics |= {f"{score}/{place}": float(np.mean([flag[score] for flag in flags])) for score in SCORES}
        share = success_share(sum(run.is_success for run in own.values()), len(own))
        metrics |= {f"success_low/{method}": share.low, f"success_high/{method}": share.high}
        act = [min(run.ready, job.case.motion.duration) for job, run in own.items()]
        metrics[f"act_seconds/{method}"] = float(np.mean(act))
    return metrics


def summary(metrics: Mapping[str, float], methods: Sequence[str], names: Sequence[str]) -> list[dict[str, Any]]:
    """Rows of a short table: success on each object, outcomes over all, and when the robot may act.

    Args:
        metrics: of `outcomes` and `study.summary`.
        methods: in the order of the rows.
        names: of the objects, in the order of the columns.
    """
    rows = []
    for method in methods:
        row: dict[str, Any] = {"method": method}
        row |= {name: metrics[f"success/{method}/{name}"] for name in names}
        row |= {score: metrics[f"{score}/{method}"] for score in SCORES}
        row |= {"act (s)": metrics[f"act_seconds/{method}"], "in 90 %": metrics[f"coverage90/{method}"]}
        rows.append(row)
    return rows


def reasons(results: Mapping[Job, Result]) -> list[dict[str, Any]]:
    """Rows of a table of the runs that were no success, with the reason.

    Args:
        results: of all jobs.
    """
    failed = [(job, result.run) for job, result in results.items() if not result.run.is_success]
    return [{"run": job.name, "outcome": run.kind, "reason": run.reason} for job, run in failed]

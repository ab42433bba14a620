"""Times the core operations: 9 signals (6 human, 3 robot), 200 samples over 2 s, 20 bases, one thread.

encode_N      N complete motions to weights: a ProMP for the human's 6 signals, a DMP for the robot's 3
condition_M   the first M samples of the human to the mean and covariance of the robot's weights, observation included
rollout_N     weights to N motions of 200 samples of the robot's 3 signals, by a DMP; rollout_500_9 of 9 signals
dtw_200       open-end alignment, 200 samples against 200, 6 signals
dtw_step      the same for one more sample
predict       100 samples of the human to the mean and variance of the robot at 200 times, with one phase path
update_expected_clock  one more frame of a person who is followed (after 100 samples, on the expected clock, squares and
              products of 3 features, 90 demonstrations) to the robot's weights
update_kernel the same with the kernel model
stream_step   the first to the mean and variance of the robot at 20 times ahead

Each is timed beside the plain way to do it, in numpy (see _core_plain.py), on the same numbers. All take turns, so
that a busy spell of the machine falls on all of them. metrics.json holds medians (ms/..., plain/...) and 10th and 90th
percentiles (spread/...), machine.json the processor and its load.
"""

from __future__ import annotations

import contextlib
import gc
import json
import os
import platform
import time
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

from eaip_prob.runs import experiment

if TYPE_CHECKING:
    from omegaconf import DictConfig


@experiment("benchmarks/core")
def run(cfg: DictConfig, folder: Path) -> Mapping[str, Any]:
    """Times all operations in turn, prints the table; returns medians and percentiles in milliseconds."""
    import numpy as np
    from _core_jobs import jobs

    from eaip_prob.files import write_text
    from eaip_prob.tables import text_table

    pairs = jobs(cfg.seed)
    load = os.getloadavg()
    ours = {f"ms/{name}": pair.package for name, pair in pairs.items()}
    theirs = {f"plain/{name}": pair.plain for name, pair in pairs.items()}
    times = interleaved(ours | theirs, cfg.repetitions, cfg.sample_ms)
    machine = {"cpu": cpu_model(), "cores": os.cpu_count(), "load_before": load, "load_after": os.getloadavg()}
    write_text(folder / "machine.json", json.dumps(machine, indent=2) + "\n")
    medians = {name: float(np.median(sample)) for name, sample in times.items()}
    tenths = {name: np.percentile(times[f"ms/{name}"], (10, 90)) for name in pairs}
    spread = {name: {"p10": float(low), "p90": float(high)} for name, (low, high) in tenths.items()}
    print(text_table(list(rows(medians, spread, cfg.targets)), digits=3))
    print(f"{machine['cpu']}, {machine['cores']} cores, load {load[0]:.2f} before and {os.getloadavg()[0]:.2f} after")
    return medians | {"spread": spread}


def rows(
    medians: Mapping[str, float], spread: Mapping[str, Mapping[str, float]], targets: Mapping[str, float]
) -> Iterator[dict[str, Any]]:
    """Rows of the printed table, milliseconds."""
    for name, part in spread.items():
        ours, plain = medians[f"ms/{name}"], medians[f"plain/{name}"]
        numbers = {"ms": ours, "10 %": part["p10"], "90 %": part["p90"], "target": targets.get(name), "plain": plain}
        yield {"operation": name, **numbers, "plain / ms": plain / ours}


def interleaved(jobs: Mapping[str, Callable[[], Any]], repetitions: int, sample_ms: float) -> dict[str, list[float]]:
    """Milliseconds per call of each job, one number for each round.

    A number is the mean over calls that together last `sample_ms`; a call that is not timed comes first, so that
    neither compilation nor the caches that the job before has filled count.
    """
    with quiet():
        calls = {name: max(1, round(sample_ms / per_call(job, 3))) for name, job in jobs.items()}
        times: dict[str, list[float]] = {name: [] for name in jobs}
        for _ in range(repetitions):
            for name, job in jobs.items():
                times[name].append(per_call(job, calls[name]))
    return times


def per_call(job: Callable[[], Any], calls: int) -> float:
    """Mean milliseconds of some calls, after one that is not timed."""
    job()
    started = time.perf_counter_ns()
    for _ in range(calls):
        job()
    return (time.perf_counter_ns() - started) / (1e6 * calls)


@contextlib.contextmanager
def quiet() -> Iterator[None]:
    """Keeps the garbage collector out of what is timed."""
    enabled = gc.isenabled()
    gc.collect()
    gc.disable()
    try:
        yield
    finally:
        if enabled:
            gc.enable()


def cpu_model() -> str:
    """Name of the processor, as far as the system tells."""
    info = Path("/proc/cpuinfo")
    lines = info.read_text(encoding="utf-8").splitlines() if info.exists() else []
    models = [line.partition(":")[2].strip() for line in lines if line.startswith("model name")]
    return models[0] if models else platform.processor() or platform.machine()


if __name__ == "__main__":
    run()

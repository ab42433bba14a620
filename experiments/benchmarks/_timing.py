"""How benchmarks take times: all jobs in turn, so that a busy spell of the machine falls on all of them."""

from __future__ import annotations

import contextlib
import gc
import json
import os
import platform
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any


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


def medians_of(times: Mapping[str, Sequence[float]]) -> dict[str, float]:
    """Median of each job, milliseconds."""
    import numpy as np

    return {name: float(np.median(sample)) for name, sample in times.items()}


def spread_of(times: Mapping[str, Sequence[float]]) -> dict[str, dict[str, float]]:
    """10th and 90th percentile of each job, milliseconds."""
    import numpy as np

    tenths = {name: np.percentile(sample, (10, 90)) for name, sample in times.items()}
    return {name: {"p10": float(low), "p90": float(high)} for name, (low, high) in tenths.items()}


def machine() -> dict[str, Any]:
    """What the times depend on, before they are taken."""
    return {"cpu": cpu_model(), "cores": os.cpu_count(), "load_before": os.getloadavg()}


def written_beside(folder: Path, before: Mapping[str, Any]) -> str:
    """Writes machine.json beside the results; returns its content as a sentence."""
    from eaip_prob.files import write_text

    full = {**before, "load_after": os.getloadavg()}
    write_text(folder / "machine.json", json.dumps(full, indent=2) + "\n")
    loads = f"load {full['load_before'][0]:.2f} before and {full['load_after'][0]:.2f} after"
    return f"{full['cpu']}, {full['cores']} cores, {loads}"

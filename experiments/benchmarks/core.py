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

from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

from eaip_prob.runs import experiment

if TYPE_CHECKING:
    from omegaconf import DictConfig


@experiment("benchmarks/core")
def run(cfg: DictConfig, folder: Path) -> Mapping[str, Any]:
    """Times all operations in turn, prints the table; returns medians and percentiles in milliseconds."""
    from _core_jobs import jobs
    from _timing import interleaved, machine, medians_of, spread_of, written_beside

    from eaip_prob.tables import text_table

    pairs = jobs(cfg.seed)
    before = machine()
    ours = {f"ms/{name}": pair.package for name, pair in pairs.items()}
    theirs = {f"plain/{name}": pair.plain for name, pair in pairs.items()}
    times = interleaved(ours | theirs, cfg.repetitions, cfg.sample_ms)
    line = written_beside(folder, before)
    medians = medians_of(times)
    spread = spread_of({name: times[f"ms/{name}"] for name in pairs})
    print(text_table(list(rows(medians, spread, cfg.targets)), digits=3))
    print(line)
    return medians | {"spread": spread}


def rows(
    medians: Mapping[str, float], spread: Mapping[str, Mapping[str, float]], targets: Mapping[str, float]
) -> Iterator[dict[str, Any]]:
    """Rows of the printed table, milliseconds."""
    for name, part in spread.items():
        ours, plain = medians[f"ms/{name}"], medians[f"plain/{name}"]
        numbers = {"ms": ours, "10 %": part["p10"], "90 %": part["p90"], "target": targets.get(name), "plain": plain}
        yield {"operation": name, **numbers, "plain / ms": plain / ours}


if __name__ == "__main__":
    run()

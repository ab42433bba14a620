"""Times perception: three simulated Kinect v2 at one moment of a person's motion, on this machine's cores.

render_rgbd_3      three RGB-D views: depth 512 x 424, colour 480 x 270 with shadows, from building the scene on
render_colour_960  a colour image of 960 x 540 for a detector, from building the scene on
noise              the noise of one frame
track_3            three frames to the position and covariance of both gloves
yolo, onnx         a colour image of 960 x 540 to objects, by torch and by OpenCV from the exported network
loop/*             parts of the bag task's loop from cached images, and its two kinds of frame: look and total
fuse_3             three frames to one coloured cloud of 1 cm voxels; beside it, by open3d's own filters

All take turns, so that a busy spell of the machine falls on all of them. metrics.json holds medians (ms, plain), the
10th and 90th percentiles (spread/...), and by how much the most memory that was held grows while many frames are
tracked and fused (memory/growth_mb, after a tenth of them); machine.json the processor and its load.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

from eaip_prob.runs import experiment

if TYPE_CHECKING:
    from _perception_jobs import Moments
    from omegaconf import DictConfig


@experiment("benchmarks/perception")
def run(cfg: DictConfig, folder: Path) -> Mapping[str, Any]:
    """Times all operations in turn, prints the table; returns medians and percentiles in milliseconds."""
    from _loop_jobs import loop_jobs
    from _perception_jobs import Moments, jobs
    from _timing import interleaved, machine, medians_of, spread_of, written_beside

    from eaip_prob.tables import text_table

    moments = Moments.of(cfg)
    before = machine()
    times = interleaved(jobs(moments, cfg.seed, folder) | loop_jobs(cfg), cfg.repetitions, sample_ms=0.0)
    line = written_beside(folder, before)
    medians = medians_of(times)
    spread = spread_of({name[3:]: sample for name, sample in times.items() if name.startswith("ms/")})
    print(text_table(list(rows(medians, spread, cfg.targets)), digits=3))
    growth = memory_growth(moments, cfg.frames)
    print(f"Memory after {cfg.frames} frames: {growth:+.1f} MB against the first tenth. {line}")
    return medians | {"spread": spread, "memory": {"growth_mb": growth}}


def rows(
    medians: Mapping[str, float], spread: Mapping[str, Mapping[str, float]], targets: Mapping[str, float]
) -> Iterator[dict[str, Any]]:
    """Rows of the printed table, milliseconds."""
    for name, part in spread.items():
        plain = medians.get(f"plain/{name}")
        numbers = {"ms": medians[f"ms/{name}"], "10 %": part["p10"], "90 %": part["p90"], "target": targets.get(name)}
        yield {"operation": name, **numbers, "open3d": plain}


def memory_growth(moments: Moments, count: int) -> float:
    """How much more memory many frames took, tracked and fused, than the first tenth of them, MB."""
    start = 0.0
    for number, _ in enumerate(moments.tracked(count)):
        if number == count // 10:
            start = most_held()
    return most_held() - start


def most_held() -> float:
    """The most memory that the process has held so far, MB."""
    import resource

    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1e3


if __name__ == "__main__":
    run()

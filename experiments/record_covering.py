"""Records the demonstrations of the bag task: ten of each of the four training objects, from pixels.

Three simulated Kinects watch ten partners, each of whom covers each object once while the robot's left arm is led. The
gloves are tracked and the object is detected as in the experiment. The set of the package was made by this command;
`output` takes it elsewhere. Finished recordings are kept in cache_dir; the same command goes on where it stopped.
"""

from __future__ import annotations

import time
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

from eaip_prob.runs import experiment

if TYPE_CHECKING:
    from omegaconf import DictConfig


@experiment("record_covering")
def run(cfg: DictConfig, folder: Path) -> Mapping[str, Any]:
    """Records and writes the set; returns how well hands and objects were seen."""
    from eaip_prob.config import build, repository_path
    from eaip_prob.tasks.bag_covering import recording_session, setting
    from eaip_prob.tasks.bag_covering.people import TRAINING
    from eaip_prob.tasks.bag_covering.recorded import save_recorded

    started = time.perf_counter()
    room, perception = setting.room(cfg), build(cfg.perception)
    cases = room.cases(list(setting.things(cfg.training)), TRAINING, cfg.partners, cfg.seed, cfg.cue)
    cache = repository_path(cfg.cache_dir)
    recorded = recording_session.recorded(
        cases, perception, cfg.rate, cache, setting.tracking_context(cfg), cfg.processes
    )
    output = folder / "demonstrations.npz" if cfg.output is None else repository_path(cfg.output)
    save_recorded(output, recorded)
    print(f"{len(recorded)} demonstrations in {output}")
    metrics = recording_session.quality(cases, recorded)
    return {**metrics, "seconds/total": time.perf_counter() - started}


if __name__ == "__main__":
    run()

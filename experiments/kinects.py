"""Three simulated Kinects: calibrated with a board in the robot's hand, then used to follow a person's gloves.

Calibration is done twice on the same images: with the board's poses exact, and as wrong as a robot's are; the gloves
are tracked with what the second one found. Each scenario has something that makes tracking hard. Rendered clips are
kept in clip_dir and rendered once.
"""

from __future__ import annotations

import time
from collections.abc import Mapping
from itertools import islice
from pathlib import Path
from typing import TYPE_CHECKING, Any

from eaip_prob.runs import experiment

if TYPE_CHECKING:
    from omegaconf import DictConfig

    from eaip_prob.perception import Extrinsics


@experiment("kinects")
def run(cfg: DictConfig, folder: Path) -> Mapping[str, Any]:
    """Calibrates, renders or reads the clips, tracks, draws and records; returns the metrics."""
    started = time.perf_counter()
    found, calibration = calibrations(cfg, folder)
    gloves = played(cfg, folder, found)
    return {"calibration": calibration, "gloves": gloves, "seconds/total": time.perf_counter() - started}


def calibrations(cfg: DictConfig, folder: Path) -> tuple[Mapping[str, Extrinsics], dict[str, dict[str, float]]]:
    """(what a calibration with uncertain boards found, errors of both)."""
    import numpy as np
    from tqdm import tqdm

    from eaip_prob.config import build
    from eaip_prob.perception import save_extrinsics
    from eaip_prob.tables import text_table
    from eaip_prob.tasks.kinects.board_session import board_session
    from eaip_prob.tasks.kinects.calibrating import calibrated
    from eaip_prob.tasks.kinects.calibration_pictures import draw_calibration

    cameras = build(cfg.rig).cameras(build(cfg.calibration.camera))
    boards = board_session(
        cameras, cfg.calibration.boards, cfg.seed, progress=lambda numbers: tqdm(numbers, "boards", disable=None)
    )
    lines = [np.linspace(low, high, 5) for low, high in cfg.calibration.space]
    points = np.stack(np.meshgrid(*lines, indexing="ij"), -1).reshape(-1, 3)
    results = {
        "exact": calibrated(boards, points, uncertain=False),
        "uncertain": calibrated(boards, points, uncertain=True),
    }
    metrics = {name: result.metrics() for name, result in results.items()}
    print(text_table([{"boards' poses": name, **row} for name, row in metrics.items()]))
    draw_calibration(folder, boards, results)
    save_extrinsics(folder / "extrinsics.json", results["uncertain"].found)
    return results["uncertain"].found, metrics


def played(cfg: DictConfig, folder: Path, found: Mapping[str, Extrinsics]) -> dict[str, dict[str, float]]:
    """How well the gloves were followed in each scenario."""
    from tqdm import tqdm

    from eaip_prob.config import build, repository_path
    from eaip_prob.perception import posed
    from eaip_prob.tables import text_table
    from eaip_prob.tasks.kinects import followed, tracking_scores
    from eaip_prob.tasks.kinects.pictures import draw_errors, draw_views
    from eaip_prob.tasks.kinects.recording import record_clip

    workspace, noise, cameras = build(cfg.workspace), build(cfg.kinect_noise), build(cfg.rig).cameras(build(cfg.camera))
    clips, paths, states, scores = repository_path(cfg.clip_dir), {}, {}, {}
    for name in cfg.play:
        scenario = build(cfg.scenarios[name])
        clip = scenario.clip(cfg.rate, workspace, cameras, noise, cfg.seed)
        tracker, path = build(cfg.tracker, radius=scenario.glove_radius), scenario.path(cfg.rate)

        def frames(scenario=scenario, clip=clip):
            for step in scenario.delivered(clip.frames(clips)):
                yield [posed(frame, found[frame.name]) for frame in step]

        paths[name] = path
        states[name] = followed(tracker, tqdm(frames(), name, len(clip), disable=None), path.time)
        scores[name] = tracking_scores(states[name], path.position).metrics()
        (middle,) = islice(clip.frames(clips), len(clip) // 2, len(clip) // 2 + 1)
        draw_views(folder, f"views_{name}", middle)
        if name == cfg.record:
            of_run = {"application_id": "kinects", "recording_id": f"kinects-{cfg.seed}"}
            with build(cfg.recording, path=folder / "recording.rrd", **of_run) as logger:
                record_clip(logger, path, frames(), states[name], f"Scenario {name}")
    draw_errors(folder, paths, states)
    print(text_table([{"scenario": name, "frames": len(states[name]), **row} for name, row in scores.items()]))
    return scores


if __name__ == "__main__":
    run()

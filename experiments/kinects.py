"""Three simulated Kinects follow a person's gloves: scripted motions, rendered, made noisy, tracked.

Each scenario has something that makes tracking hard. Rendered clips are kept in clip_dir and rendered once.
"""

from __future__ import annotations

import time
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

from eaip_prob.runs import experiment

if TYPE_CHECKING:
    from omegaconf import DictConfig


@experiment("kinects")
def run(cfg: DictConfig, folder: Path) -> Mapping[str, Any]:
    """Renders or reads the clips, tracks, draws; returns the metrics."""
    from tqdm import tqdm

    from eaip_prob.config import build, repository_path
    from eaip_prob.simulation import Clip
    from eaip_prob.tables import text_table
    from eaip_prob.tasks.kinects import followed, hand_path, tracking_scores
    from eaip_prob.tasks.kinects.pictures import draw_errors, draw_views

    started = time.perf_counter()
    workspace, noise, tracker = build(cfg.workspace), build(cfg.kinect_noise), build(cfg.tracker)
    cameras = build(cfg.rig).cameras(build(cfg.camera))
    paths, states, metrics, rows = {}, {}, {}, []
    for name in tqdm(list(cfg.scenarios), "clips", disable=None):
        path = paths[name] = hand_path(name, cfg.rate)
        clip = Clip(workspace, cameras, path.time, path.position, path.grippers, noise, cfg.seed)
        frames = clip.frames(repository_path(cfg.clip_dir))
        states[name] = followed(tracker, frames)
        scores = tracking_scores(states[name], path.position).metrics()
        metrics[f"gloves/{name}"] = scores
        rows.append({"scenario": name, "frames": len(frames), **scores})
        draw_views(folder, f"views_{name}", frames[len(frames) // 2])
    draw_errors(folder, paths, states)
    print(text_table(rows))
    return metrics | {"seconds/total": time.perf_counter() - started}


if __name__ == "__main__":
    run()

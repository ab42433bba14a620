"""Sec. 4.1 of the paper: pass over a rectangle with a cursor, predicted from the beginning of the motion.

Interaction primitives see the motion alone, environment-adaptive ones also the rectangle's width and height. Compares
this package's predictor with the published method at 10 to 150 samples seen, with the horizontal axis alone and with
both; draws Fig. 2 to 7 and writes a recording of one motion.
"""

from __future__ import annotations

import time
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

from eaip_prob.runs import experiment

if TYPE_CHECKING:
    from omegaconf import DictConfig

EXAMPLE = 27  # a test motion over 215 x 325 px


@experiment("passing_over")
def run(cfg: DictConfig, folder: Path) -> Mapping[str, Any]:
    """Fits all methods, measures them, draws the figures; returns the metrics."""
    import torch
    from tqdm import tqdm

    from eaip_prob.config import build
    from eaip_prob.methods import FittedMethods
    from eaip_prob.tables import text_table
    from eaip_prob.tasks.passing_over import pictures, study
    from eaip_prob.tasks.passing_over.success import passed

    def stream(number: int) -> torch.Generator:
        return torch.Generator().manual_seed(1000 * cfg.seed + number)

    started = time.perf_counter()
    task = build(cfg.task)
    lengths = list(cfg.samples_seen)
    demonstrations = task.demonstrations(cfg.num_train, cfg.seed)
    training = study.Beginnings.of(demonstrations, demonstrations)
    test = study.Beginnings.of(task.demonstrations(cfg.num_test, cfg.seed, "test"), demonstrations)
    test.check_lengths(lengths)
    models = {name: build(model) for name, model in cfg.models.items()}
    methods = FittedMethods.fit(build(cfg.predictor), build(cfg.paper), demonstrations, stream(0), models)
    floor = float(study.floor(test))

    num_rows = len(study.SCENARIOS) * len(lengths) * (len(methods.names) + len(study.GAINS))
    rows = dict(tqdm(study.table(methods, test, methods.names, lengths, task.bound), "scores", num_rows, disable=None))
    scores = {name: row for name, row in rows.items() if not name.startswith("gain/")}
    metrics: dict[str, Any] = {name: row for name, row in rows.items() if name.startswith("gain/")}
    for name, row in scores.items():
        metrics.update({f"{score}/{name}": value for score, value in row.items()})

    per_size = -(-cfg.num_plans // len(task.sizes))
    many = study.Beginnings.of(task.demonstrations(per_size, cfg.seed + 1, "test"), demonstrations)
    num_errors = 4 * len(cfg.feature_errors) * len(cfg.feature_noises)
    errors = study.feature_errors(methods, many, cfg.feature_errors, cfg.feature_noises, stream(1))
    errors = dict(tqdm(errors, "errors in e", num_errors, disable=None))
    metrics |= errors
    metrics |= dict(study.observation_noise(methods, test, methods.names, cfg.sample_noises, stream(2)))
    metrics |= dict(study.paper_sigma(methods, test, lengths))
    novel = list(study.novel_plans(methods, task, cfg.num_plans, lambda number: stream(100 + number)))
    success = {f"{w:g}x{h:g}": float(passed(plans, w, h, task.bound).double().mean()) for (w, h), _, plans in novel}
    metrics |= {f"novel/success/{name}": share for name, share in success.items()}
    metrics |= {f"decodable/{name}": share for name, share in study.decodable(demonstrations).items()}
    metrics["floor/dtw"] = floor

    pictures.draw_motions(folder, training, test)
    pictures.draw_scores(folder, scores, floor)
    example = min(EXAMPLE, len(test.groups) - 1)
    pictures.draw_examples(folder, methods, test, example, lengths)
    pictures.draw_novel(folder, novel, success)
    pictures.draw_feature_errors(folder, methods, many, cfg.feature_errors, cfg.feature_noises, stream(3))
    pictures.draw_error_scores(folder, errors, floor)
    table = study.summary(scores, lengths)
    text = text_table(table)
    with build(
        cfg.recording,
        path=folder / "recording.rrd",
        application_id="passing_over",
        recording_id=f"passing_over-{cfg.seed}",
    ) as logger:
        pictures.record(logger, methods, test, example, lengths, scores, text, stream(4))
    print(text)
    metrics["seconds/total"] = time.perf_counter() - started
    return metrics


if __name__ == "__main__":
    run()

"""How much the advantage of seeing the object depends on what the first motion tells of it.

For each strength of the cue, people are trained and tested anew with the same draws; plans are judged by clearance and
reach alone, and perception is the ideal one.
"""

from __future__ import annotations

from collections.abc import Mapping
from concurrent.futures import ProcessPoolExecutor
from dataclasses import replace
from functools import partial
from multiprocessing import get_context
from typing import Any

import numpy as np

from eaip_prob.config import build
from eaip_prob.methods import EAIP, IP
from eaip_prob.perception.hands import hands_to_trajectory
from eaip_prob.prediction import InteractionPredictor
from eaip_prob.robot import baxter_left_arm
from eaip_prob.tasks.bag_covering import setting
from eaip_prob.tasks.bag_covering.cases import Case
from eaip_prob.tasks.bag_covering.demonstrating import demonstrated
from eaip_prob.tasks.bag_covering.judging import Judge
from eaip_prob.tasks.bag_covering.people import TEST, TRAINING
from eaip_prob.tasks.bag_covering.perceiving import OraclePerception
from eaip_prob.tasks.bag_covering.recorded import demonstration_set
from eaip_prob.tasks.bag_covering.study import Predictors, Seen, passes
from eaip_prob.tasks.bag_covering.telling import tells

PERCENT = 10.0  # of the motion, after which plans are judged
_TRAINED = 10  # partners


def gaps(
    cfg: Any, cues: Mapping[str, float], predictor: InteractionPredictor, num_processes: int = 2
) -> dict[str, float]:
    """Success of `eaip` less that of `ip` at each strength, with both, and what the first second tells.

    Args:
        cfg: of the experiment.
        cues: name -> strength, 0 to 1.
        predictor: the experiment's own, fitted; its noise is taken, since choosing it anew takes most of the time.
        num_processes: run beside each other.

    Returns:
        `gap/{cue}`, `success_at_cue/{cue}/{method}`, `decodable_at_cue/{cue}/{object, size}`.
    """
    metrics: dict[str, float] = {}
    assert predictor.fitted is not None
    noise = predictor.fitted.noise.tolist(), predictor.fitted.environment_noise.tolist()
    with ProcessPoolExecutor(num_processes, mp_context=get_context("spawn")) as pool:
        for name, found in zip(cues, pool.map(partial(_at, cfg, noise), cues.values()), strict=True):
            metrics |= {f"success_at_cue/{name}/{method}": found[method] for method in (IP, EAIP)}
            metrics |= {f"decodable_at_cue/{name}/{what}": found[what] for what in ("object", "size")}
            metrics[f"gap/{name}"] = found[EAIP] - found[IP]
    return metrics


def _at(cfg: Any, noise: tuple[list[float], list[float]], cue: float) -> dict[str, float]:
    import torch

    torch.set_num_threads(1)
    room, perception, encoder = setting.room(cfg), setting.ideal(cfg), build(cfg.encoder)
    trained = list(setting.things(cfg.training))
    recorded = [demonstrated(case, perception) for case in room.cases(trained, TRAINING, _TRAINED, cfg.seed, cue)]
    given = {"noise": noise[0], "environment_noise": noise[1], "recalibrate": False}  # plans do not ask for variances
    predictor = replace(build(cfg.predictor), **given).fit(demonstration_set(recorded, encoder))
    predictors, arm = Predictors(predictor, predictor), baxter_left_arm()
    passed: dict[str, list[bool]] = {IP: [], EAIP: []}
    for case in room.cases(list(room.things), TEST, cfg.trials, cfg.seed, cue):
        seen, judge = _seen(case, perception, encoder), Judge(case.site, arm)
        for method, found in passed.items():
            path = seen.predicted(predictors, method, PERCENT).mean.numpy()
            found.append(passes(judge, arm, case, path))
    told = tells(recorded)
    shares = {method: float(np.mean(found)) for method, found in passed.items()}
    return shares | {"object": told["decodable/object"], "size": told["decodable/size"]}


def _seen(case: Case, perception: OraclePerception, encoder: Any) -> Seen:
    one = demonstrated(case, perception)
    return Seen(case, hands_to_trajectory(one.hands, correlated=False), {"ours": encoder.encode(one.detections)})

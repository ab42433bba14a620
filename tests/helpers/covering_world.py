"""A small bag task: two objects, an ideal perception, a predictor that is fitted in a second."""

from __future__ import annotations

from functools import cache

import numpy as np

from eaip_prob.config import build
from eaip_prob.detection import MetricBoxEncoder
from eaip_prob.phase import ElapsedClock
from eaip_prob.prediction import InteractionPredictor
from eaip_prob.runs import experiment
from eaip_prob.tasks.bag_covering import setting
from eaip_prob.tasks.bag_covering.cases import Case, Room
from eaip_prob.tasks.bag_covering.demonstrating import demonstrated
from eaip_prob.tasks.bag_covering.people import TEST, TRAINING
from eaip_prob.tasks.bag_covering.perceiving import AbstractPerception
from eaip_prob.tasks.bag_covering.recorded import RecordedCovering, demonstration_set
from eaip_prob.tasks.bag_covering.running import Setting
from eaip_prob.tasks.bag_covering.study import Predictors

TRAINED = ("brown_bookshelf", "folding_table", "office_chair", "stepladder")


@experiment("bag_covering")
def _run(cfg, folder):
    return {}


@cache
def configuration():
    return _run.compose([])


@cache
def room() -> Room:
    return setting.room(configuration())


@cache
def perception() -> AbstractPerception:
    return build(configuration().perception)


@cache
def recorded() -> tuple[RecordedCovering, ...]:
    return tuple(demonstrated(case, perception()) for case in room().cases(TRAINED, TRAINING, 4, seed=0))


@cache
def shared() -> Setting:
    encoder = MetricBoxEncoder()
    quick = InteractionPredictor(phase=ElapsedClock(), noise=0.02, gate=False, trust=False, separate=False)
    predictor = quick.fit(demonstration_set(recorded(), encoder))
    return Setting(Predictors(predictor, predictor), perception(), encoder, encoder)


def case(name: str = "brown_bookshelf", number: int = 0) -> Case:
    return room().cases([name], TEST, number + 1, seed=0)[number]


def silhouette_clearance(low: np.ndarray, high: np.ndarray, path: np.ndarray) -> float:
    """Smallest distance of y and z from the rectangle of a box, by a loop."""
    least = np.inf
    for y, z in path[:, 1:]:
        aside = max(low[1] - y, y - high[1], 0.0)
        least = min(least, np.hypot(aside, max(z - high[2], 0.0)))
    return float(least)

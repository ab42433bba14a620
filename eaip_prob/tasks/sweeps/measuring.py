"""What every condition does: fit a predictor, and score it on test motions of which a part was seen."""

from __future__ import annotations

import copy
import warnings
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
import torch

from eaip_prob.checks import check_count
from eaip_prob.config import build
from eaip_prob.data.demonstrations import Demonstration, DemonstrationSet
from eaip_prob.data.environment import EnvironmentFeatures
from eaip_prob.data.trajectory import Trajectory
from eaip_prob.errors import ExtrapolationWarning, InputError
from eaip_prob.forecast import Prediction
from eaip_prob.methods import EAIP, ENVIRONMENT, IP, MEAN, score
from eaip_prob.prediction import InteractionPredictor
from eaip_prob.tasks.passing_over import PassingOver
from eaip_prob.tasks.passing_over.task import FEATURES
from eaip_prob.tasks.recorded import beginning

BASELINES = (MEAN, ENVIRONMENT, IP)
SCORES = ("rmse", "nll", "coverage90")
_STREAMS = 3  # behind those of the task's own train, test and novel


def changed(predictor: Mapping[str, Any], parts: Mapping[str, Any]) -> dict[str, Any]:
    """A predictor's configuration with whole parts replaced; the argument is unchanged.

    Args:
        predictor: as in `conf/`, plain.
        parts: {argument of the predictor: its configuration}.

    Example:
        >>> changed({"_target_": "Predictor", "model": {"_target_": "A", "x": 1}}, {"model": {"_target_": "B"}})
        {'_target_': 'Predictor', 'model': {'_target_': 'B'}}
    """
    return copy.deepcopy({**predictor, **parts})


def measured(
    predictor: Mapping[str, Any],
    training: DemonstrationSet,
    test: DemonstrationSet,
    methods: Sequence[str],
    percents: Sequence[int],
) -> dict[str, float]:
    """Scores on the future of the human's own motion: {"rmse/eaip/50": ...}.

    Args:
        predictor: configuration of one with `target: human`; it is fitted to `training`.
        training: complete motions of one agent, the human.
        test: motions that are cut.
        methods: of `mean`, `environment`, `ip`, `eaip`; all are the one fitted predictor with blocks unobserved.
        percents: of each test motion's own duration that are seen.

    Raises:
        InputError: another method.
    """
    unknown = set(methods) - {*BASELINES, EAIP}
    if unknown:
        raise InputError(f"Expected methods among {(*BASELINES, EAIP)}, got {sorted(unknown)}.")
    fitted: InteractionPredictor = build(predictor).fit(training)
    truth, scene = test.trajectories("human"), test.environments
    assert scene is not None
    metrics = {}
    for percent in percents:
        observed, cut = beginning(truth, percent)
        for method in methods:
            # What becomes of scenes far from the demonstrated ones is part of what is measured.
            with warnings.catch_warnings(action="ignore", category=ExtrapolationWarning):
                prediction = _predicted(fitted, method, observed, scene, truth)
            summary = score(prediction, truth, cut).summary()
            metrics |= {f"{name}/{method}/{percent}": summary[name] for name in SCORES}
    return metrics


def _predicted(
    fitted: InteractionPredictor, method: str, observed: Trajectory, scene: EnvironmentFeatures, truth: Trajectory
) -> Prediction:
    seen = observed.hide(observed.names) if method in (MEAN, ENVIRONMENT) else observed
    return fitted.predict(seen, scene if method in (ENVIRONMENT, EAIP) else None, truth.time)


def scattered(task: PassingOver, num: int, lengths: tuple[float, float], seed: int, stream: int) -> DemonstrationSet:
    """Motions over rectangles of their own, each a group; the first of many are the same as few.

    Args:
        task: whose person moves.
        num: at least one.
        lengths: smallest and largest width and height, px; uniform between.
        seed: not negative.
        stream: not negative; streams share nothing, with each other or with the task's demonstrations of this seed.

    Raises:
        InputError: no motion asked for, a negative seed or stream, or lengths in the wrong order.

    Example:
        >>> few, many = (scattered(PassingOver(), num, (125.0, 325.0), seed=0, stream=1) for num in (2, 3))
        >>> bool((few.environments.value == many.environments.value[:2]).all()), many.groups
        (True, (0, 1, 2))
    """
    check_count("num", num)
    check_count("seed", seed, least=0)
    check_count("stream", stream, least=0)
    low, high = lengths
    if not 0 < low <= high:
        raise InputError(f"Expected lengths as (smallest, largest) above zero, in px, got {lengths}.")
    made = []
    for number in range(num):
        sequence = np.random.SeedSequence(seed, spawn_key=(_STREAMS + stream, number))
        generator = torch.Generator().manual_seed(int(sequence.generate_state(1, np.uint64)[0] >> 1))
        size = low + (high - low) * torch.rand(2, generator=generator, dtype=torch.float64)
        human = task.motions(float(size[0]), float(size[1]), 1, generator)[0]
        made.append(Demonstration(human=human, environment=EnvironmentFeatures(FEATURES, size)))
    return DemonstrationSet(made, range(num))

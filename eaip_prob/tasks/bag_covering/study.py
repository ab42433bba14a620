"""What predictions are worth on the way: plans after some share of the partner's motion, for each method.

Letters: N cases, T times of a case's motion.
"""

from __future__ import annotations

import warnings
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
import torch
from jaxtyping import Float

from eaip_prob.data import EnvironmentFeatures, Trajectory
from eaip_prob.errors import EaipError, ExtrapolationWarning
from eaip_prob.forecast import Prediction
from eaip_prob.methods import EAIP, ENVIRONMENT, IP, MEAN, PAPER_EAIP, PAPER_IP, PUBLISHED, asked, score
from eaip_prob.prediction import InteractionPredictor
from eaip_prob.robot import SerialArm, check_motion
from eaip_prob.tasks.bag_covering.cases import Case
from eaip_prob.tasks.bag_covering.judging import Judge
from eaip_prob.tasks.bag_covering.seeing import led

METHODS = (MEAN, ENVIRONMENT, IP, EAIP, PAPER_IP, PAPER_EAIP)
PERCENTS = (3, 10, 20, 30, 50, 70, 100)
JUDGED = (10, 30, 100)
_PHASES = 50


@dataclass(frozen=True, eq=False)
class Predictors:
    """This package's predictor and the published one, each with the features it was fitted with.

    Args:
        ours: fitted.
        paper: fitted.
    """

    ours: InteractionPredictor
    paper: InteractionPredictor

    def of(self, method: str) -> InteractionPredictor:
        """The one that a method asks.

        Args:
            method: its name.
        """
        return self.paper if method in PUBLISHED else self.ours


@dataclass(frozen=True, eq=False)
class Seen:
    """What was perceived of a case.

    Args:
        case: the trial.
        hands: of the partner, over the whole motion.
        environment: predictor's kind ("ours", "paper") -> features of the scene.
    """

    case: Case
    hands: Trajectory
    environment: Mapping[str, EnvironmentFeatures]

    def until(self, percent: float) -> Trajectory:
        """The hands over the first part of the motion, two samples at least.

        Args:
            percent: of the motion's duration.
        """
        count = int((self.hands.time <= percent / 100.0 * self.case.motion.duration + 1e-9).sum())
        return self.hands.first(max(count, 2))

    def predicted(self, predictors: Predictors, method: str, percent: float) -> Prediction:
        """The robot's path as predicted by then, at the times of the true one.

        Args:
            predictors: fitted.
            method: its name.
            percent: of the motion's duration.
        """
        environment = self.environment["paper" if method in PUBLISHED else "ours"]
        time = torch.from_numpy(self.case.motion.time)
        # Objects that nobody demonstrated are what is studied.
        with warnings.catch_warnings(action="ignore", category=ExtrapolationWarning):
            return asked(predictors.of(method), method, self.until(percent), environment, time)


@dataclass(frozen=True, eq=False)
class Planned:
    """What one plan is worth.

    Args:
        path: (T, 3), at the times of the case's motion, m.
        shape: (P, 3), the whole path evenly over its phase, so that tempo has no part in it, m.
        error: root mean squared distance from the path that a demonstrator would lead, m.
        coverage90: share of the samples after the last one seen in the 90 % interval.
    """

    path: Float[np.ndarray, "time 3"]
    shape: Float[np.ndarray, "phases 3"]
    error: float
    coverage90: float


def plans(predictors: Predictors, seen: Seen, method: str, percents: Sequence[float]) -> dict[float, Planned]:
    """The plans of one method for one case.

    Args:
        predictors: fitted.
        seen: the case as perceived.
        method: its name.
        percents: shares of the motion that were seen.
    """
    motion, found = seen.case.motion, {}
    truth = led(motion.time, motion.gripper)
    for percent in percents:
        prediction = seen.predicted(predictors, method, percent)
        path = prediction.mean.numpy()
        last = min(float(seen.until(percent).time[-1]), motion.time[-2])
        inside = score(prediction, truth, torch.tensor(last, dtype=torch.float64)).coverage90
        shape = prediction.plan(_PHASES).numpy()
        found[percent] = Planned(path, shape, distance(path, motion.gripper), float(inside))
    return found


def distance(path: Float[np.ndarray, "time 3"], other: Float[np.ndarray, "time 3"]) -> float:
    """Root mean squared distance of two paths at the same times, m.

    Args:
        path: (T, 3), m.
        other: (T, 3), m.

    Example:
        >>> round(distance(np.zeros((2, 3)), np.array([[3.0, 4.0, 0.0], [0.0, 0.0, 0.0]])) ** 2, 9)
        12.5
    """
    return float(np.sqrt(np.square(path - other).sum(-1).mean()))


def passes(judge: Judge, arm: SerialArm, case: Case, path: Float[np.ndarray, "time 3"]) -> bool:
    """Whether a path, taken as it is, clears the object and can be taken by the arm.

    Args:
        judge: of the case's object.
        arm: the robot's.
        case: whose partner moves as they did.
        path: (T, 3), at the times of the case's motion, m.
    """
    motion = case.motion
    try:
        reached = check_motion(arm, motion.time, path).reason is None
    except EaipError:
        return False
    return reached and not judge.clearance(path, motion.hands[:, 1]).collides()


def table(
    predictors: Predictors, cases: Sequence[Seen], arm: SerialArm, methods: Sequence[str] = METHODS
) -> Iterator[tuple[Seen, str, dict[float, Planned], dict[int, bool]]]:
    """(case, method, its plans by percent, whether they pass) for each case and method.

    Args:
        predictors: fitted.
        cases: as perceived.
        arm: the robot's.
        methods: names.
    """
    for seen in cases:
        judge = Judge(seen.case.site, arm)
        for method in methods:
            found = plans(predictors, seen, method, PERCENTS)
            yield seen, method, found, {at: passes(judge, arm, seen.case, found[at].path) for at in JUDGED}


def summary(rows: Sequence[tuple[Seen, str, dict[float, Planned], dict[int, bool]]]) -> dict[str, float]:
    """Metrics over all cases.

    Args:
        rows: of `table`.

    Returns:
        `success_at/{method}/{percent}`, `rmse_to_final/...`, `shape_to_final/...` (the same at equal phases instead of
        equal times) and `rmse_to_true/...` in m, `coverage90/{method}` over all
        shares that leave a future.
    """
    metrics: dict[str, float] = {}
    for method in dict.fromkeys(row[1] for row in rows):
        own = [row for row in rows if row[1] == method]
        for percent in PERCENTS:
            final = [distance(found[percent].path, found[PERCENTS[-1]].path) for _, _, found, _ in own]
            metrics[f"rmse_to_final/{method}/{percent}"] = float(np.sqrt(np.mean(np.square(final))))
            shape = [distance(found[percent].shape, found[PERCENTS[-1]].shape) for _, _, found, _ in own]
            metrics[f"shape_to_final/{method}/{percent}"] = float(np.sqrt(np.mean(np.square(shape))))
            true = [found[percent].error for _, _, found, _ in own]
            metrics[f"rmse_to_true/{method}/{percent}"] = float(np.sqrt(np.mean(np.square(true))))
        for percent in JUDGED:
            metrics[f"success_at/{method}/{percent}"] = float(np.mean([passed[percent] for *_, passed in own]))
        future = [found[percent].coverage90 for _, _, found, _ in own for percent in PERCENTS[:-1]]
        metrics[f"coverage90/{method}"] = float(np.mean(future))
    return metrics

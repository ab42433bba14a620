"""What one motion looked like while it was watched: recordings for the rerun viewer."""

from __future__ import annotations

from collections.abc import Sequence

import torch
from jaxtyping import Float
from torch import Tensor

from eaip_prob.data.trajectory import Trajectory
from eaip_prob.methods import EAIP
from eaip_prob.recording import AbstractRunLogger, Moment
from eaip_prob.recording.records import OBSERVED
from eaip_prob.tasks.recorded.folds import beginning
from eaip_prob.tasks.recorded.study import Example, Study

_DRAWS = 10


def record_reach(logger: AbstractRunLogger, study: Study, report: str) -> None:
    """The joints in the image plane beside the opening of the grip, with the prediction after each percentage."""
    example = study.examples[0]
    human, robot = _from_zero(example.motion.human), _from_zero(example.motion.robot)
    logger.blueprint("plane", {f"signals/{robot.names[0]}": f"{robot.names[0]} [px]"}, timeline="time")
    joints = list(dict.fromkeys(name.rsplit(" ", 1)[0] for name in human.names))
    for joint in joints:
        logger.path(f"human/{joint}/truth", _picture(human, joint, human.time <= human.end), label=joint)
    for moment, _ in _moments(human, study.percents):
        for joint in joints:
            seen = _picture(human, joint, human.time <= moment.time)
            logger.path(f"human/{joint}/seen", seen, radius=2.5, color=OBSERVED, at=moment)
    _record_signals(logger, example, robot, study.percents)
    logger.text("scores", report)


def record_handover(logger: AbstractRunLogger, study: Study, report: str, generator: torch.Generator) -> None:
    """Both hands in space beside the giver's coordinates, with the prediction after each percentage."""
    example = study.examples[0]
    human, robot = _from_zero(example.motion.human), _from_zero(example.motion.robot)
    logger.blueprint("space", {f"signals/{name}": f"giver {name} [m]" for name in robot.names}, timeline="time")
    logger.path("taker/truth", human.values, label="taker")
    logger.path("giver/truth", robot.values, label="giver")
    _record_signals(logger, example, robot, study.percents, human, generator)
    logger.text("scores", report)


def _record_signals(
    logger: AbstractRunLogger,
    example: Example,
    robot: Trajectory,
    percents: Sequence[int],
    taker: Trajectory | None = None,
    generator: torch.Generator | None = None,
) -> None:
    """True curves, and the prediction of `eaip` with its 90 % interval from each moment on."""
    for signal, name in enumerate(robot.names):
        seen = robot.mask[:, signal]
        logger.series(f"signals/{name}/truth", robot.time[seen], robot.values[seen][:, signal, None], ["true"])
    human = _from_zero(example.motion.human)
    for moment, percent in _moments(human, percents):
        prediction = example.predictions[EAIP, percent]
        lower, upper = prediction.interval(0.9)
        logger.prediction(
            "giver/eaip" if taker is not None else "robot/eaip",
            robot.time,
            prediction.mean,
            robot.names,
            at=moment,
            lower=lower,
            upper=upper,
            samples=None if generator is None else prediction.sample(_DRAWS, generator),
            observed=None if taker is None else taker.values[taker.time <= moment.time],
        )


def _moments(human: Trajectory, percents: Sequence[int]) -> list[tuple[Moment, int]]:
    moments = []
    for percent in percents:
        seen, cut = beginning(human, percent)
        moments.append((Moment(seen.num_samples, float(cut)), percent))
    return moments


def _picture(human: Trajectory, joint: str, when: Tensor) -> Float[Tensor, "seen 2"]:
    """Path of a joint, y up: rows of an image count downwards."""
    part = human.select([f"{joint} x", f"{joint} y"])
    return part.values[part.mask.all(-1) & when] * torch.tensor([1.0, -1.0], dtype=torch.float64)


def _from_zero(motion: Trajectory | None) -> Trajectory:
    """The motion with time 0 at its first sample, as the viewer's axis begins."""
    assert motion is not None
    return Trajectory(motion.time - motion.time[0], motion.values, motion.names, motion.mask)

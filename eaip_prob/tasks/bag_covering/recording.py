"""One whole run for the rerun viewer: what the cameras saw, what was made of it, what was planned, how it ended."""

from __future__ import annotations

import warnings
from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np
import torch

from eaip_prob.errors import ExtrapolationWarning
from eaip_prob.methods import EAIP
from eaip_prob.perception.hands import HANDS, HandState
from eaip_prob.readiness import remaining_deviation
from eaip_prob.recording import AbstractRunLogger, Moment
from eaip_prob.recording.checks import Color
from eaip_prob.recording.records import PREDICTED, SCENE, TRUTH
from eaip_prob.robot import baxter_left_arm
from eaip_prob.simulation import Mesh
from eaip_prob.tasks.bag_covering.judging import CLEAR, Judge
from eaip_prob.tasks.bag_covering.outcome import READY, Run, ended
from eaip_prob.tasks.bag_covering.outcome_pictures import spoken
from eaip_prob.tasks.bag_covering.recording_views import WORKSPACE, labels_of, lengthened, moment_of, record_views
from eaip_prob.tasks.bag_covering.replaying import RobotBodies, partner_meshes, robot_bodies
from eaip_prob.tasks.bag_covering.running import Job, Result
from eaip_prob.tasks.bag_covering.trial import Step

_PLOTS = {
    "phase": "phase",
    "deviation": "remaining deviation [cm]",
    "risk": "probability of coming too near",
    "clearance": "distance from the object [cm]",
}
_EVERY, _PARTNER = 3, 6  # steps, 30 a second, from one to the next; more in long runs
_PLAN_TIMES, _PLAN_LEVEL = 14, 0.9
_CENTI = 100.0
_FLOOR_COLOR: Color = (105, 103, 98)
_CLOTH_COLOR: Color = (204, 209, 219)
_HAND_COLORS: dict[str, Color] = {"left": (86, 180, 233), "right": (230, 159, 0)}
_UNSEEN: Color = (230, 40, 200)
_REFUSED: Color = (208, 0, 0)
_LEGEND = (
    "Blue, orange: the partner's left and right hand as tracked, magenta where not seen. Orange line and ellipsoids: "
    f"the plan, and where the gripper will be with {_PLAN_LEVEL:.0%} probability; red where the plan was refused. "
    "Grey: paths that were taken. Box: the object as detected. Behind the second tab: what the cameras see."
)


def record_run(logger: AbstractRunLogger, job: Job, table: str = "") -> Run:
    """Runs a job once more, from its first frame to its outcome, and records all of it.

    Args:
        logger: of this recording.
        job: what is run.
        table: Markdown that is added to the report, such as the metrics of the study.

    Returns:
        what came of the run.
    """
    logger.blueprint("workspace", _PLOTS, timeline="time")
    # Objects that nobody demonstrated are among what is shown.
    with warnings.catch_warnings(action="ignore", category=ExtrapolationWarning):
        steps = list(job.steps())
    run = ended(steps, Judge(job.case.site, baxter_left_arm()))
    bodies = robot_bodies(job.case.site, np.stack([step.instant.grippers for step in steps]), _EVERY)
    _record_room(logger, job, steps, bodies)
    _record_bodies(logger, job, steps, bodies)
    record_views(logger, job, steps, bodies)
    for number, step in enumerate(steps):
        _record_seen(logger, job, step, moment_of(number, step))
        _record_plan(logger, step, moment_of(number, step))
    _record_curves(logger, steps, run)
    _record_report(logger, job, steps, run, table)
    return run


def recording_files(folder: Path, results: Mapping[Job, Result], method: str = EAIP) -> Mapping[Path, Job]:
    """Which run goes into which file: recording.rrd has the stepladder, recordings/NAME.rrd the other objects.

    Of each object that is its first run that went to the end, or its first where none did.

    Args:
        folder: of the run.
        results: of all runs, in any order.
        method: whose runs; of the method that comes first in `results` where it was not run.
    """
    methods = [job.method for job in results]
    wanted = method if method in methods else methods[0]
    first: dict[str, Job] = {}
    for job in sorted(results, key=lambda job: (not results[job].run.is_success, job.name)):
        if job.method == wanted:
            first.setdefault(job.case.site.name, job)
    main = "stepladder" if "stepladder" in first else next(iter(first))
    other = {Path(folder) / "recordings" / f"{name}.rrd": job for name, job in first.items() if name != main}
    return {Path(folder) / "recording.rrd": first[main], **other}


def _record_room(logger: AbstractRunLogger, job: Job, steps: Sequence[Step], bodies: RobotBodies | None) -> None:
    site = job.case.site
    (left, right), (near, far), floor = *WORKSPACE[:2], site.room.floor
    corners = [[left - 0.3, near, floor], [right, near, floor], [right, far, floor], [left - 0.3, far, floor]]
    logger.mesh("floor", corners, [[0, 1, 2], [0, 2, 3]], _FLOOR_COLOR)
    _log_mesh(logger, "object", site.mesh)
    if bodies is not None:
        _log_mesh(logger, "robot/body", bodies.still)
    logger.path("gripper/path", [step.instant.grippers[0] for step in steps], radius=0.75)
    logger.path("hands/right/path", [step.instant.hands[1] for step in steps], radius=0.75, color=(*TRUTH[:3], 120))


def _record_bodies(logger: AbstractRunLogger, job: Job, steps: Sequence[Step], bodies: RobotBodies | None) -> None:
    longer = lengthened(steps)
    for number, step in enumerate(steps):
        at = moment_of(number, step)
        if number % (longer * _PARTNER) == 0:
            for name, mesh in partner_meshes(job.case.site, step.instant.hands).items():
                _log_mesh(logger, f"partner/{name}", mesh, at, smooth=True)
        if number % (longer * _EVERY):
            continue
        if bodies is not None and bodies.moves.any():
            _log_mesh(logger, "robot/arm", bodies.moving(number), at, smooth=True)
        if step.instant.bag is not None:
            bag = step.instant.bag
            logger.mesh("bag", bag.vertices, bag.triangles, _CLOTH_COLOR, smooth=True, at=at)


def _log_mesh(
    logger: AbstractRunLogger, entity: str, mesh: Mesh, at: Moment | None = None, smooth: bool = False
) -> None:
    colors = np.rint(255.0 * mesh.color).astype(np.uint8)
    logger.mesh(entity, mesh.vertices, mesh.triangles, colors, smooth=smooth, at=at)


def _record_seen(logger: AbstractRunLogger, job: Job, step: Step, at: Moment) -> None:
    """Hands as tracked, and the object where it was placed."""
    if step.sighting is None:
        return
    if step.sighting.hands is not None:
        _record_hands(logger, step.sighting.hands, at)
    found = step.sighting.detections
    if found is not None and len(found) and found.place is not None and np.isfinite(found.place[0]).all():
        middle, half = found.place[0, :3], found.place[0, 3:] / 2.0
        logger.box("detected", middle - half, middle + half, color=SCENE, label=labels_of(found)[0], at=at)


def _record_hands(logger: AbstractRunLogger, state: HandState, at: Moment) -> None:
    for place, hand in enumerate(HANDS):
        color = _HAND_COLORS[hand] if state.seen[place] else _UNSEEN
        where = state.position[place, None]
        logger.points(f"hands/{hand}/tracked", where, radius=5.0, color=color, labels=[hand], at=at)
        logger.ellipsoids(f"hands/{hand}/ellipsoid", where, state.covariance[place, None], color=color, at=at)


def _record_plan(logger: AbstractRunLogger, step: Step, at: Moment) -> None:
    """The rest of the expected path and its uncertainty, in red where it may not be followed."""
    prediction, verdict = step.report.prediction, step.report.verdict
    if prediction is None or verdict is None:
        return
    end = max(float(prediction.time[-1]), at.time + 0.1)
    rest = prediction.at(torch.linspace(at.time, end, _PLAN_TIMES, dtype=torch.float64))
    color: Color = PREDICTED if verdict.safe else _REFUSED
    logger.path("plan/mean", rest.mean, radius=2.5, color=color, at=at)
    look = (*color[:3], 150)
    logger.ellipsoids("plan/spread", rest.mean, rest.covariance, level=_PLAN_LEVEL, color=look, at=at)


def _record_curves(logger: AbstractRunLogger, steps: Sequence[Step], run: Run) -> None:
    rows = [(number, step) for number, step in enumerate(steps) if step.report.prediction is not None]
    if rows:
        at = np.array([number for number, _ in rows])
        values = {"phase": [], "deviation": [], "risk": []}
        for _, step in rows:
            values["phase"].append(_phase(step))
            values["deviation"].append(_CENTI * _deviation(step))
            values["risk"].append(step.report.verdict.risk if step.report.verdict else 0.0)
        for entity, column in values.items():
            _log_curve(logger, f"{entity}/expected", run.time[at], column, at + 1, entity, PREDICTED)
    near = np.flatnonzero(np.isfinite(run.near))[::_EVERY]
    values = _CENTI * run.near[near]
    _log_curve(logger, "clearance/distance", run.time[near], values, near + 1, "lip and arm", PREDICTED)
    ends = run.time[[0, -1]]
    for entity, level, name in (("deviation", READY, "ready below"), ("clearance", CLEAR, "collision below")):
        _log_curve(logger, f"{entity}/threshold", ends, [_CENTI * level] * 2, [1, len(steps)], name, TRUTH)


def _log_curve(logger: AbstractRunLogger, entity: str, time, values, seen, name: str, color: Color) -> None:  # noqa: ANN001
    logger.series(entity, time, np.asarray(values, float)[:, None], [name], samples_seen=seen, color=color)


def _phase(step: Step) -> float:
    prediction = step.report.prediction
    assert prediction is not None
    return float((prediction.posterior.weight * prediction.phase.paths[..., -1]).sum(-1))


def _deviation(step: Step) -> float:
    assert step.report.prediction is not None
    return float(remaining_deviation(step.report.prediction, step.instant.time).max())


def _record_report(logger: AbstractRunLogger, job: Job, steps: Sequence[Step], run: Run, table: str) -> None:
    """One document that is replaced whenever the robot does something else."""
    told = None
    for number, step in enumerate(steps):
        status = _status(step, run)
        if status != told:
            told = status
            heading = f"# {spoken(job.case.site.name)}, {job.case.partner.name}, {job.method}"
            text = "\n\n".join([heading, f"At {step.instant.time:.1f} s: {status}", _LEGEND, table])
            logger.text("run", text.strip(), at=moment_of(number, step))


def _status(step: Step, run: Run) -> str:
    execution = step.execution
    if execution.outcome is not None:
        ready = f"Certain enough to act after {run.ready:.1f} s." if np.isfinite(run.ready) else ""
        near = f"Nearest to the object: {_CENTI * run.clearance:.1f} cm." if np.isfinite(run.clearance) else ""
        return " ".join(filter(None, (f"**{run.kind}**. {run.reason}", near, ready)))
    if execution.held is not None:
        return f"**holds**. {execution.held}"
    return "**watches** the partner" if execution.plan is None else "**follows** the plan"

"""All figures of the task, under the numbers that they have in the paper."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

from eaip_prob.methods import EAIP, IP, PAPER_EAIP, PAPER_IP
from eaip_prob.tasks.bag_covering.cases import Case, Room
from eaip_prob.tasks.bag_covering.outcome_pictures import (
    draw_final_error,
    draw_outcomes,
    draw_success_at,
    draw_when_to_act,
)
from eaip_prob.tasks.bag_covering.path_pictures import (
    Row,
    draw_behaviour,
    draw_convergence,
    draw_demonstrations,
    draw_early_plans,
)
from eaip_prob.tasks.bag_covering.recorded import RecordedCovering
from eaip_prob.tasks.bag_covering.room_pictures import draw_objects, draw_platform
from eaip_prob.tasks.bag_covering.running import Job, Result
from eaip_prob.tasks.bag_covering.workflow_picture import draw_workflow

STEPLADDER = "stepladder"

_FIG_14 = {
    **dict.fromkeys((IP, PAPER_IP), "fig_14a_ip_paths"),
    **dict.fromkeys((EAIP, PAPER_EAIP), "fig_14b_eaip_paths"),
}


def draw_all(
    folder: Path,
    room: Room,
    recorded: Sequence[RecordedCovering],
    cases: Sequence[Case],
    results: Mapping[Job, Result],
    rows: Sequence[Row],
    metrics: Mapping[str, float],
) -> None:
    """Writes `figures/fig_9_platform.png` to `fig_17b_rmse_to_final.png`, and what the paper does not show.

    Figures that compare two methods show `ip` and `eaip`, the published method in place of one that was not run, or the
    first of all where none of the four was.

    Args:
        folder: of the run.
        room: with all objects.
        recorded: demonstrations, which say what the training objects are.
        cases: that were run.
        results: of all jobs, at least one.
        rows: of `study.table`.
        metrics: of `study.summary`.
    """
    names = list(room.things)
    trained = [name for name in names if name in {one.thing for one in recorded}]
    novel = [name for name in names if name not in trained]
    methods = list(dict.fromkeys(job.method for job in results))
    compared = methods_side_by_side(methods)
    example = stepladder_first([case.site.name for case in cases])
    cameras = next(iter(results)).setting.perception.cameras
    draw_platform(folder, next(case for case in cases if case.site.name == example), cameras)
    draw_objects(folder, "fig_10_training_objects", room, trained)
    draw_objects(folder, "fig_11_novel_objects", room, novel)
    draw_workflow(folder)
    draw_demonstrations(folder, recorded, names)
    draw_early_plans(folder, rows, {_FIG_14.get(method, "fig_14_paths"): method for method in compared}, names)
    draw_behaviour(folder, "fig_15_training_objects_behaviour", results, compared, trained)
    draw_behaviour(folder, "fig_16_novel_objects_behaviour", results, compared, novel)
    draw_convergence(folder, "fig_17a_convergence", rows, compared, example)
    draw_final_error(folder, metrics)
    draw_success_at(folder, metrics)
    draw_outcomes(folder, results, names)
    draw_when_to_act(folder, results, compared)


def methods_side_by_side(methods: Sequence[str]) -> list[str]:
    """One that is blind to the scene and one that is told of it, of those that were run.

    Args:
        methods: that were run, at least one.

    Example:
        >>> methods_side_by_side(["mean", "eaip", "paper_ip"])
        ['paper_ip', 'eaip']
    """
    pairs = ((IP, PAPER_IP), (EAIP, PAPER_EAIP))
    return [next(one for one in pair if one in methods) for pair in pairs if set(pair) & set(methods)] or [methods[0]]


def stepladder_first(names: Sequence[str]) -> str:
    """The object of Fig. 9 and 17, or the first where it was not run.

    Args:
        names: of the objects that were run, at least one.

    Example:
        >>> stepladder_first(["end_table", "stepladder"])
        'stepladder'
    """
    return STEPLADDER if STEPLADDER in names else names[0]

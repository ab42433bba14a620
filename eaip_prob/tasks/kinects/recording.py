"""A clip for the rerun viewer: what the cameras saw, and tracked beside true hands."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence

import numpy as np
from jaxtyping import Bool, Float

from eaip_prob.data.frames import RGBDFrame
from eaip_prob.errors import InputError
from eaip_prob.perception.fusion import fuse, inliers
from eaip_prob.perception.hands import HANDS, HandState
from eaip_prob.recording import AbstractRunLogger, Moment
from eaip_prob.recording.checks import Color
from eaip_prob.recording.records import TRUTH
from eaip_prob.tasks.kinects.paths import HandPath
from eaip_prob.tasks.kinects.study import tracking_scores

WORKSPACE = ((-0.4, 2.3), (-1.2, 1.2), (-0.9, 1.2))  # m; robot, object and person, just above the floor
_VOXEL = 0.015  # m
_COLORS: dict[str, Color] = {"left": (86, 180, 233), "right": (230, 159, 0)}
_UNSEEN: Color = (230, 40, 200)
_PLOTS = {"errors": "distance from the glove [mm]", "spread": "standard deviation [mm]", "seen": "seen (1: yes)"}

_LEGEND = (
    "Grey: true paths and centres of the gloves. Blue, orange: left and right hand as tracked, with the ellipsoid in "
    "which they are with 95 % probability: some millimetres wide while a hand is seen, so zoom in. Magenta: not seen."
)


def record_clip(
    logger: AbstractRunLogger,
    path: HandPath,
    frames: Iterable[Sequence[RGBDFrame]],
    states: Sequence[HandState | None],
    title: str,
    *,
    camera_rate: float = 10.0,
    cloud_rate: float = 3.0,
) -> None:
    """Cameras, fused cloud, both hands as tracked and as they were, and how far the two are apart.

    Hands are drawn as the ellipsoid in which they are with 95 % probability, at its true size, around a marker that is
    as large on the screen at any distance. A tracked hand has its own colour while it is seen, and another else.

    Args:
        logger: of this run.
        path: where the gloves were.
        frames: of the cameras that delivered one, a set for each time of the path; read once, and not kept.
        states: what the tracker said at each time; None before it saw both hands.
        title: of the report, such as the scenario and the tracker.
        camera_rate: sets of images recorded a second; three Kinects take 0.5 MB each.
        cloud_rate: fused clouds recorded a second.

    Raises:
        InputError: another number of sets of frames than times, or a rate not above zero.
        ShapeError: another number of states.

    Example:
        >>> from eaip_prob.recording import NullLogger
        >>> at = HandPath(np.zeros(1), np.array([[[1.2, -0.3, 0.1], [1.2, 0.3, 0.1]]]))
        >>> record_clip(NullLogger(), at, [[]], [None], "nothing seen")
    """
    logger.blueprint("cameras", _PLOTS, timeline="time")
    logger.text("clip", _report(path, states, title))
    for place, hand in enumerate(HANDS):
        logger.path(f"hands/{hand}/path", path.position[:, place], radius=0.75)
    show, fused = _due(path.time, camera_rate), _due(path.time, cloud_rate)
    for place, step in _counted(frames, len(path.time)):
        moment = Moment(place + 1, float(path.time[place]))
        for frame in step if show[place] else ():
            logger.camera(f"cameras/{frame.name}", frame, at=moment)
        if fused[place] and step:
            cloud = fuse(step, WORKSPACE, _VOXEL)
            cloud = cloud.select(inliers(cloud))  # flying pixels hang between all surfaces
            logger.cloud("cloud", cloud.points, cloud.colors, radius=_VOXEL / 2, at=moment)
        _record_hands(logger, path.position[place], states[place], moment)
    _record_curves(logger, path, states)


def _counted(frames: Iterable[Sequence[RGBDFrame]], count: int) -> Iterator[tuple[int, Sequence[RGBDFrame]]]:
    """The sets of frames under their number; refuses more or fewer than `count`."""
    number = 0
    for step in frames:
        if number < count:
            yield number, step
        number += 1
    if number != count:
        raise InputError(f"Expected a set of frames for each of the {count} times of the path, got {number}.")


def _due(time: Float[np.ndarray, "time"], rate: float) -> Bool[np.ndarray, "time"]:
    """The first time, and those at which another period of the rate has passed since it."""
    if not rate > 0:
        raise InputError(f"Expected rates above zero, got {rate}. Give sets a second.")
    period = np.floor((time - time[0]) * rate + 1e-6)  # a time may fall short of a period by round-off
    return np.diff(period, prepend=-1.0) > 0


def _record_hands(
    logger: AbstractRunLogger, truth: Float[np.ndarray, "hands 3"], state: HandState | None, moment: Moment
) -> None:
    for place, hand in enumerate(HANDS):
        logger.points(f"hands/{hand}/true", truth[place, None], radius=3.0, color=TRUTH, at=moment)
        if state is None:
            continue
        color = _COLORS[hand] if state.seen[place] else _UNSEEN
        at, covariance = state.position[place, None], state.covariance[place, None]
        label = hand if state.seen[place] else f"{hand}, not seen"
        logger.points(f"hands/{hand}/tracked", at, radius=5.0, color=color, at=moment)
        logger.ellipsoids(f"hands/{hand}/ellipsoid", at, covariance, color=color, labels=[label], at=moment)


def _record_curves(logger: AbstractRunLogger, path: HandPath, states: Sequence[HandState | None]) -> None:
    known = [place for place, state in enumerate(states) if state is not None]
    if not known:
        return
    position, covariance, seen = (
        np.stack([getattr(state, name) for state in states if state is not None])
        for name in ("position", "covariance", "seen")
    )
    curves = {
        "errors": 1000.0 * np.linalg.norm(position - path.position[known], axis=-1),
        "spread": 1000.0 * np.sqrt(np.trace(covariance, axis1=-2, axis2=-1) / 3.0),
        "seen": seen.astype(float),
    }
    for entity, values in curves.items():
        for place, hand in enumerate(HANDS):
            logger.series(
                f"{entity}/{hand}",
                path.time[known],
                values[:, place, None],
                [hand],
                samples_seen=np.array(known) + 1,
                color=_COLORS[hand],
                width=3.0 - 1.5 * place,  # so that both are seen where one lies on the other
            )


def _report(path: HandPath, states: Sequence[HandState | None], title: str) -> str:
    scores = tracking_scores(states, path.position).metrics()
    rows = "\n".join(f"| {name} | {value:.3g} |" for name, value in scores.items())
    length = f"{len(path.time)} frames, {path.time[-1] - path.time[0]:.2f} s."
    return f"# {title}\n\n{length}\n\n| score | value |\n|---|---|\n{rows}\n\n{_LEGEND}"

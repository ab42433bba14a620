"""Recording many demonstrations over several processes; the slow part, following the gloves, is kept in files."""

from __future__ import annotations

import hashlib
from collections.abc import Sequence
from concurrent.futures import ProcessPoolExecutor
from functools import partial
from multiprocessing import get_context
from pathlib import Path

import numpy as np

from eaip_prob.data.archive import read_arrays, write_arrays
from eaip_prob.perception.hands import HandState
from eaip_prob.tasks.bag_covering.cases import Case
from eaip_prob.tasks.bag_covering.demonstrating import looked_at, recorded_as, watched
from eaip_prob.tasks.bag_covering.perceiving import AbstractPerception
from eaip_prob.tasks.bag_covering.recorded import RecordedCovering
from eaip_prob.tasks.bag_covering.running import one_thread, result_key

_HANDS = ("time", "position", "covariance", "seen")


def recorded(
    cases: Sequence[Case],
    perception: AbstractPerception,
    rate: float,
    folder: Path,
    context: str,
    num_processes: int = 2,
) -> list[RecordedCovering]:
    """Demonstrations of all cases, in their order.

    Args:
        cases: trials.
        perception: of hands and objects.
        rate: frames a second of the hands.
        folder: in which tracked hands are kept, a file for each case.
        context: everything beside the case that they follow from.
        num_processes: run beside each other.
    """
    from tqdm import tqdm

    paths = [Path(folder) / f"hands-{result_key(context, _words(case))}.npz" for case in cases]
    work = partial(_one, perception=perception, rate=rate)
    with ProcessPoolExecutor(num_processes, mp_context=get_context("spawn"), initializer=one_thread) as pool:
        return list(tqdm(pool.map(work, cases, paths), "demonstrations", len(cases), disable=None))


def _words(case: Case) -> str:
    """The case with its motion, so that hands of another motion are not taken for its own."""
    motion = case.motion
    digest = hashlib.sha256(motion.hands.tobytes() + motion.gripper.tobytes() + case.site.mesh.vertices.tobytes())
    return f"{case.name} {case.seed} {digest.hexdigest()}"


def _one(case: Case, path: Path, perception: AbstractPerception, rate: float) -> RecordedCovering:
    if not path.is_file():
        hands = watched(case, perception, rate)
        write_arrays(path, {name: np.array([getattr(hand, name) for hand in hands]) for name in _HANDS})
    rows = zip(*(read_arrays(path)[name] for name in _HANDS), strict=True)
    hands = [HandState(float(time), *rest) for time, *rest in rows]
    return recorded_as(case, perception, hands, looked_at(case, perception))


def quality(cases: Sequence[Case], recorded: Sequence[RecordedCovering]) -> dict[str, float]:
    """Errors of the hands (m) and shares of them seen, labels that are right, errors of the object's place (m).

    Args:
        cases: trials.
        recorded: in the same order.
    """
    errors, seen, right, places = [], [], [], []
    for case, one in zip(cases, recorded, strict=True):
        for hand in one.hands:
            truth = case.motion.hands[np.abs(case.motion.time - hand.time).argmin()]
            errors.append(np.linalg.norm(hand.position - truth, axis=-1)[hand.seen])
            seen.append(hand.seen)
        right.append(one.detections.labels[:1] == (case.site.label,))
        if one.detections.place is not None and len(one.detections):
            places.append(one.detections.place[0] - case.site.place)
    error, place = np.concatenate(errors), np.array(places).reshape(-1, 6)
    metrics = {"hands/median": float(np.median(error)), "hands/95": float(np.quantile(error, 0.95))}
    metrics |= {"hands/seen": float(np.mean(seen)), "objects/right": float(np.mean(right))}
    names = ("x", "y", "z", "length_x", "length_y", "length_z")
    spread = np.sqrt(np.nanmean(place**2, 0)) if len(place) else np.full(6, np.nan)
    return metrics | {f"place/{name}": float(value) for name, value in zip(names, spread, strict=True)}

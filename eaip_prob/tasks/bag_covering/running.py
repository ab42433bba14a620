"""Many runs over several processes, each kept in a file, so that an interrupted study goes on where it stopped."""

from __future__ import annotations

import hashlib
import json
import pickle
import warnings
from collections.abc import Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from dataclasses import dataclass, field
from multiprocessing import get_context
from pathlib import Path
from typing import Any

import numpy as np

from eaip_prob.data.archive import read_arrays, write_arrays
from eaip_prob.detection import AbstractEnvironmentEncoder, Detections
from eaip_prob.errors import ExtrapolationWarning
from eaip_prob.execution import Execution, PartnerWatch, SafetyRules
from eaip_prob.methods import PUBLISHED
from eaip_prob.perception.hands import HandState
from eaip_prob.robot import baxter_left_arm
from eaip_prob.tasks.bag_covering.cases import Case
from eaip_prob.tasks.bag_covering.faults import Faults
from eaip_prob.tasks.bag_covering.judging import Judge
from eaip_prob.tasks.bag_covering.looking import best_look
from eaip_prob.tasks.bag_covering.loop import CoveringLoop
from eaip_prob.tasks.bag_covering.outcome import Run, ended
from eaip_prob.tasks.bag_covering.perceiving import AbstractPerception
from eaip_prob.tasks.bag_covering.study import Predictors
from eaip_prob.tasks.bag_covering.trial import Looks, Step, Trial

_WORDS, _NUMBERS = ("kind", "reason"), ("duration", "covered", "clearance", "ready")
_SOURCES = (".py", ".npz", ".safetensors")
_ARRAYS = ("time", "gripper", "near", "deviation")


@dataclass(frozen=True, eq=False)
class Setting:
    """What all runs of a study share.

    Args:
        predictors: fitted.
        perception: of the robot.
        encoder: of the detections for this package's predictor.
        paper_encoder: for the published one.
        looks: when cameras look.
        rules: what a plan must keep.
        watch: of the partner.
        execution: of plans.
    """

    predictors: Predictors
    perception: AbstractPerception
    encoder: AbstractEnvironmentEncoder
    paper_encoder: AbstractEnvironmentEncoder
    looks: Looks = field(default_factory=Looks)
    rules: SafetyRules = field(default_factory=lambda: SafetyRules(margin=0.03))
    watch: PartnerWatch = field(default_factory=lambda: PartnerWatch(pause=6.0, back=0.25))
    execution: Execution = field(default_factory=Execution)

    def loop(self, method: str) -> CoveringLoop:
        """The loop with one method in it.

        Args:
            method: its name.
        """
        encoder = self.paper_encoder if method in PUBLISHED else self.encoder
        predictor = self.predictors.of(method)
        return CoveringLoop(predictor, method, encoder, baxter_left_arm(), self.execution, self.rules, self.watch)


@dataclass(frozen=True, eq=False)
class Job:
    """One run.

    Args:
        case: the trial.
        method: in the loop.
        setting: shared with the others.
        faults: what goes wrong.
        name: of the trial and the method.
        condition: that the trial is run under.
    """

    case: Case
    method: str
    setting: Setting
    faults: Faults = field(default_factory=Faults)
    name: str = ""
    condition: str = "none"

    def steps(self) -> Iterator[Step]:
        """What happens, as of `Trial.steps`."""
        setting, case = self.setting, self.case
        trial = Trial(case.site, case.motion, setting.perception, case.seed, setting.looks, self.faults)
        return trial.steps(setting.loop(self.method))


@dataclass(frozen=True, eq=False)
class Result:
    """What came of a job.

    Args:
        run: its outcome.
        hands: of the partner as tracked.
        detections: of the best look in the first second.
    """

    run: Run
    hands: tuple[HandState, ...]
    detections: Detections


def performed(job: Job) -> Result:
    """One run, from the first frame to its outcome.

    Args:
        job: what is run.
    """
    hands: list[HandState] = []
    found: list[Detections] = []

    def watched() -> Iterator[Step]:
        for step in job.steps():
            if step.sighting is not None:
                if step.sighting.hands is not None:
                    hands.append(step.sighting.hands)
                if step.sighting.detections is not None:
                    found.append(step.sighting.detections)
            yield step

    # Objects that nobody demonstrated are what is studied.
    with warnings.catch_warnings(action="ignore", category=ExtrapolationWarning):
        run = ended(watched(), Judge(job.case.site, baxter_left_arm()))
    return Result(run, tuple(hands), best_look(found))


def all_performed(
    jobs: Sequence[Job], folder: Path, context: str, num_processes: int = 2
) -> Iterator[tuple[Job, Result]]:
    """Results of all jobs, as they come; those that the folder has are read.

    Args:
        jobs: with names of their own.
        folder: of the results, a file each.
        context: everything beside the name that a result follows from.
        num_processes: run beside each other; 1 runs them here.
    """
    paths = {id(job): Path(folder) / f"run-{result_key(context, f'{job.condition}: {job.name}')}.npz" for job in jobs}
    left = []
    for job in jobs:
        if paths[id(job)].is_file():
            yield job, read_result(paths[id(job)])
        else:
            left.append(job)
    if num_processes == 1:
        for job in left:
            yield job, _kept(performed(job), paths[id(job)])
        return
    with ProcessPoolExecutor(num_processes, mp_context=get_context("spawn"), initializer=one_thread) as pool:
        waiting = {pool.submit(_performed_there, pickle.dumps(job)): job for job in left}
        try:
            for future in as_completed(waiting):
                job = waiting[future]
                yield job, _kept(future.result(), paths[id(job)])
        finally:
            pool.shutdown(wait=False, cancel_futures=True)


def _performed_there(job: bytes) -> Result:
    """The run of a job in another process.

    The job comes as bytes: handed over as it is, torch would move its tensors to shared memory, and the arrays that a
    fitted predictor keeps as views of them would be left with memory that is freed.
    """
    return performed(pickle.loads(job))


def one_thread() -> None:
    """Makes torch use one thread in this process: processes that run beside each other would else share cores."""
    import torch

    torch.set_num_threads(1)


def _kept(result: Result, path: Path) -> Result:
    write_result(path, result)
    return result


def result_key(context: str, name: str) -> str:
    """A name for the file of a result, 32 hexadecimal digits.

    Args:
        context: everything beside the name that the result follows from.
        name: of the job.
    """
    return hashlib.sha256(f"{context}\n{name}".encode()).hexdigest()[:32]


def source_digest() -> str:
    """Of the package's code, weights and demonstrations: results of others are not taken for those of these.

    Example:
        >>> len(source_digest())
        64
    """
    root = Path(__file__).resolve().parents[2]
    digest = hashlib.sha256()
    for path in sorted(path for path in root.rglob("*") if path.suffix in _SOURCES):
        digest.update(path.relative_to(root).as_posix().encode() + path.read_bytes())
    return digest.hexdigest()


def write_result(path: Path, result: Result) -> Path:
    """Keeps a result in a .npz file.

    Args:
        path: of the file.
        result: of a job.
    """
    run, found = result.run, result.detections
    words = {name: getattr(run, name) for name in (*_WORDS, *_NUMBERS)}
    words |= {"labels": list(found.labels), "image_size": list(found.image_size)}
    arrays = {name: getattr(run, name) for name in _ARRAYS}
    arrays |= {
        f"hand_{name}": np.array([getattr(hand, name) for hand in result.hands])
        for name in ("time", "position", "covariance", "seen")
    }
    for name in ("score", "box", "box_covariance", "place", "place_covariance"):
        value = getattr(found, name)
        if value is not None:
            arrays[f"found_{name}"] = value
    arrays["words"] = np.frombuffer(json.dumps(words).encode(), np.uint8)
    return write_arrays(path, arrays, compressed=True)


def read_result(path: Path) -> Result:
    """A result from a file of `write_result`.

    Args:
        path: of the file.

    Raises:
        DataFileError: damaged.
    """
    arrays = read_arrays(path)
    words = json.loads(arrays["words"].tobytes())
    known: dict[str, Any] = {name: words[name] for name in (*_WORDS, *_NUMBERS)}
    known |= {name: arrays[name] for name in _ARRAYS}
    run = Run(**known)
    rows = zip(*(arrays[f"hand_{name}"] for name in ("time", "position", "covariance", "seen")), strict=True)
    hands = tuple(HandState(float(time), *rest) for time, *rest in rows)
    found = {name.removeprefix("found_"): arrays[name] for name in arrays if name.startswith("found_")}
    return Result(run, hands, Detections(tuple(words["labels"]), image_size=tuple(words["image_size"]), **found))

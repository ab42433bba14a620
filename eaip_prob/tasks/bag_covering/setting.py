"""From a configuration to what a study of the task needs: room, demonstrations, fitted predictors, jobs."""

from __future__ import annotations

import hashlib
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from eaip_prob.config import build, repository_path
from eaip_prob.methods import EAIP
from eaip_prob.perception.hands import hands_to_trajectory
from eaip_prob.simulation import AbstractObject
from eaip_prob.tasks.bag_covering.cases import Case, Room
from eaip_prob.tasks.bag_covering.demonstrating import seen_by
from eaip_prob.tasks.bag_covering.perceiving import OraclePerception
from eaip_prob.tasks.bag_covering.recorded import RecordedCovering, demonstration_set, load_recorded, shipped
from eaip_prob.tasks.bag_covering.running import Job, Result, Setting, source_digest
from eaip_prob.tasks.bag_covering.study import Predictors, Seen
from eaip_prob.tasks.bag_covering.trial import Looks

_MATTERS = (
    "predictor", "paper", "encoder", "paper_encoder", "perception", "detector", "looks", "rate", "cue", "seed",
    "training", "novel", "classes", "workspace", "rig", "camera", "detector_camera",
)  # fmt: skip

_TRACKED = ("rate", "training", "workspace", "rig", "camera")


def room(cfg: Any) -> Room:
    """The objects of the configuration, in its workspace.

    Args:
        cfg: with `training`, `novel`, `classes` and `workspace`.
    """
    return Room(things(cfg.training) | things(cfg.novel), dict(cfg.classes), build(cfg.workspace))


def things(group: Any) -> dict[str, AbstractObject]:
    """The objects of a group of the configuration.

    Args:
        group: name -> object.
    """
    return {name: build(thing) for name, thing in group.get("object", group).items()}


def ideal(cfg: Any) -> OraclePerception:
    """The ideal perception, also where the experiment's own sees through cameras.

    Args:
        cfg: with `ideal`.
    """
    return build(cfg.ideal)


def demonstrations(cfg: Any) -> list[RecordedCovering]:
    """The recorded demonstrations as the configured perception would have seen their objects.

    Args:
        cfg: with `demonstrations`, a file or null for those of the package, and `perception`.
    """
    recorded = shipped() if cfg.demonstrations is None else load_recorded(repository_path(cfg.demonstrations))
    return seen_by(recorded, build(cfg.perception))


def fitted(cfg: Any, recorded: Sequence[RecordedCovering]) -> Setting:
    """Both predictors fitted to the demonstrations, and what the loop needs beside them.

    Args:
        cfg: with `predictor`, `paper`, the encoders and `perception`.
        recorded: demonstrations.
    """
    encoder, paper_encoder = build(cfg.encoder), build(cfg.paper_encoder)
    predictors = Predictors(
        build(cfg.predictor).fit(demonstration_set(recorded, encoder)),
        build(cfg.paper).fit(demonstration_set(recorded, paper_encoder)),
    )
    return Setting(predictors, build(cfg.perception), encoder, paper_encoder, Looks(**cfg.looks))


def jobs(cases: Sequence[Case], methods: Sequence[str], shared: Setting) -> list[Job]:
    """One run of each method on each case.

    Args:
        cases: trials.
        methods: names.
        shared: what all runs share.
    """
    return [Job(case, method, shared, name=f"{method}: {case.name}") for case in cases for method in methods]


def context(cfg: Any) -> str:
    """What results follow from beside a job's name: the configuration, the demonstrations and the code.

    Args:
        cfg: of the experiment.
    """
    file = cfg.get("demonstrations")
    data = b"" if file is None else Path(repository_path(file)).read_bytes()
    return "\n".join([_words(cfg, _MATTERS), hashlib.sha256(data).hexdigest(), source_digest()])


def tracking_context(cfg: Any) -> str:
    """What tracked hands follow from beside a case and its motion; not the detector.

    Args:
        cfg: of the experiment.
    """
    return _words(cfg, _TRACKED) + _words(cfg.perception, ("noise", "tracker", "lost"))


def _words(cfg: Any, names: Sequence[str]) -> str:
    from omegaconf import OmegaConf

    known = {name: OmegaConf.to_container(cfg, resolve=True)[name] for name in names if name in cfg}  # pyright: ignore
    return OmegaConf.to_yaml(OmegaConf.create(known))


def seen(results: Mapping[Job, Result], shared: Setting) -> list[Seen]:
    """Each case as the run of one method perceived it.

    Args:
        results: of all jobs.
        shared: with the encoders.
    """
    methods = list(dict.fromkeys(job.method for job in results))
    watching = EAIP if EAIP in methods else methods[0]
    return [
        Seen(
            job.case,
            hands_to_trajectory(result.hands, correlated=False),
            {
                "ours": shared.encoder.encode(result.detections),
                "paper": shared.paper_encoder.encode(result.detections),
            },
        )
        for job, result in results.items()
        if job.method == watching
    ]

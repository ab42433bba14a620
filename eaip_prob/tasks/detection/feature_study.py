"""What detecting does to the features of the environment, and what that does to a prediction."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from eaip_prob.detection.encoder import AbstractEnvironmentEncoder
from eaip_prob.detection.encoders_noise import feature_errors
from eaip_prob.simulation.oracle import LabelledFrame, OracleDetector
from eaip_prob.tasks.detection.consequence import Lift, consequence
from eaip_prob.tasks.detection.study import Sighting


def feature_study(
    encoder: AbstractEnvironmentEncoder,
    frames: Mapping[str, Sequence[Sequence[LabelledFrame]]],
    sightings: Mapping[str, Sequence[Sequence[Sighting]]],
    training: Sequence[str],
    seed: int,
) -> tuple[list[dict[str, Any]], list[dict[str, Any]], dict[str, Any]]:
    """Errors of features over the first half of the task as rows to print, those of predictions, and all as metrics.

    Predictions are learnt from one motion over each placement of the training objects, with features as detected in the
    first frame, and asked for the other objects.

    Args:
        encoder: of features; nothing is studied if it has none.
        frames: object -> trials -> frames.
        sightings: of the same frames.
        training: names of the objects of the demonstrations.
        seed: of the motions.

    Example:
        >>> from eaip_prob.detection.encoders import NoEncoder
        >>> feature_study(NoEncoder(), {}, {}, [], seed=0)
        ([], [], {})
    """
    if not encoder.names:
        return [], [], {}
    oracle = OracleDetector(camera=next(iter(frames.values()))[0][0].name)
    pairs = [
        (said.detections, oracle.detect([frame]))
        for name in frames
        for shown, trial in zip(frames[name], sightings[name], strict=True)
        for frame, said in zip(shown, trial, strict=True)
        if said.share < 0.5
    ]
    errors = feature_errors(encoder, [detected for detected, _ in pairs], [true for _, true in pairs])
    rows = [
        {"feature": name, "bias": errors.bias[i], "std": errors.std[i], "predicted std": errors.predicted[i]}
        for i, name in enumerate(errors.names)
    ]
    metrics: dict[str, Any] = {
        "features_std": dict(zip(errors.names, errors.std.tolist(), strict=True)),
        "features_missed": errors.num_missed / len(pairs),
    }
    lifts = {name: _lifts(encoder, frames[name], sightings[name], oracle) for name in frames}
    learnt = [lift for name in training for lift in lifts[name]]
    test = [lift for name in lifts if name not in training for lift in lifts[name]]
    metrics["prediction"] = consequence(learnt, test, seed) if learnt and test else {}
    return rows, [{"features": name, **scores} for name, scores in metrics["prediction"].items()], metrics


def _lifts(
    encoder: AbstractEnvironmentEncoder,
    frames: Sequence[Sequence[LabelledFrame]],
    sightings: Sequence[Sequence[Sighting]],
    oracle: OracleDetector,
) -> list[Lift]:
    firsts = [(shown[0], trial[0]) for shown, trial in zip(frames, sightings, strict=True)]
    return [
        Lift(frame.objects[0].place, encoder.encode(oracle.detect([frame])), encoder.encode(said.detections))
        for frame, said in firsts
    ]

"""Recorded demonstrations: hands as tracked, the left gripper as led, the object as detected and as it was.

The set that ships with the package, `demonstrations.npz` beside this file, was recorded from pixels by
`experiments/record_covering.py`. What was detected is kept as such, so that every encoder can be asked about it.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from importlib.resources import files
from pathlib import Path

import numpy as np
from jaxtyping import Float

from eaip_prob.data import Demonstration, DemonstrationSet
from eaip_prob.data.archive import check_arrays, check_offsets, read_arrays, write_arrays
from eaip_prob.detection import CLASSES, AbstractEnvironmentEncoder, Detections
from eaip_prob.errors import DataFileError, InputError
from eaip_prob.perception.hands import HandState, hands_to_trajectory
from eaip_prob.simulation.oracle import TrueObject
from eaip_prob.tasks.bag_covering.seeing import led

SHIPPED = "demonstrations.npz"
_HANDS = ("position", "covariance", "seen")
_FORMAT = "eaip_prob covering demonstrations 1"
_KINDS = {
    "format": ("U", 1), "object": ("U", 1), "partner": ("U", 1), "image_size": ("iu", 1), "detected": ("b", 1),
    "true_label": ("U", 1), "true_box": ("f", 2), "true_place": ("f", 2),
    "label": ("U", 1), "score": ("f", 1), "box": ("f", 2), "box_covariance": ("f", 3),
    "place": ("f", 2), "place_covariance": ("f", 3),
    "hand_offsets": ("iu", 1), "hand_time": ("f", 1), "hand_position": ("f", 3), "hand_covariance": ("f", 4),
    "hand_seen": ("b", 2), "gripper_offsets": ("iu", 1), "gripper_time": ("f", 1), "gripper": ("f", 2),
}  # fmt: skip


@dataclass(frozen=True, eq=False)
class RecordedCovering:
    """One demonstration as recorded.

    Args:
        thing: name of the object.
        partner: name of the person's record.
        hands: as tracked.
        time: (T,), of the gripper, s.
        gripper: (T, 3), of the robot's left arm, as led, m.
        detections: of the object; of no object where none was found.
        truth: of the object.
    """

    thing: str
    partner: str
    hands: tuple[HandState, ...]
    time: Float[np.ndarray, "time"]
    gripper: Float[np.ndarray, "time 3"]
    detections: Detections
    truth: TrueObject

    def demonstration(self, encoder: AbstractEnvironmentEncoder) -> Demonstration:
        """Hands, gripper and the features of the detected object.

        Args:
            encoder: of the detections.
        """
        return Demonstration(
            hands_to_trajectory(self.hands, correlated=False),
            led(self.time, self.gripper),
            encoder.encode(self.detections),
        )


def demonstration_set(recorded: Sequence[RecordedCovering], encoder: AbstractEnvironmentEncoder) -> DemonstrationSet:
    """What a predictor is fitted to; held-out choices leave whole partners out.

    Args:
        recorded: at least one.
        encoder: of the detections.

    Example:
        >>> from eaip_prob.detection import MetricBoxEncoder
        >>> len(demonstration_set(shipped(), MetricBoxEncoder()))
        40
    """
    return DemonstrationSet([one.demonstration(encoder) for one in recorded], [one.partner for one in recorded])


def shipped() -> tuple[RecordedCovering, ...]:
    """The set that ships with the package: ten demonstrations of each of the four training objects.

    Example:
        >>> sorted({one.thing for one in shipped()})
        ['brown_bookshelf', 'folding_table', 'office_chair', 'stepladder']
    """
    return load_recorded(Path(str(files("eaip_prob.tasks.bag_covering") / SHIPPED)))


def save_recorded(path: str | Path, recorded: Sequence[RecordedCovering]) -> Path:
    """Writes demonstrations to a .npz file, whole or not at all.

    Args:
        path: of the file.
        recorded: at least one, with images of one size.

    Raises:
        InputError: no demonstration.
    """
    if not recorded:
        raise InputError("Expected at least one demonstration to save, got none.")
    arrays: dict[str, np.ndarray] = {
        "format": np.array([_FORMAT]),
        "object": np.array([one.thing for one in recorded]),
        "partner": np.array([one.partner for one in recorded]),
        "image_size": np.array(recorded[0].detections.image_size),
        "true_label": np.array([one.truth.label for one in recorded]),
        "true_box": np.array([one.truth.box for one in recorded]),
        "true_place": np.array([one.truth.place for one in recorded]),
        "gripper_offsets": np.cumsum([0] + [len(one.time) for one in recorded]),
        "gripper_time": np.concatenate([one.time for one in recorded]),
        "gripper": np.concatenate([one.gripper for one in recorded]),
        "hand_offsets": np.cumsum([0] + [len(one.hands) for one in recorded]),
    }
    hands = [hand for one in recorded for hand in one.hands]
    arrays["hand_time"] = np.array([hand.time for hand in hands])
    arrays |= {f"hand_{name}": np.stack([getattr(hand, name) for hand in hands]) for name in _HANDS}
    return write_arrays(Path(path), {**arrays, **_found(recorded)}, compressed=True)


def _found(recorded: Sequence[RecordedCovering]) -> dict[str, np.ndarray]:
    """The most certain detection of each, with NaN for what the detector did not say."""
    rows: dict[str, list[np.ndarray]] = {"box": [], "box_covariance": [], "place": [], "place_covariance": []}
    shapes = {"box": (4,), "box_covariance": (4, 4), "place": (6,), "place_covariance": (6, 6)}
    for one in recorded:
        for name, rest in shapes.items():
            value = getattr(one.detections, name)
            rows[name].append(value[0] if value is not None and len(value) else np.full(rest, np.nan))
    found = [len(one.detections) > 0 for one in recorded]
    return {
        "detected": np.array(found),
        "label": np.array(
            [one.detections.labels[0] if is_found else "" for one, is_found in zip(recorded, found, strict=True)]
        ),
        "score": np.array(
            [one.detections.score[0] if is_found else 0.0 for one, is_found in zip(recorded, found, strict=True)]
        ),
        **{name: np.stack(row) for name, row in rows.items()},
    }


def load_recorded(path: str | Path) -> tuple[RecordedCovering, ...]:
    """Demonstrations from a file of `save_recorded`; nothing is unpickled.

    Args:
        path: of the file.

    Raises:
        DataFileError: not such a file, or damaged.
    """
    path = Path(path)
    if not path.is_file():
        raise DataFileError(
            f"Expected demonstrations at {path}, got no such file. Record them with record_covering.py."
        )
    arrays = read_arrays(path)
    check_arrays(path, arrays, _KINDS)
    if arrays["format"].tolist() != [_FORMAT]:
        raise DataFileError(f"Expected the format {_FORMAT!r} in {path}, got {arrays['format'].tolist()}.")
    count = len(arrays["object"])
    check_offsets("hands", arrays["hand_offsets"], count, len(arrays["hand_time"]))
    check_offsets("gripper", arrays["gripper_offsets"], count, len(arrays["gripper"]))
    if not set(arrays["true_label"].tolist()) <= set(CLASSES):
        raise DataFileError(
            f"Expected classes of {CLASSES} in {path}, got {sorted(set(arrays['true_label'].tolist()))}."
        )
    return tuple(_one(arrays, i) for i in range(count))


def _one(arrays: dict[str, np.ndarray], i: int) -> RecordedCovering:
    first, last = arrays["hand_offsets"][i : i + 2]
    hands = tuple(
        HandState(float(arrays["hand_time"][k]), *(arrays[f"hand_{name}"][k] for name in _HANDS))
        for k in range(first, last)
    )
    steps = slice(*arrays["gripper_offsets"][i : i + 2])
    truth = TrueObject(str(arrays["true_label"][i]), arrays["true_box"][i], 0.0, arrays["true_place"][i])
    return RecordedCovering(
        str(arrays["object"][i]),
        str(arrays["partner"][i]),
        hands,
        arrays["gripper_time"][steps],
        arrays["gripper"][steps],
        _detections(arrays, i),
        truth,
    )


def _detections(arrays: dict[str, np.ndarray], i: int) -> Detections:
    width, height = arrays["image_size"].tolist()
    if not arrays["detected"][i]:
        return Detections.none((width, height))
    known = {name: arrays[name][i][None] for name in ("box_covariance", "place", "place_covariance")}
    if np.isnan(known["box_covariance"]).any():
        known.pop("box_covariance")
    return Detections(
        (str(arrays["label"][i]),), arrays["score"][i : i + 1], arrays["box"][i][None], (width, height), **known
    )

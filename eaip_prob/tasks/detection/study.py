"""How a detector fares while an object is covered: Table 1 of the paper, with boxes and what is confused beside it."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from eaip_prob.detection.base import AbstractObjectDetector, Detections
from eaip_prob.detection.boxes import box_iou
from eaip_prob.detection.encoder import ObjectChoice
from eaip_prob.errors import InputError
from eaip_prob.simulation.oracle import LabelledFrame

NOTHING = "nothing"
COVERED = (0.0, 0.2, 0.5, 0.8)  # shares of an object that are hidden, where the bands of `by_cover` begin
PAPER: Mapping[str, tuple[int, int]] = {  # frames that were right, and all, over 0 to 100 % of the task (Table 1)
    "stepladder": (293, 371),
    "folding_table": (337, 388),
    "office_chair": (258, 267),
    "brown_bookshelf": (211, 261),
    "yellow_bookshelf": (335, 386),
    "end_table": (382, 448),
    "chair_4_legged": (309, 370),
    "table_4_legged": (220, 274),
}


@dataclass(frozen=True, eq=False)
class Sighting:
    """What a detector said of one frame.

    Args:
        share: how much of the task has passed, 0 to 1.
        covered: share of the object's pixels that something hides.
        label: class of the object.
        found: class that was answered, `NOTHING` where none was.
        iou: of the box that was answered with the true one; 0 where none was.
        detections: all that was answered.

    Example:
        >>> Sighting(0.1, 0.0, "chair", "table", 0.8, Detections.none((9, 9))).right
        False
    """

    share: float
    covered: float
    label: str
    found: str
    iou: float
    detections: Detections

    @property
    def right(self) -> bool:
        """Whether the class is."""
        return self.found == self.label


def sighting(detector: AbstractObjectDetector, frame: LabelledFrame, choice: ObjectChoice | None = None) -> Sighting:
    """What a detector says of a frame with one object.

    Args:
        detector: of objects.
        frame: with its labels; its time is the share of the task.
        choice: which object counts, where several are found; default the most certain.

    Raises:
        InputError: another number of objects in the frame.

    Example:
        >>> from eaip_prob.data.frames import Intrinsics
        >>> from eaip_prob.simulation.oracle import OracleDetector, TrueObject
        >>> camera, depth = Intrinsics(4, 3, 4.0, 4.0, 1.5, 1.0), np.ones((3, 4), np.float32)
        >>> shelf = TrueObject("bookshelf", np.array([2.0, 1.0, 2.0, 2.0]), 0.0, np.array([1, 0, 0, 0.6, 0.3, 0.9]))
        >>> frame = LabelledFrame(
        ...     np.zeros((3, 4, 3), np.uint8), depth, depth > 0, camera, np.eye(4), 0.0, name="right", objects=(shelf,)
        ... )
        >>> sighting(OracleDetector(), frame).iou
        1.0
    """
    if len(frame.objects) != 1:
        raise InputError(f"Expected a frame with one labelled object, got {len(frame.objects)}.")
    (true,) = frame.objects
    detections = detector.detect([frame])
    index = (choice or ObjectChoice()).choose(detections)
    if index is None:
        return Sighting(frame.time, true.covered, true.label, NOTHING, 0.0, detections)
    iou = float(box_iou(detections.box[index], true.box))
    return Sighting(frame.time, true.covered, true.label, detections.labels[index], iou, detections)


@dataclass(frozen=True)
class ObjectScores:
    """What frames of one object say of a detector.

    Args:
        first_half: share of the frames in the first half of the task whose class is right.
        whole: the same over the whole task.
        num_first_half: frames in the first half.
        num_whole: all frames.
        covered: mean share of the object that is hidden, over the whole task.
        iou: mean over the first half, 0 for frames in which nothing is found.
        confused: class that was answered instead -> frames, over the whole task.

    Example:
        >>> ObjectScores.of([Sighting(0.2, 0.1, "chair", "chair", 0.8, Detections.none((9, 9)))]).iou
        0.8
    """

    first_half: float
    whole: float
    num_first_half: int
    num_whole: int
    covered: float
    iou: float
    confused: Mapping[str, int]

    @classmethod
    def of(cls, sightings: Sequence[Sighting]) -> ObjectScores:
        """Scores of all frames of one object.

        Args:
            sightings: of all its trials, at least one in the first half of the task.

        Raises:
            InputError: none in the first half.
        """
        early = [one for one in sightings if one.share < 0.5]
        if not early:
            raise InputError(f"Expected frames in the first half of the task, got none of {len(sightings)}.")
        return cls(
            first_half=float(np.mean([one.right for one in early])),
            whole=float(np.mean([one.right for one in sightings])),
            num_first_half=len(early),
            num_whole=len(sightings),
            covered=float(np.mean([one.covered for one in sightings])),
            iou=float(np.mean([one.iou for one in early])),
            confused=dict(Counter(one.found for one in sightings if not one.right)),
        )


def table_1(scores: Mapping[str, ObjectScores]) -> list[dict[str, object]]:
    """Rows of Table 1, with the paper's figure over the whole task where it has one.

    Args:
        scores: of each object.

    Example:
        >>> table_1({})
        []
    """
    rows = []
    for name, score in scores.items():
        right, total = PAPER.get(name, (0, 0))
        rows.append(
            {
                "object": name,
                "first half": score.first_half,
                "frames": score.num_first_half,
                "whole": score.whole,
                "all frames": score.num_whole,
                "paper, whole": right / total if total else None,
                "covered": score.covered,
                "IoU, first half": score.iou,
                "instead": ", ".join(f"{found} {count}" for found, count in score.confused.items()) or None,
            }
        )
    return rows


def by_cover(sightings: Sequence[Sighting]) -> list[dict[str, float]]:
    """Share of frames whose class is right, and mean IoU, by how much of the object something hides.

    Args:
        sightings: of any objects.

    Returns:
        A row for each band of `COVERED` that has frames.

    Example:
        >>> by_cover([Sighting(0.2, 0.3, "chair", "chair", 0.8, Detections.none((9, 9)))])[0]["covered from"]
        0.2
    """
    band = np.digitize([one.covered for one in sightings], COVERED) - 1
    rows = []
    for number, start in enumerate(COVERED):
        here = [one for one, its in zip(sightings, band, strict=True) if its == number]
        if here:
            right, iou = np.mean([[one.right, one.iou] for one in here], axis=0)
            rows.append({"covered from": start, "frames": len(here), "right": float(right), "IoU": float(iou)})
    return rows

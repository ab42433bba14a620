"""How good a detector is on labelled images: classes, overlap, and how far its boxes are off."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float, Int

from eaip_prob.detection.base import CLASSES, AbstractImageDetector
from eaip_prob.detection.boxes import box_iou
from eaip_prob.detection.labelled import LabelledImages

_PLACED = 0.5  # IoU from which a box counts as that of the object


@dataclass(frozen=True, eq=False)
class Judgement:
    """What a detector said of N images with one object each; of several detections the most certain counts.

    Args:
        truth: (N,), index of the true class in `CLASSES`.
        said: (N,), index of the class that was said, -1 where nothing was found or the class is not among them.
        iou: (N,), of the box; 0 where nothing was found.
        score: (N,); 0 where nothing was found.
        error: (N, 4), of centre column, centre row, width and height, as shares of the true box's width, height,
            width and height; NaN where nothing was found.

    Example:
        >>> iou, score = np.array([0.9, 0.0]), np.array([0.8, 0.0])
        >>> one = Judgement(np.array([0, 2]), np.array([0, -1]), iou, score, np.ones((2, 4)))
        >>> one.accuracy(), one.accuracy("table")
        (0.5, 0.0)
    """

    truth: Int[np.ndarray, "images"]
    said: Int[np.ndarray, "images"]
    iou: Float[np.ndarray, "images"]
    score: Float[np.ndarray, "images"]
    error: Float[np.ndarray, "images 4"]

    @property
    def right(self) -> Bool[np.ndarray, "images"]:
        """Where the class is right and the box is that of the object."""
        return (self.said == self.truth) & (self.iou > _PLACED)

    def accuracy(self, name: str | None = None) -> float:
        """Share of images whose class is said rightly.

        Args:
            name: of the class whose images count; all if None.
        """
        return float((self.said == self.truth)[self._of(name)].mean())

    def mean_iou(self, name: str | None = None) -> float:
        """Mean IoU, that of images without a detection taken as 0.

        Args:
            name: as of `accuracy`.
        """
        return float(self.iou[self._of(name)].mean())

    def metrics(self) -> dict[str, float]:
        """Accuracy and IoU over all images and of each class."""
        present = [name for name in CLASSES if self._of(name).any()]
        rows = {f"{name}/{label}": getattr(self, name)(label) for name in ("accuracy", "mean_iou") for label in present}
        return {"accuracy/all": self.accuracy(), "mean_iou/all": self.mean_iou(), **rows}

    def _of(self, name: str | None) -> np.ndarray:
        return np.ones(len(self.truth), bool) if name is None else self.truth == CLASSES.index(name)


def judged(detector: AbstractImageDetector, images: LabelledImages) -> Judgement:
    """What a detector says of labelled images.

    Args:
        detector: of any kind.
        images: with one object each.

    Example:
        >>> from eaip_prob.detection.yolo.detector import YoloDetector
        >>> box, nowhere = np.array([[80.0, 40.0, 9.0, 9.0]]), np.zeros((1, 90, 160), bool)
        >>> black = LabelledImages(np.zeros((1, 90, 160, 3), np.uint8), box, np.array([0]), nowhere)
        >>> judged(YoloDetector(), black).accuracy()
        0.0
    """
    number = len(images)
    said, iou, score, error = np.full(number, -1), np.zeros(number), np.zeros(number), np.full((number, 4), np.nan)
    for index in range(number):
        found = detector.detect_image(images.image[index])
        if len(found):
            box, truth = found.box[0], images.box[index]
            said[index] = CLASSES.index(found.labels[0]) if found.labels[0] in CLASSES else -1
            iou[index] = float(box_iou(box, truth))
            score[index], error[index] = found.score[0], (box - truth) / truth[[2, 3, 2, 3]]
    return Judgement(images.label.astype(np.int64), said, iou, score, error)


def calibration(score: Float[np.ndarray, "images"], right: Bool[np.ndarray, "images"]) -> tuple[float, float]:
    """(slope, offset) of the logit of the probability to be right over that of a raw score (Platt, 1999).

    Platt's targets stand for one right and one wrong image more than there were, so that a detector that was always
    right is not said to be certain.

    Args:
        score: (N,), from 0 to 1.
        right: (N,).

    Example:
        >>> score = np.linspace(0.05, 0.95, 400)
        >>> slope, offset = calibration(score, np.random.default_rng(0).random(400) < score)
        >>> abs(slope - 1.0) < 0.3, abs(offset) < 0.3
        (True, True)
    """
    from scipy.optimize import minimize
    from scipy.special import expit, logit

    x = logit(np.clip(score, 1e-6, 1.0 - 1e-6))
    target = np.where(right, (right.sum() + 1.0) / (right.sum() + 2.0), 1.0 / ((~right).sum() + 2.0))

    def cost(parameters: np.ndarray) -> float:
        z = np.exp(parameters[0]) * x + parameters[1]  # a higher score is never worse
        return float((np.logaddexp(0.0, z) - target * z).sum())

    def slope(parameters: np.ndarray) -> np.ndarray:
        steep = np.exp(parameters[0])
        gap = expit(steep * x + parameters[1]) - target
        return np.array([(gap * steep * x).sum(), gap.sum()])

    found = minimize(cost, np.zeros(2), jac=slope, bounds=[(-4.0, 4.0), (-10.0, 10.0)]).x
    return float(np.exp(found[0])), float(found[1])

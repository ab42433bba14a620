"""What is said of the task's object: its class, its box in the image, or its box in the world.

Letters: C classes, s score, p_k probability of class k.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from eaip_prob.data.environment import EnvironmentFeatures
from eaip_prob.detection.base import BOX_NAMES, PLACE_NAMES, Detections
from eaip_prob.detection.encoder import AbstractEnvironmentEncoder, AbstractObjectEncoder, Described
from eaip_prob.errors import InputError

BOX_STD = 0.05  # share of its size; an IoU of 0.85 or so


@dataclass(frozen=True)
class PaperEncoder(AbstractObjectEncoder):
    """Number of the class, centre and size of the box in px: e of Sec. 4.2.1.

    The number is that of `choice.classes`, from 0; its variance is `label_covariance` with the numbers as codes.

    Args:
        choice: which object.
        box_std: standard deviation of the box's centre and size where the detector does not know it, share of its size.

    Raises:
        InputError: a standard deviation below zero.

    Example:
        >>> found = Detections(("stepladder",), np.array([1.0]), np.array([[480.0, 270.0, 100.0, 200.0]]), (960, 540))
        >>> PaperEncoder().encode(found).value.tolist()
        [1.0, 480.0, 270.0, 100.0, 200.0]
    """

    box_std: float = BOX_STD

    def __post_init__(self) -> None:
        _check_std(self.box_std)

    @property
    def names(self) -> tuple[str, ...]:
        """`label`, then the box's."""
        return ("label", *BOX_NAMES)

    def describe(self, one: Detections) -> Described:
        """As in `AbstractObjectEncoder`."""
        codes = np.arange(len(self.choice.classes), dtype=float)[:, None]
        return _label_and_box(one, codes, self.choice.classes.index(one.labels[0]), self.box_std)


@dataclass(frozen=True)
class OneHotEncoder(AbstractObjectEncoder):
    """One indicator for each class, 1 for that of the object and 0 for the others, and the box in px.

    Args:
        choice: which object.
        box_std: as of `PaperEncoder`.

    Raises:
        InputError: a standard deviation below zero.

    Example:
        >>> found = Detections(("table",), np.array([0.9]), np.array([[480.0, 270.0, 100.0, 200.0]]), (960, 540))
        >>> features = OneHotEncoder().encode(found)
        >>> features.names[:4], features.value[:4].tolist()
        (('is_chair', 'is_stepladder', 'is_table', 'is_bookshelf'), [0.0, 0.0, 1.0, 0.0])
        >>> features.covariance.diagonal()[:4].sqrt().numpy().round(2).tolist()
        [0.18, 0.18, 0.32, 0.18]
    """

    box_std: float = BOX_STD

    def __post_init__(self) -> None:
        _check_std(self.box_std)

    @property
    def names(self) -> tuple[str, ...]:
        """`is_CLASS` for each class, then the box's."""
        return (*(f"is_{label}" for label in self.choice.classes), *BOX_NAMES)

    def describe(self, one: Detections) -> Described:
        """As in `AbstractObjectEncoder`."""
        codes = np.eye(len(self.choice.classes))
        return _label_and_box(one, codes, self.choice.classes.index(one.labels[0]), self.box_std)


@dataclass(frozen=True)
class BoxEncoder(AbstractObjectEncoder):
    """Centre and size of the box in px, whatever the class.

    Args:
        choice: which object.
        box_std: as of `PaperEncoder`.

    Raises:
        InputError: a standard deviation below zero.

    Example:
        >>> found = Detections(("table",), np.array([0.9]), np.array([[480.0, 270.0, 100.0, 200.0]]), (960, 540))
        >>> BoxEncoder().encode(found).covariance.diagonal().sqrt().tolist()
        [5.0, 10.0, 5.0, 10.0]
    """

    box_std: float = BOX_STD

    def __post_init__(self) -> None:
        _check_std(self.box_std)

    @property
    def names(self) -> tuple[str, ...]:
        """The box's."""
        return BOX_NAMES

    def describe(self, one: Detections) -> Described:
        """As in `AbstractObjectEncoder`."""
        return one.box[0], _box_covariance(one, self.box_std), np.ones(4, bool)


@dataclass(frozen=True)
class MetricBoxEncoder(AbstractObjectEncoder):
    """Centre and edge lengths of the upright box around the object in the world, m; the camera's place does not matter.

    Not observed where the detector knows no place, as for an object of which depth shows too little.

    Args:
        choice: which object.

    Example:
        >>> found = Detections(
        ...     ("table",), np.array([0.9]), np.array([[480.0, 270.0, 100.0, 200.0]]), (960, 540),
        ...     place=np.array([[0.9, 0.1, -0.6, 0.8, 0.5, 0.7]]), place_covariance=1e-4 * np.eye(6)[None],
        ... )
        >>> MetricBoxEncoder().encode(found).value.tolist()
        [0.9, 0.1, -0.6, 0.8, 0.5, 0.7]
    """

    @property
    def names(self) -> tuple[str, ...]:
        """The place's."""
        return PLACE_NAMES

    def describe(self, one: Detections) -> Described:
        """As in `AbstractObjectEncoder`."""
        if one.place is None or one.place_covariance is None:
            return np.zeros(6), np.zeros((6, 6)), np.zeros(6, bool)
        known = np.isfinite(one.place[0]) & np.isfinite(one.place_covariance[0].diagonal())
        return one.place[0], one.place_covariance[0], known


@dataclass(frozen=True)
class NoEncoder(AbstractEnvironmentEncoder):
    """No features: a prediction from the motion alone, whatever is found.

    Example:
        >>> NoEncoder().encode(Detections.none((960, 540))).names
        ()
    """

    @property
    def names(self) -> tuple[str, ...]:
        """None."""
        return ()

    def encode(self, detections: Detections) -> EnvironmentFeatures:
        """Nothing.

        Args:
            detections: of one time.
        """
        return EnvironmentFeatures.unseen(())


@dataclass(frozen=True)
class ExactEncoder(AbstractEnvironmentEncoder):
    """What another encoder says, taken as exact: for methods that are told one sigma_e for all.

    Args:
        encoder: the other one.

    Example:
        >>> found = Detections(("table",), np.array([0.9]), np.array([[480.0, 270.0, 100.0, 200.0]]), (960, 540))
        >>> float(ExactEncoder(BoxEncoder()).encode(found).covariance.abs().max())
        0.0
    """

    encoder: AbstractEnvironmentEncoder

    @property
    def names(self) -> tuple[str, ...]:
        """The other's."""
        return self.encoder.names

    def encode(self, detections: Detections) -> EnvironmentFeatures:
        """The other's features without their covariance.

        Args:
            detections: of one time.
        """
        told = self.encoder.encode(detections)
        return EnvironmentFeatures(told.names, told.value, observed=told.observed)


def label_covariance(codes: Float[np.ndarray, "classes codes"], index: int, score: float) -> np.ndarray:
    """Mean squared error of the code of the class that was answered, if it is right with the probability of its score.

    With c_k the code of class k, j the answer, p_j = s and p_k = (1 - s) / (C - 1) for the others::

        sum_k p_k (c_k - c_j)(c_k - c_j)'

    That is the covariance of the categorical distribution, diag(p) - p p' for indicators, and the square of the
    difference between the answer and its mean, since what is given is the answer and not the mean.

    Args:
        codes: (C, D), code of each class.
        index: j.
        score: s, from 0 to 1.

    Returns:
        (D, D), in the codes' unit squared.

    Example:
        >>> label_covariance(np.arange(4.0)[:, None], 0, 0.7).round(3).tolist()  # 0.1 (1 + 4 + 9)
        [[1.4]]
    """
    probability = np.full(len(codes), (1.0 - score) / max(len(codes) - 1, 1))
    away = codes - codes[index]
    return (away * probability[:, None]).T @ away


def _label_and_box(one: Detections, codes: np.ndarray, index: int, box_std: float) -> Described:
    size = codes.shape[1]
    covariance = np.zeros((size + 4, size + 4))
    covariance[:size, :size] = label_covariance(codes, index, float(one.score[0]))
    covariance[size:, size:] = _box_covariance(one, box_std)
    return np.concatenate([codes[index], one.box[0]]), covariance, np.ones(size + 4, bool)


def _box_covariance(one: Detections, box_std: float) -> np.ndarray:
    if one.box_covariance is not None:
        return one.box_covariance[0]
    return np.diag((box_std * np.tile(one.box[0, 2:], 2)) ** 2)


def _check_std(box_std: float) -> None:
    if not 0.0 <= box_std < np.inf:
        raise InputError(f"Expected box_std of at least zero, a share of the box's size, got {box_std}.")

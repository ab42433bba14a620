"""From what a detector found to the features of the environment: which object counts, and the contract of encoders.

Detections are numpy arrays, features torch tensors of float64; they change hands in `AbstractObjectEncoder.encode`.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
import torch
from jaxtyping import Bool, Float

from eaip_prob.data.environment import EnvironmentFeatures
from eaip_prob.detection.base import CLASSES, Detections
from eaip_prob.errors import InputError

Described = tuple[Float[np.ndarray, "features"], Float[np.ndarray, "features features"], Bool[np.ndarray, "features"]]


@dataclass(frozen=True)
class ObjectChoice:
    """Which of several objects is the task's: of those that are admitted, the one with the highest score.

    Args:
        classes: all that a detector may answer, in the order of their numbers.
        wanted: those of the task; all if None.
        region: (left, top, right, bottom) within which the middle of the box lies, shares of the image; all if None.
        workspace: (lowest, highest) along x, y and z within which the middle of the place lies, m; an object whose
            place is not known is then not admitted. Everywhere if None.

    Raises:
        InputError: wanted classes that are none, or a region or workspace that is empty.

    Example:
        >>> found = Detections(
        ...     ("chair", "table"), np.array([0.9, 0.8]), np.array([[10.0, 9, 4, 4], [60.0, 9, 4, 4]]), (80, 45)
        ... )
        >>> ObjectChoice().choose(found), ObjectChoice(region=(0.5, 0.0, 1.0, 1.0)).choose(found)
        (0, 1)
    """

    classes: Sequence[str] = CLASSES
    wanted: Sequence[str] | None = None
    region: Sequence[float] | None = None
    workspace: Sequence[Sequence[float]] | None = None

    def __post_init__(self) -> None:
        unknown = sorted(set(self.wanted or ()) - set(self.classes))
        if unknown or not self.classes or (self.wanted is not None and not self.wanted):
            raise InputError(f"Expected wanted classes of {list(self.classes)}, at least one, got {self.wanted}.")
        for name, shape in (("region", (4,)), ("workspace", (3, 2))):
            given = getattr(self, name)
            if given is None:
                continue
            if np.shape(given) != shape or not (np.diff(_limits(given), axis=0) > 0).all():
                raise InputError(f"Expected {name} with shape {shape} and each lowest below its highest, got {given}.")

    def choose(self, detections: Detections) -> int | None:
        """Place of the task's object; None where there is none.

        Args:
            detections: of one time.

        Raises:
            InputError: a label that is none of the classes.
        """
        unknown = sorted(set(detections.labels) - set(self.classes))
        if unknown:
            raise InputError(
                f"Expected labels of {list(self.classes)}, got {unknown}. Map them to these in the detector, or name "
                "them in choice.classes."
            )
        wanted = self.classes if self.wanted is None else self.wanted
        admitted = np.isin(np.array(detections.labels, dtype=object), list(wanted))
        if self.region is not None:
            admitted &= _within(detections.box[:, :2] / detections.image_size, self.region)
        if self.workspace is not None:
            place = detections.place
            admitted &= False if place is None else _within(place[:, :3], self.workspace)
        at = np.flatnonzero(admitted)
        return int(at[np.argmax(detections.score[at])]) if len(at) else None


def _limits(given: Sequence) -> Float[np.ndarray, "2 axes"]:
    """Lowest and highest: of a region they follow each other, of a workspace they are the columns."""
    limits = np.asarray(given, float)
    return limits.reshape(2, 2) if limits.ndim == 1 else limits.T


def _within(middle: Float[np.ndarray, "detections axes"], given: Sequence) -> Bool[np.ndarray, "detections"]:
    low, high = _limits(given)
    return ((middle >= low) & (middle <= high)).all(1)  # NaN, a place that is not known, is nowhere


class AbstractEnvironmentEncoder(ABC):
    """Turns what a detector found into the environment of a prediction.

    A subclass gives `names` and `encode`; models see features with a covariance and nothing of detectors.
    """

    @property
    @abstractmethod
    def names(self) -> tuple[str, ...]:
        """Of the features, in their order, whatever is found."""

    @abstractmethod
    def encode(self, detections: Detections) -> EnvironmentFeatures:
        """The features and their covariance; what was not observed is `observed = False`.

        Args:
            detections: of one time.
        """


@dataclass(frozen=True)
class AbstractObjectEncoder(AbstractEnvironmentEncoder):
    """An encoder that describes one object; where none is found, nothing is observed and a prediction does without.

    A subclass gives `names` and `describe`.

    Args:
        choice: which object.
    """

    choice: ObjectChoice = field(default_factory=ObjectChoice)

    @abstractmethod
    def describe(self, one: Detections) -> Described:
        """(value, covariance, observed) of the features; where not observed, the numbers do not count.

        Args:
            one: the object alone.
        """

    def encode(self, detections: Detections) -> EnvironmentFeatures:
        """The features of the task's object and their covariance.

        Args:
            detections: of one time.

        Raises:
            InputError: a label that is none of the classes.
        """
        index = self.choice.choose(detections)
        if index is None:
            return EnvironmentFeatures.unseen(self.names)
        value, covariance, observed = self.describe(detections[np.array([index])])
        known = np.where(observed[:, None] & observed, covariance, 0.0)
        return EnvironmentFeatures(
            self.names,
            torch.from_numpy(np.where(observed, value, 0.0)),
            torch.from_numpy(known),
            torch.from_numpy(observed),
        )

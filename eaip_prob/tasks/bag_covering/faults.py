"""What may go wrong between the room and the robot: hidden hands, late frames, a partner who does not go on."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float

from eaip_prob.detection import CLASSES, Detections
from eaip_prob.errors import InputError
from eaip_prob.perception.hands import HandState

_GROWTH = 0.4  # m; standard deviation at which a hand that is not seen stays, as of the glove tracker


@dataclass(frozen=True)
class Faults:
    """Disturbances of one trial; none by default.

    Args:
        hidden: (from, to), s, in which the carrying hand is not seen.
        delay: by which everything that is seen arrives late, s.
        wrong_class: the class that the detector answers with a score of 0.95, whatever it sees; None for its own.
        unseen: whether no object is ever detected.
        speed: of the partner over the planned one.
        stop: time from which on the partner stands still, s.
        back: time from which on the partner goes back the way, s.
        leave: time from which on no hand is seen, s.

    Raises:
        InputError: an unknown class, a negative delay, or a speed not above zero.

    Example:
        >>> Faults(speed=2.0).partner_time(np.array([0.0, 1.0, 2.0])).tolist()
        [0.0, 2.0, 4.0]
        >>> Faults(stop=1.0).partner_time(np.array([0.0, 1.0, 2.0])).tolist()
        [0.0, 1.0, 1.0]
    """

    hidden: Sequence[float] | None = None
    delay: float = 0.0
    wrong_class: str | None = None
    unseen: bool = False
    speed: float = 1.0
    stop: float | None = None
    back: float | None = None
    leave: float | None = None

    def __post_init__(self) -> None:
        if self.wrong_class is not None and self.wrong_class not in CLASSES:
            raise InputError(f"Expected wrong_class as one of {CLASSES}, got {self.wrong_class!r}.")
        if not (self.delay >= 0.0 and self.speed > 0.0):
            raise InputError(f"Expected delay of at least 0 and speed above 0, got {self.delay} and {self.speed}.")

    def partner_time(self, time: Float[np.ndarray, "*times"]) -> Float[np.ndarray, "*times"]:
        """Which time of the planned motion the partner is at.

        Args:
            time: s since the start.
        """
        planned = self.speed * np.asarray(time, float)
        if self.stop is not None:
            planned = np.minimum(planned, self.speed * self.stop)
        if self.back is not None:
            turn = self.speed * self.back
            planned = np.where(planned > turn, np.maximum(2.0 * turn - planned, 0.0), planned)
        return planned

    def hands(self, hands: HandState | None) -> HandState | None:
        """What arrives of the tracked hands.

        Args:
            hands: as tracked.
        """
        if hands is None:
            return None
        gone = self.leave is not None and hands.time >= self.leave
        away = self.hidden is not None and self.hidden[0] <= hands.time < self.hidden[1]
        if not (gone or away):
            return hands
        lost = np.array([gone, True])
        covariance = np.where(lost[:, None, None], hands.covariance + _GROWTH**2 * np.eye(3), hands.covariance)
        return replace(hands, covariance=covariance, seen=hands.seen & ~lost)

    def detections(self, found: Detections | None) -> Detections | None:
        """What arrives of the detections.

        Args:
            found: by the detector; None where it was not asked.
        """
        if found is None:
            return None
        if self.unseen:
            return Detections.none(found.image_size)
        if self.wrong_class is None or not len(found):
            return found
        return replace(found, labels=(self.wrong_class,) * len(found), score=np.full(len(found), 0.95))

"""What the partner does, from the hand that carries its edge of the bag: so that a motion ends in a stated outcome.

The way of the hand is kept as points some centimetres apart, so that noise does not lengthen it. A hand went back if it
is near a point of its way that it had left behind: if its way since then led far away.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np
from jaxtyping import Float

from eaip_prob.checks import check_positive, check_type
from eaip_prob.errors import InputError
from eaip_prob.perception.hands import HANDS, HandState

_NEAR = 2.0  # spacings of the points
Status = Literal["moves", "stopped", "went_back", "left"]


@dataclass(frozen=True)
class PartnerReport:
    """What the partner does.

    Args:
        status: "moves", also where nothing speaks against it yet, "stopped", "went_back" or "left".
        reason: in words; None where the partner moves.
        progress: way of the hand so far, m.

    Example:
        >>> PartnerReport("moves", None, 0.4).status
        'moves'
    """

    status: Status
    reason: str | None
    progress: float


@dataclass(frozen=True, eq=False)
class PartnerState:
    """What `PartnerWatch.step` remembers.

    Args:
        way: (P, 3), points that the hand passed, m.
        length: (P,), way up to each of them, m.
        back: distance of the farthest point that the hand reached since it was near where it is now, m.
        still: s during which the hand was seen and did not get on.
        present: time at which a hand was last seen in the workspace, or of the first step, s.
        time: of the last step, s; minus infinity before the first.

    Example:
        >>> PartnerWatch().init().way.shape
        (0, 3)
    """

    way: Float[np.ndarray, "points 3"]
    length: Float[np.ndarray, "points"]
    back: float = 0.0
    still: float = 0.0
    present: float = -np.inf
    time: float = -np.inf


@dataclass(frozen=True)
class PartnerWatch:
    """Says whether the partner moves, stopped, went back or left.

    A hand that is hidden for a while is no stop: while it is not seen its time does not count, and the partner has left
    only when no hand was seen in the workspace for long.

    Args:
        unseen: s without any hand in the workspace after which the partner has left.
        pause: s without getting on after which the partner stopped.
        back: how far from a hand its way since it was last there must have led, so that it went back, m.
        spacing: distance between the points by which the way is remembered, m; less is no movement, and a hand that
            is within twice of it has been there.
        hand: that carries the edge of the bag, "left" or "right".
        low: (3,), x, y and z of the workspace's lower corner, m.
        high: (3,), of its upper corner, m.

    Raises:
        InputError: times or distances that are not above zero, another hand, or a workspace without volume.

    Example:
        >>> watch, covariance = PartnerWatch(pause=1.0), np.tile(1e-6 * np.eye(3), (2, 1, 1))
        >>> state, reports = watch.init(), []
        >>> for time, y in enumerate([-0.6, -0.4, -0.2, -0.2, -0.2, -0.4]):
        ...     both = np.array([[1.4, -0.6, -0.5], [1.4, y, 0.2]])
        ...     hands = HandState(float(time), both, covariance, np.array([True, True]))
        ...     report, state = watch.step(hands, float(time), state)
        ...     reports.append(report.status)
        >>> reports
        ['moves', 'moves', 'moves', 'stopped', 'stopped', 'went_back']
    """

    unseen: float = 3.0
    pause: float = 5.0
    back: float = 0.12
    spacing: float = 0.03
    hand: str = "right"
    low: Sequence[float] = (0.2, -1.3, -0.95)
    high: Sequence[float] = (2.0, 1.3, 1.3)

    def __post_init__(self) -> None:
        for name in ("unseen", "pause", "back", "spacing"):
            check_positive(name, getattr(self, name))
        if self.hand not in HANDS:
            raise InputError(f"Expected hand to be one of {HANDS}, got {self.hand!r}.")
        low, high = np.asarray(self.low, dtype=np.float64), np.asarray(self.high, dtype=np.float64)
        if low.shape != (3,) or high.shape != (3,) or not (low < high).all():
            raise InputError(f"Expected corners low below high, x, y and z in m, got {self.low} and {self.high}.")

    def init(self) -> PartnerState:
        """The state before anybody was seen."""
        return PartnerState(np.zeros((0, 3)), np.zeros(0))

    def step(self, hands: HandState | None, time: float, state: PartnerState) -> tuple[PartnerReport, PartnerState]:
        """(what the partner does, next state).

        Args:
            hands: now; None where the tracker has none.
            time: s, not before the last step.
            state: from `init` or the last step.

        Raises:
            InputError: time that went back, or the position of a hand that was seen is not finite.
        """
        check_type("state", state, PartnerState, "Pass what init or the last step returned.")
        if not state.time <= time < np.inf:
            raise InputError(f"Expected time not before the last step at {state.time:g} s, got {time}.")
        seen = self._seen(hands)
        elapsed = time - state.time if np.isfinite(state.time) else 0.0
        if any(self._is_inside(place) for place in seen.values()) or not np.isfinite(state.time):
            state = replace(state, present=time)
        state = replace(state, time=time)
        if self.hand in seen:
            state = self._moved(state, seen[self.hand], elapsed)
        return self._report(state, bool(seen)), state

    def _seen(self, hands: HandState | None) -> dict[str, np.ndarray]:
        if hands is None:
            return {}
        check_type("hands", hands, HandState, "Pass what a hand tracker returned.")
        seen = {name: hands.position[i] for i, name in enumerate(HANDS) if hands.seen[i]}
        for name, place in seen.items():
            if not np.isfinite(place).all():
                raise InputError(f"Expected a finite position of the {name} hand, got {place}. Mark it as not seen.")
        return seen

    def _is_inside(self, place: np.ndarray) -> bool:
        return bool((place >= np.asarray(self.low)).all() and (place <= np.asarray(self.high)).all())

    def _moved(self, state: PartnerState, place: np.ndarray, elapsed: float) -> PartnerState:
        if not len(state.way):
            return replace(state, way=place[None], length=np.zeros(1))
        away = np.linalg.norm(state.way - place, axis=-1)
        passed = np.flatnonzero(away < _NEAR * self.spacing)
        back = float(away[passed[0] :].max()) if len(passed) else 0.0
        if away.min() < self.spacing:
            return replace(state, back=back, still=state.still + elapsed)
        length = np.append(state.length, state.length[-1] + away[-1])
        return replace(state, way=np.append(state.way, place[None], 0), length=length, back=back, still=0.0)

    def _report(self, state: PartnerState, seen: bool) -> PartnerReport:
        progress = float(state.length[-1]) if len(state.length) else 0.0
        missed = state.time - state.present
        if missed > self.unseen:
            where = "both were outside it" if seen else "none was seen"
            return PartnerReport("left", f"No hand in the workspace for {missed:.1f} s: {where}.", progress)
        if state.back > self.back:
            return PartnerReport("went_back", f"The {self.hand} hand went back by {state.back:.2f} m.", progress)
        if state.still >= self.pause:
            return PartnerReport("stopped", f"The {self.hand} hand did not get on for {state.still:.1f} s.", progress)
        return PartnerReport("moves", None, progress)

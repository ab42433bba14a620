"""Which candidate is which hand, and what is known of things that look like gloves and are none."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float

from eaip_prob.perception import kalman
from eaip_prob.perception.glove_candidates import GloveCandidate

_PATIENCE = 0.1  # seconds for which something must have been there before a lost hand jumps to it
_STILL = 0.5  # seconds without motion after which it is furniture
_MOVED = 0.02  # metres
_MISSED = 25.0  # price of a hand without a candidate, in units of a squared Mahalanobis distance
_UNLIKELY = 40.0  # squared Mahalanobis distance, 3 degrees of freedom, beyond which nothing is believed


@dataclass(frozen=True, eq=False)
class Stray:
    """Something that looks like a glove and belongs to no hand.

    Args:
        center: (3,), where it is now, m.
        origin: (3,), where it was first seen, m.
        since: when that was, s.
        time: when it was seen last, s.
        moved: whether it was ever 2 cm away from there.
    """

    center: Float[np.ndarray, "3"]
    origin: Float[np.ndarray, "3"]
    since: float
    time: float
    moved: bool = False

    @property
    def still(self) -> bool:
        """Whether it stood still so long that it is part of the furniture."""
        return not self.moved and self.time - self.since > _STILL

    @property
    def patient(self) -> bool:
        """Whether it was there for so long that it is no passing error."""
        return self.time - self.since > _PATIENCE


def followed(
    strays: Sequence[Stray], candidates: Sequence[GloveCandidate], time: float, radius: float
) -> tuple[Stray, ...]:
    """A stray for every candidate, in their order: what it was before, or new.

    Args:
        strays: of the frames before; those not seen now are forgotten, unless they stood still.
        candidates: now.
        time: s.
        radius: m; farther than this from frame to frame is another thing.

    Example:
        >>> ball = GloveCandidate(np.zeros(3), np.eye(3) * 1e-6, share=1.0)
        >>> first = followed((), [ball], time=0.0, radius=0.05)
        >>> followed(first, [ball], time=0.6, radius=0.05)[0].still
        True
    """
    now: list[Stray] = []
    free = list(strays)
    for candidate in candidates:
        distances = [float(np.linalg.norm(stray.center - candidate.center)) for stray in free]
        if not distances or min(distances) > radius:
            now.append(Stray(candidate.center, candidate.center, time, time))
            continue
        before = free.pop(int(np.argmin(distances)))
        moved = before.moved or float(np.linalg.norm(candidate.center - before.origin)) > _MOVED
        now.append(Stray(candidate.center, before.origin, before.since, time, moved))
    return (*now, *(stray for stray in free if stray.still))


def assign(
    mean: Float[np.ndarray, "hands 6"],
    covariance: Float[np.ndarray, "hands 6 6"],
    candidates: Sequence[GloveCandidate],
    strays: Sequence[Stray],
    lost: Bool[np.ndarray, "hands"],
    gate: float,
) -> dict[int, int]:
    """Hand -> candidate, the likeliest for both hands together.

    Args:
        mean: (2, 6), predicted, m and m/s.
        covariance: (2, 6, 6).
        candidates: M of them.
        strays: what was known of each candidate, in their order, and of others.
        lost: (2,), hands not seen for a while; they take also what is beyond the gate, once it has stayed.
        gate: m.

    Example:
        >>> mean = np.zeros((2, 6))
        >>> mean[1, 0] = 0.5
        >>> seen = [GloveCandidate(np.array([x, 0.0, 0.0]), np.eye(3) * 1e-6, 1.0) for x in (0.51, 0.01)]
        >>> assign(mean, np.stack([np.eye(6)] * 2) * 1e-4, seen, followed((), seen, 0.0, 0.05), np.zeros(2, bool), 0.15)
        {0: 1, 1: 0}
    """
    costs = np.full((len(mean), len(candidates) + 1), np.inf)
    costs[:, -1] = _MISSED
    for i in range(len(mean)):
        for j, candidate in enumerate(candidates):
            if _possible(mean[i], covariance[i], candidate, strays[j], bool(lost[i]), gate):
                costs[i, j] = kalman.negative_log_likelihood(
                    mean[i], covariance[i], candidate.center, candidate.covariance
                )
    none = len(candidates)
    choices = [(a, b) for a in range(none + 1) for b in range(none + 1) if a != b or a == none]
    best = min(choices, key=lambda pair: costs[0, pair[0]] + costs[1, pair[1]])
    return {hand: j for hand, j in enumerate(best) if j != none}


def _possible(
    mean: np.ndarray, covariance: np.ndarray, candidate: GloveCandidate, stray: Stray, lost: bool, gate: float
) -> bool:
    if stray.still:
        return False
    away = candidate.center - mean[:3]
    if float(np.linalg.norm(away)) > gate and not (lost and stray.patient):
        return False
    spread = covariance[:3, :3] + candidate.covariance
    return lost or float(away @ np.linalg.solve(spread, away)) < _UNLIKELY

"""How well gloves are followed: errors of what is seen, honesty of what is not, and whether hands were mixed up."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float
from scipy.stats import chi2

from eaip_prob.data.frames import RGBDFrame
from eaip_prob.errors import ShapeError
from eaip_prob.perception.hands import AbstractHandTracker, HandState

_SWAP = 2.0  # times nearer to the other hand than to its own: mixed up, not imprecise


@dataclass(frozen=True)
class TrackingScores:
    """What a clip says of a tracker.

    Args:
        median_mm: of the distance between a seen hand and the centre of its glove, mm; NaN where none was seen.
        p95_mm: 95 % of these distances are smaller, mm.
        seen: share of hands and frames, from the first that was tracked, that are seen.
        coverage95: share of hands and frames, seen or not, whose true place is inside the 95 % ellipsoid.
        swaps: times that the hands became mixed up.

    Example:
        >>> TrackingScores(1.2, 3.0, 1.0, 0.97, 0).metrics()["p95_mm"]
        3.0
    """

    median_mm: float
    p95_mm: float
    seen: float
    coverage95: float
    swaps: int

    def metrics(self) -> dict[str, float]:
        """Under their names, those that have a value."""
        return {name: float(value) for name, value in vars(self).items() if not np.isnan(value)}


def followed(
    tracker: AbstractHandTracker, frames: Iterable[Sequence[RGBDFrame]], time: Float[np.ndarray, "time"]
) -> list[HandState | None]:
    """What a tracker says at each time; None until it has seen both hands.

    Args:
        tracker: begins anew.
        frames: of all cameras that delivered one, time by time.
        time: (T,), s.

    Raises:
        ValueError: another number of sets of frames.

    Example:
        >>> from eaip_prob.perception.gloves import GloveTracker
        >>> followed(GloveTracker(radius=0.05), [[], []], np.array([0.0, 0.1]))
        [None, None]
    """
    state, hands = tracker.init(), []
    for step, now in zip(frames, time, strict=True):
        found, state = tracker.step(step, state, float(now))
        hands.append(found)
    return hands


def tracking_scores(states: Sequence[HandState | None], truth: Float[np.ndarray, "time hands 3"]) -> TrackingScores:
    """Compares what a tracker said with where the gloves were.

    Args:
        states: from `followed`.
        truth: (T, 2, 3), centres of the gloves, m.

    Raises:
        ShapeError: another number of times.

    Example:
        >>> state = HandState(0.0, np.zeros((2, 3)), np.tile(1e-4 * np.eye(3), (2, 1, 1)), np.array([True, True]))
        >>> scores = tracking_scores([state], np.full((1, 2, 3), [0.003, 0.0, 0.0]))
        >>> round(scores.median_mm, 9), scores.coverage95, scores.swaps
        (3.0, 1.0, 0)
    """
    if np.shape(truth) != (len(states), 2, 3):
        raise ShapeError(f"Expected truth with shape {(len(states), 2, 3)}, got {np.shape(truth)}.")
    pairs = [(state, hands) for state, hands in zip(states, truth, strict=True) if state is not None]
    if not pairs:
        return TrackingScores(np.nan, np.nan, 0.0, np.nan, 0)
    error = np.array([state.position - hands for state, hands in pairs])
    seen = np.array([state.seen for state, _ in pairs])
    covariance = np.array([state.covariance for state, _ in pairs])
    distance = np.linalg.norm(error, axis=-1)
    standardised = np.einsum("...i,...i->...", error, np.linalg.solve(covariance, error[..., None])[..., 0])
    other = np.array([np.linalg.norm(state.position - hands[::-1], axis=-1) for state, hands in pairs])
    mixed = (distance > _SWAP * other).any(-1)
    swaps = int(mixed[0]) + int((~mixed[:-1] & mixed[1:]).sum())
    found = 1000.0 * distance[seen]
    median, p95 = (float(np.quantile(found, level)) if found.size else np.nan for level in (0.5, 0.95))
    coverage = float((standardised <= chi2.ppf(0.95, 3)).mean())
    return TrackingScores(median, p95, float(seen.mean()), coverage, swaps)

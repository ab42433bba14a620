"""Follows two green gloves through the frames of one or more depth cameras.

Frames are worked off in the order of their time stamps: cameras out of step are separate measurements, each at its own
time, and a frame that comes after a later one was used is left out. A hand that is not seen moves on for three frames,
is then held where it is with `seen` False, and its covariance grows with the speed that hands may have.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float

from eaip_prob.data.frames import RGBDFrame
from eaip_prob.errors import InputError
from eaip_prob.perception import kalman
from eaip_prob.perception.glove_assignment import Stray, assign, followed
from eaip_prob.perception.glove_candidates import GloveCandidate, glove_candidates
from eaip_prob.perception.glove_mask import GloveColor, GlovePoints, glove_points
from eaip_prob.perception.hands import AbstractHandTracker, HandState


@dataclass(frozen=True, eq=False)
class GloveTracks:
    """What a tracker knows between frames.

    Args:
        time: of the last frame used, s; minus infinity before the first.
        mean: (2, 6), position and velocity of the left and the right hand, m and m/s; None before both were seen.
        covariance: (2, 6, 6).
        last_seen: (2,), s.
        strays: what looks like a glove and belongs to no hand.

    Example:
        >>> GloveTracker(radius=0.05).init().mean is None
        True
    """

    time: float
    mean: Float[np.ndarray, "hands 6"] | None
    covariance: Float[np.ndarray, "hands 6 6"]
    last_seen: Float[np.ndarray, "hands"]
    strays: tuple[Stray, ...] = ()


class GloveTracker(AbstractHandTracker):
    """Kalman filters on the centres of two gloves, told apart at the start by the side of the person they are on.

    Args:
        radius: of a glove, m.
        to_left: (3,), direction in the world to the person's left; default: of one who faces the robot.
        window: the colour of the gloves.
        acceleration: spectral density of the acceleration of hands, m^2/s^3.
        speed: standard deviation of each component of a hand's velocity when nothing is known of it, m/s.
        reach: standard deviation at which the position of a hand that is not seen stays, m.
        gate: m; a measurement farther from where a hand is expected is another thing, unless it stays.
        frame_time: s between two frames of a camera.
        lost_after: frames not seen after which a hand is held and `seen` is False.

    Raises:
        InputError: an argument not above zero.

    Example:
        >>> tracker = GloveTracker(radius=0.05)
        >>> hands, state = tracker.step([], tracker.init())
        >>> hands is None
        True
    """

    def __init__(
        self,
        radius: float,
        to_left: Sequence[float] = (0.0, -1.0, 0.0),
        window: GloveColor | None = None,
        acceleration: float = 2.0,
        speed: float = 0.5,
        reach: float = 0.4,
        gate: float = 0.15,
        frame_time: float = 1.0 / 30.0,
        lost_after: int = 3,
    ) -> None:
        numbers = {"radius": radius, "acceleration": acceleration, "speed": speed, "reach": reach, "gate": gate}
        for name, value in {**numbers, "frame_time": frame_time, "lost_after": lost_after}.items():
            if not (math.isfinite(value) and value > 0):
                raise InputError(f"Expected {name} above zero, got {value}. Give it in metres and seconds.")
        self.radius, self.window = radius, window or GloveColor()
        self.to_left = np.asarray(to_left, dtype=float)
        self.acceleration, self.speed, self.reach, self.gate = acceleration, speed, reach, gate
        self.frame_time, self.lost_after = frame_time, lost_after

    def init(self) -> GloveTracks:
        """The state before anything was seen."""
        return GloveTracks(-math.inf, None, np.zeros((2, 6, 6)), np.full(2, -math.inf))

    def step(
        self, frames: Sequence[RGBDFrame], state: GloveTracks, time: float | None = None
    ) -> tuple[HandState | None, GloveTracks]:
        """(hands, next state); None until both gloves were seen at one time.

        Args:
            frames: of the cameras that delivered one now, in any order; none while all fail.
            state: from `init` or the last step.
            time: s, at which the hands are wanted; default that of the latest frame so far, which stands still while
                all cameras fail. It has no part in the next state, so that frames may still come from before it.

        Raises:
            InputError: time stamps that differ by more than ten frames: cameras whose clocks disagree.

        Example:
            >>> tracker = GloveTracker(radius=0.05)
            >>> tracker.step([], tracker.init())[1].time
            -inf
        """
        for group in self._moments(frames, state.time):
            state = self._advanced(group, state)
        if time is None or state.mean is None or time <= state.time:
            return self._hands(state), state
        return self._hands(replace(self._predicted(state, time), time=time)), state

    def _moments(self, frames: Sequence[RGBDFrame], after: float) -> list[list[RGBDFrame]]:
        """Frames newer than the state, those of one moment together."""
        ordered = sorted(frames, key=lambda frame: frame.time)
        if ordered and ordered[-1].time - ordered[0].time > 10 * self.frame_time:
            raise InputError(
                f"Expected frames of about one time, got {ordered[0].name} at {ordered[0].time:.3f} s and "
                f"{ordered[-1].name} at {ordered[-1].time:.3f} s. Set the cameras' clocks, or leave out old frames."
            )
        moments: list[list[RGBDFrame]] = []
        for frame in ordered:
            if frame.time <= after:
                continue
            if moments and frame.time - moments[-1][0].time < 0.1 * self.frame_time:
                moments[-1].append(frame)
            else:
                moments.append([frame])
        return moments

    def _advanced(self, frames: Sequence[RGBDFrame], state: GloveTracks) -> GloveTracks:
        time = max(frame.time for frame in frames)
        seen = GlovePoints.joined([glove_points(frame, self.window) for frame in frames])
        if state.mean is not None:
            state = self._predicted(state, time)
        expected = np.zeros((0, 3)) if state.mean is None else state.mean[:, :3]
        candidates = glove_candidates(seen, self.radius, expected)
        if state.mean is None:
            return self._started(candidates, replace(state, time=time))
        return self._corrected(candidates, replace(state, time=time))

    def _predicted(self, state: GloveTracks, time: float) -> GloveTracks:
        assert state.mean is not None
        mean, covariance = state.mean.copy(), state.covariance.copy()
        for i, given_up in enumerate(state.last_seen + self._patience):
            moving = max(min(time, given_up) - state.time, 0.0)
            mean[i], covariance[i] = kalman.predict(mean[i], covariance[i], moving, self.acceleration)
            if time > given_up:
                if state.time <= given_up:
                    mean[i], covariance[i] = self._stopped(mean[i], covariance[i])
                mean[i], covariance[i] = self._held(mean[i], covariance[i], time - max(given_up, state.time))
        return replace(state, mean=mean, covariance=covariance)

    def _stopped(self, mean: np.ndarray, covariance: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Where it was, at an unknown velocity: the last one becomes part of what is not known."""
        stopped = kalman.start(mean[:3], covariance[:3, :3], self.speed)[1]
        stopped[3:, 3:] += np.outer(mean[3:], mean[3:])
        return np.concatenate([mean[:3], np.zeros(3)]), stopped

    def _held(self, mean: np.ndarray, covariance: np.ndarray, step: float) -> tuple[np.ndarray, np.ndarray]:
        mean, covariance = kalman.predict(mean, covariance, step, 0.0)
        if covariance[:3, :3].diagonal().max() > self.reach**2:
            return kalman.start(mean[:3], self.reach**2 * np.eye(3), self.speed)
        return mean, covariance

    def _lost(self, state: GloveTracks, time: float) -> np.ndarray:
        return time - state.last_seen > self._patience

    @property
    def _patience(self) -> float:
        """Time after which a hand that was not seen is given up, s."""
        return (self.lost_after + 0.5) * self.frame_time

    def _started(self, candidates: list[GloveCandidate], state: GloveTracks) -> GloveTracks:
        strays = followed(state.strays, candidates, state.time, self.radius)
        hands = candidates
        if len(candidates) > 2:
            hands = [candidate for candidate, stray in zip(candidates, strays, strict=True) if stray.moved]
        if len(hands) != 2:
            return replace(state, strays=strays)
        left, right = sorted(hands, key=lambda candidate: -float(candidate.center @ self.to_left))
        begun = [kalman.start(hand.center, hand.covariance, self.speed) for hand in (left, right)]
        return GloveTracks(
            state.time,
            np.stack([mean for mean, _ in begun]),
            np.stack([covariance for _, covariance in begun]),
            np.full(2, state.time),
            tuple(stray for stray, candidate in zip(strays, candidates, strict=True) if candidate not in hands),
        )

    def _corrected(self, candidates: list[GloveCandidate], state: GloveTracks) -> GloveTracks:
        assert state.mean is not None
        strays = followed(state.strays, candidates, state.time, self.radius)
        lost = self._lost(state, state.time)
        pairs = assign(state.mean, state.covariance, candidates, strays, lost, self.gate)
        mean, covariance, last_seen = state.mean.copy(), state.covariance.copy(), state.last_seen.copy()
        for hand, j in pairs.items():
            measured = candidates[j]
            mean[hand], covariance[hand] = kalman.update(
                mean[hand], covariance[hand], measured.center, measured.covariance
            )
            last_seen[hand] = state.time
        kept = tuple(stray for j, stray in enumerate(strays) if j not in pairs.values())
        return GloveTracks(state.time, mean, covariance, last_seen, kept)

    def _hands(self, state: GloveTracks) -> HandState | None:
        if state.mean is None:
            return None
        seen = ~self._lost(state, state.time)
        return HandState(state.time, state.mean[:, :3].copy(), state.covariance[:, :3, :3].copy(), seen)

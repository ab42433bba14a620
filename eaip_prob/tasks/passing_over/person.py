"""A model of how a person moves a mouse cursor over a rectangle: what is planned, and what varies."""

from __future__ import annotations

import itertools
import math
from dataclasses import dataclass

import torch
from jaxtyping import Float
from torch import Tensor

from eaip_prob.checks import check_fraction, check_positive
from eaip_prob.data.trajectory import Trajectory
from eaip_prob.errors import InputError
from eaip_prob.tasks.passing_over.motion import minimum_jerk_states, quintic_positions, tremor

# (width, height) of the paper's nine rectangles, px.
PAPER_SIZES = tuple(itertools.product((125.0, 215.0, 325.0), (125.0, 215.0, 325.0)))
_ROOM = 6.0  # standard deviations: a start or an end under the rectangle is then out of the question


@dataclass(frozen=True)
class Intention:
    """What a person brings to N motions before looking at the rectangle.

    Args:
        start: (N, 2), px.
        end: (N, 2), px.
        duration: (N,), seconds that the motion takes over a rectangle of average extent; its tempo.
    """

    start: Float[Tensor, "motions 2"]
    end: Float[Tensor, "motions 2"]
    duration: Float[Tensor, "motions"]

    def __getitem__(self, index: Tensor) -> Intention:
        """The intentions of some of the motions."""
        return Intention(self.start[index], self.end[index], self.duration[index])


@dataclass(frozen=True)
class CursorPerson:
    """Minimum-jerk cursor motions through two via-points beside the upper corners, with a person's variation.

    Start, end and individual tempo are drawn without regard to the rectangle; everything else follows from planning.
    Every number is chosen from what is known of people and of the task; none was chosen by the error of a predictor.
    38 px are a centimetre on a screen of 96 dots per inch.

    Args:
        start: mean start, px. Beside the widest rectangle (half width 200) with 150 px to spare, near its foot.
        start_sd: by eye a person puts a cursor back to within about half a centimetre, less in height, which the
            ground line guides.
        end: mean end, px. The mirror image of the start.
        end_sd: nothing marks where the motion ends, so it varies more than the start.
        duration: shortest and longest, s; uniform between. About two seconds as in the paper (200 steps), and 9 %
            coefficient of variation, the usual 5 to 15 % of a self-chosen tempo. People hold a tempo over motions
            of different extent (isochrony), so the rectangle has no say.
        tempo_sd: None, or the standard deviation of log T over the paper's nine rectangles, in place of the uniform
            durations; log T is normal about the log of the mean of `duration`.
        tempo_dependence: share of the variance of log T that the rectangle explains, for people who take longer over
            a longer way: log T = log mean + tempo_sd (sqrt(share) z + sqrt(1 - share) u), with u standard normal and
            z the log length of the polyline from the mean start over both upper corners to the mean end, standardised
            over the nine rectangles.
        clearance: median distance of a via-point from its corner, px. 8 mm: a safety margin of a few standard
            deviations of where a fast hand ends up.
        clearance_sd: of the log clearance of a whole motion: a person is more or less careful from time to time.
        corner_sd: of the log clearance of each corner about that of the motion: aim varies by about 15 %.
        direction_sd: rad, of the direction in which a via-point lies from its corner about the diagonal (10 deg).
        exponent: duration of a segment grows as (chord length)^exponent.
        rest_factor: segments in which the hand starts or stops take so many times longer. A minimum-jerk motion
            from rest to rest has a mean speed 1 / 1.875 of its peak speed, so about 2. With an exponent of 0.8 the
            squared jerk is then within 17 % of the least of any timing, for each of the nine rectangles of
            125, 215 and 325 px.
        share_sd: of the log duration of each segment: relative timing varies by about 10 %.
        tremor: rms of each axis, px, so 1 px in the plane. Physiological hand tremor of 0.1 to 0.2 mm times a usual
            pointer gain of 2 is 0.8 to 1.5 px in the plane.
        tremor_band: Hz, of physiological tremor.

    Example:
        >>> person = CursorPerson()
        >>> intention = person.intend(3, 100.0, torch.Generator().manual_seed(0))
        >>> motions = person.move(intention, 215.0, 125.0, 100.0, torch.Generator().manual_seed(1))
        >>> motions.names, motions.batch_shape
        (('x', 'y'), torch.Size([3]))
    """

    start: tuple[float, float] = (-350.0, 30.0)
    start_sd: tuple[float, float] = (15.0, 8.0)
    end: tuple[float, float] = (350.0, 30.0)
    end_sd: tuple[float, float] = (20.0, 12.0)
    duration: tuple[float, float] = (1.7, 2.3)
    tempo_sd: float | None = None
    tempo_dependence: float = 0.0
    clearance: float = 32.0
    clearance_sd: float = 0.25
    corner_sd: float = 0.15
    direction_sd: float = 0.17
    exponent: float = 0.8
    rest_factor: float = 2.0
    share_sd: float = 0.1
    tremor: float = 0.7
    tremor_band: tuple[float, float] = (8.0, 12.0)

    def __post_init__(self) -> None:
        for name in ("start", "start_sd", "end", "end_sd", "duration", "tremor_band"):
            pair = tuple(float(value) for value in getattr(self, name))
            if len(pair) != 2:
                raise InputError(f"Expected two numbers in {name}, got {pair}.")
            object.__setattr__(self, name, pair)
        if check_positive("duration", self.duration[0]) > check_positive("duration", self.duration[1]):
            raise InputError(f"Expected duration as (shortest, longest), got {self.duration}.")
        self._check_tempo()
        check_positive("clearance", self.clearance)
        check_positive("rest_factor", self.rest_factor)
        spreads = ("clearance_sd", "corner_sd", "direction_sd", "share_sd", "tremor")
        negative = [name for name in spreads if getattr(self, name) < 0] + [
            name for name in ("start_sd", "end_sd") if min(getattr(self, name)) < 0
        ]
        if negative:
            raise InputError(f"Expected standard deviations of at least zero, got a negative one in {negative}.")

    def _check_tempo(self) -> None:
        share = check_fraction("tempo_dependence", self.tempo_dependence)
        if self.tempo_sd is None and share > 0:
            raise InputError("Expected tempo_sd with tempo_dependence, got None. Give the standard deviation of log T.")
        if self.tempo_sd is not None and not 0 <= self.tempo_sd < math.inf:
            raise InputError(f"Expected tempo_sd of at least zero and finite, got {self.tempo_sd}.")

    def check_fits(self, width: float, height: float) -> None:
        """Refuses sizes that are not above zero and rectangles that reach to where motions start or end.

        Raises:
            InputError: names the size and the largest width.
        """
        check_positive("width", width)
        check_positive("height", height)
        room = min(-self.start[0] - _ROOM * self.start_sd[0], self.end[0] - _ROOM * self.end_sd[0])
        if width / 2 >= room:
            raise InputError(
                f"Expected a width below {2 * room:g} px, so that motions start and end beside the rectangle, "
                f"got {width:g}. Move the person's start and end outward."
            )

    def intend(self, num: int, rate: float, generator: torch.Generator) -> Intention:
        """Start, end and individual tempo of `num` motions; `rate` is in samples per second."""
        start, end = (
            torch.tensor(mean, dtype=torch.float64)
            + torch.tensor(spread, dtype=torch.float64) * _normal(generator, num, 2)
            for mean, spread in ((self.start, self.start_sd), (self.end, self.end_sd))
        )
        return Intention(start, end, self._tempo(num, rate, generator))

    def _tempo(self, num: int, rate: float, generator: torch.Generator) -> Tensor:
        """Seconds without the rectangle's share."""
        if self.tempo_sd is None:
            fewest, most = (max(2, round(duration * rate)) for duration in self.duration)
            return (torch.randint(fewest, most + 1, (num,), generator=generator) - 1).double() / rate
        spread = self.tempo_sd * (1.0 - self.tempo_dependence) ** 0.5
        return 0.5 * sum(self.duration) * (spread * _normal(generator, num)).exp()

    def stretch(self, width: float, height: float) -> float:
        """Factor by which a motion over a rectangle (px) takes longer than over one of average extent.

        Example:
            >>> person = CursorPerson(tempo_sd=0.4, tempo_dependence=0.9)
            >>> person.stretch(125.0, 125.0) < 1.0 < person.stretch(325.0, 325.0), CursorPerson().stretch(125.0, 125.0)
            (True, 1.0)
        """
        if not self.tempo_dependence or not self.tempo_sd:
            return 1.0
        logs = [math.log(self._way(*size)) for size in PAPER_SIZES]
        mean = sum(logs) / len(logs)
        deviation = (sum((value - mean) ** 2 for value in logs) / len(logs)) ** 0.5
        z = (math.log(self._way(width, height)) - mean) / deviation
        return math.exp(self.tempo_sd * self.tempo_dependence**0.5 * z)

    def _way(self, width: float, height: float) -> float:
        """Length of the polyline from the mean start over both upper corners to the mean end, px."""
        return math.dist(self.start, (-width / 2, height)) + width + math.dist((width / 2, height), self.end)

    def move(
        self, intention: Intention, width: float, height: float, rate: float, generator: torch.Generator
    ) -> Trajectory:
        """One motion for each intention, which may fail: (N, T, 2), padded with unseen samples.

        Args:
            intention: of N motions.
            width: of the rectangle, px.
            height: of the rectangle, px.
            rate: samples per second.
            generator: source of the variation of planning and of tremor.
        """
        left, right = self._via_points(len(intention.start), width, height, generator)
        points = torch.stack([intention.start, left, right, intention.end], -2)
        num_samples = (intention.duration * self.stretch(width, height) * rate).round().long().clamp_min(1) + 1
        durations = self._segment_durations(points, (num_samples - 1).double() / rate, generator)
        number = torch.arange(int(num_samples.max()))
        time = number.double() / rate
        plan = quintic_positions(minimum_jerk_states(points, durations), durations, time)
        values = plan + tremor(len(points), time, self.tremor, self.tremor_band, generator)
        mask = (number < num_samples[:, None])[..., None].expand(values.shape)
        return Trajectory(time, values, ("x", "y"), mask)

    def _via_points(self, num: int, width: float, height: float, generator: torch.Generator) -> tuple[Tensor, Tensor]:
        care = self.clearance_sd * _normal(generator, num, 1) + self.corner_sd * _normal(generator, num, 2)
        distance = self.clearance * care.exp()
        direction = torch.pi / 4 + self.direction_sd * _normal(generator, num, 2)
        outward, upward = distance * direction.cos(), distance * direction.sin()
        left = torch.stack([-width / 2 - outward[:, 0], height + upward[:, 0]], -1)
        right = torch.stack([width / 2 + outward[:, 1], height + upward[:, 1]], -1)
        return left, right

    def _segment_durations(self, points: Tensor, total: Tensor, generator: torch.Generator) -> Tensor:
        chords = points.diff(dim=-2).norm(dim=-1)
        rests = torch.tensor([self.rest_factor, 1.0, self.rest_factor], dtype=torch.float64)
        varied = rests * chords**self.exponent * (self.share_sd * _normal(generator, *chords.shape)).exp()
        return total[:, None] * varied / varied.sum(-1, keepdim=True)


def _normal(generator: torch.Generator, *shape: int) -> Tensor:
    return torch.randn(*shape, generator=generator, dtype=torch.float64)

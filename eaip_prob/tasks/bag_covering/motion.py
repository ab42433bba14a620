"""How a bag is carried over an object: the planned motion of the four points of its mouth.

The robot's right gripper and the partner's left hand hold one edge of the mouth low beside the object. The robot's left
gripper and the partner's right hand carry the other one: from beside the object over its top and down on the other side
(y from negative to positive). A carried point moves with least jerk through way-points (Todorov and Jordan, J.
Neurophysiol. 80, 1998: a spline of fifth degree): start, above the near edge, above the far edge, end. All are planned
on the upright box around the object with a clearance, so that the straight lip between both carried points clears it
wherever they are along x.

People look where they will reach and aim from the start, but the first thing they do, lifting the bag, is much the same
whatever it will cover. `cue` is the share of aim in it: for the first `AIMED` seconds (at the usual tempo) a hand moves
along (1 - cue) of the way it would take over a usual object and cue of the way over this one. With 0 the first second
tells nothing of the object, with 1 all that a motion of least jerk can tell. The default, 0.5, lies in the middle,
since the literature has both ends: kinematics tell intended targets apart early in a reach, and the first phase of
carrying something large is stereotyped.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from eaip_prob.errors import InputError
from eaip_prob.tasks.bag_covering.people import Partner
from eaip_prob.tasks.bag_covering.site import Site

RATE = 30.0  # samples a second, as of the cameras
CUE = 0.5  # share of aim in the first phase
AIMED = 1.2  # duration of the first phase at the usual tempo, s
_USUAL_BOX = ((-0.36, 0.36), -0.10)  # y of both sides and z of the top of what people are used to cover, m
_FLOOR = -0.93
_STATURE = 1.72  # m, of those whose hands start at the heights below
_ROBOT_START, _PARTNER_START = (0.42, -0.60, -0.15), (1.42, -0.60, -0.15)
_ROBOT_STILL, _PARTNER_STILL = (0.42, -0.74, -0.50), (1.42, -0.74, -0.50)
_END = 0.33  # height above the floor at which the carried edge is let hang, m
_LANE, _NEAREST, _FARTHEST = 0.14, 0.32, 0.48  # x of the robot's gripper: so far before the object, within limits, m
_BESIDE = 0.12  # distance of way-points from the object's sides, m
_PAUSE, _PER_METRE = 5.0, 2.3  # s, and s a metre of way: duration at the usual tempo
_SHARES = (0.38, 0.66)  # of the duration at which the way-points above the edges are passed
_SAMPLE_STD = {"start": 0.012, "clearance": 0.015, "gap": 0.02, "tempo": 0.04, "level": 0.012, "lag": 0.05}


@dataclass(frozen=True, eq=False)
class Covering:
    """One motion of both: where the mouth of the bag is held.

    Args:
        time: (T,), s.
        hands: (T, 2, 3), the partner's left (still) and right (carrying) hand, m.
        gripper: (T, 3), tip of the robot's left (carrying) gripper, m.
        still: (3,), tip of the robot's right gripper, m.
    """

    time: Float[np.ndarray, "time"]
    hands: Float[np.ndarray, "time hands 3"]
    gripper: Float[np.ndarray, "time 3"]
    still: Float[np.ndarray, "3"]

    @property
    def duration(self) -> float:
        """S."""
        return float(self.time[-1])


def planned(site: Site, partner: Partner, generator: np.random.Generator, cue: float = CUE) -> Covering:
    """How one partner and a demonstrator who leads the robot's left arm cover an object.

    The demonstrator keeps the lip level: the gripper follows the partner's plan with deviations of its own.

    Args:
        site: the object in its place.
        partner: who covers it.
        generator: of what differs from trial to trial.
        cue: share of aim in the first phase, 0 to 1.

    Raises:
        InputError: a cue outside 0 to 1.

    Example:
        >>> from eaip_prob.simulation import Bookshelf, Workspace
        >>> shelf = Bookshelf(0.4, 0.3, 0.9, 2, 0.018, (0.4, 0.25, 0.15), (0.3, 0.2, 0.1))
        >>> motion = planned(Site("shelf", "bookshelf", Workspace(shelf)), Partner(), np.random.default_rng(0))
        >>> motion.gripper[0].round(1).tolist(), motion.gripper[-1].round(1).tolist(), 8 < motion.duration < 12
        ([0.4, -0.6, -0.2], [0.5, 0.4, -0.6], True)
    """
    if not 0.0 <= cue <= 1.0:
        raise InputError(f"Expected cue from 0 to 1, got {cue}.")
    draw = {name: std * generator.standard_normal(3) for name, std in _SAMPLE_STD.items()}
    tall = 0.4 * (partner.stature - _STATURE)
    clearance, gap = partner.clearance + draw["clearance"][0], partner.gap + draw["gap"][0]
    outline = ((site.low[1], site.high[1]), site.high[2])
    tempo = partner.tempo * np.exp(draw["tempo"][0])

    boxes, drawn = (outline, _USUAL_BOX), (clearance, gap)
    start = np.array(_PARTNER_START) + [0.0, 0.0, tall] + draw["start"]
    actual, usual = (_Route(start, box, *drawn, start[0], partner, tempo) for box in boxes)
    time = np.arange(int(actual.duration * RATE) + 1) / RATE
    right = _carried(actual, usual, cue, AIMED * tempo, partner.lift, time)
    left = np.array(_PARTNER_STILL) + [0.0, 0.0, tall] + draw["start"] + _sway(time, generator)
    hands = np.stack([left, right], 1) + _tremor(partner.tremor, (len(time), 2, 3), generator)

    level, lane = draw["level"], float(np.clip(site.low[0] - _LANE, _NEAREST, _FARTHEST))
    start = np.array(_ROBOT_START) + [0.0, 0.0, tall] + draw["start"] + level
    led = (clearance + level[0], gap + level[1])
    actual, usual = (_Route(start, box, *led, lane, partner, tempo) for box in boxes)
    # The demonstrator reacts to the partner: a little late, and as sure of the object as the partner is.
    late = np.clip(time - abs(draw["lag"][0]), 0.0, None)
    gripper = _carried(actual, usual, cue, AIMED * tempo, partner.lift, late)
    return Covering(time, hands, gripper, np.array(_ROBOT_STILL))


class _Route:
    """The way of least jerk over a box from a start, with the time at which each way-point is passed."""

    def __init__(
        self, start: np.ndarray, box, clearance: float, gap: float, lane: float, partner: Partner, tempo: float
    ) -> None:
        (right, left), top = box
        above, end = top + clearance, _FLOOR + _END
        self.points = np.array(
            [
                start,
                [lane, right - _BESIDE, above],
                [lane, (right + left) / 2.0, above + partner.arch],
                [lane, left + _BESIDE, above],
                [lane, left + gap, end],
            ]
        )
        way = np.linalg.norm(np.diff(self.points, axis=0), axis=1).sum()
        self.duration = tempo * (_PAUSE + _PER_METRE * way)
        first, last = _SHARES
        self.times = self.duration * np.array([0.0, first, (first + last) / 2.0, last, 1.0])

    def state(self, time: float) -> np.ndarray:
        """(3, 3): position, velocity and acceleration."""
        spline = _least_jerk(self.times, self.points, np.zeros((2, 3)))
        return np.stack([spline(time, order) for order in range(3)])


def _carried(
    route: _Route, usual: _Route, cue: float, aimed: float, lift: float, time: np.ndarray
) -> Float[np.ndarray, "time 3"]:
    """A first phase that is partly habit, then the way over the object from where that led to."""
    from scipy.interpolate import BPoly

    turn = (1.0 - cue) * usual.state(aimed) + cue * route.state(aimed)
    turn[0, 2] += lift
    first = BPoly.from_derivatives([0.0, aimed], [[route.points[0], np.zeros(3), np.zeros(3)], list(turn)])
    rest = _least_jerk(np.append(aimed, route.times[1:]), np.vstack([turn[0], route.points[1:]]), turn[1:])
    within = np.minimum(time, route.duration)
    return np.where((within < aimed)[:, None], first(np.minimum(within, aimed)), rest(np.maximum(within, aimed)))


def _least_jerk(times: np.ndarray, points: np.ndarray, begin: np.ndarray):
    """The spline of fifth degree through points, from a velocity and acceleration to rest."""
    from scipy.interpolate import make_interp_spline

    return make_interp_spline(
        times, points, k=5, bc_type=([(1, begin[0]), (2, begin[1])], [(1, np.zeros(3)), (2, np.zeros(3))])
    )


def _sway(time: np.ndarray, generator: np.random.Generator) -> Float[np.ndarray, "time 3"]:
    """How a hand drifts that only holds on: a centimetre within some seconds."""
    phase, period = generator.uniform(0.0, 2.0 * np.pi, 3), generator.uniform(4.0, 8.0, 3)
    return 0.008 * (np.sin(2.0 * np.pi * time[:, None] / period + phase) - np.sin(phase))


def _tremor(std: float, shape: tuple[int, ...], generator: np.random.Generator) -> np.ndarray:
    """Trembling of 8 Hz or so: noise that is correlated over two samples."""
    noise = generator.standard_normal((shape[0] + 2, *shape[1:]))
    return std * (noise[2:] - noise[:-2]) / np.sqrt(2.0)

"""A bag that four hands hold: how it hangs, is carried over an object and drapes on it.

Position-based dynamics: vertices fall, edges are put back to their length, and what is in the floor or in the object is
put out. `init` gives a state and `step` makes the next one of it; nothing else is remembered, and nothing is random.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from jaxtyping import Float, Int64

from eaip_prob.errors import InputError, ShapeError
from eaip_prob.simulation.cloth_contact import Obstacle
from eaip_prob.simulation.cloth_mesh import BagMesh
from eaip_prob.simulation.meshes import Color, Mesh

_GRAVITY = 9.81  # m/s^2
_SUBSTEP = 1.0 / 1500.0  # s; at 1/600 s edges stretch about twice as much
_SETTLING, _SETTLING_DRAG = 3.0, 10.0  # s, 1/s: thick air, or the bag would swing through under the hands
_NOWHERE = -1e3  # m, a floor that nothing reaches


@dataclass(frozen=True, eq=False)
class ClothState:
    """A bag at one time.

    Args:
        position: (V, 3), of its vertices, m.
        velocity: (V, 3), m/s.
        held: (4,), vertices in the robot's left and right and the partner's left and right hand.

    Example:
        >>> ClothState(np.zeros((9, 3)), np.zeros((9, 3)), np.array([7, 1, 3, 5])).position.shape
        (9, 3)
    """

    position: Float[np.ndarray, "vertices 3"]
    velocity: Float[np.ndarray, "vertices 3"]
    held: Int64[np.ndarray, "handles"]


@dataclass(frozen=True)
class ClothBag:
    """A bag of thin film, closed at one end; its mouth runs from hand to hand.

    Handles are given in the order robot's left, robot's right, partner's left, partner's right hand, which is the order
    along the mouth. Robot's left and partner's right hand carry one edge of it, the other two hold the other edge.
    The hands take the mouth where each of these edges is a little longer than they are apart; what is left of it
    hangs between the two hands of the robot, and between those of the partner.

    Args:
        perimeter: of the mouth, m.
        length: from the mouth to the closed end, m.
        spacing: between neighbouring vertices, m.
        slack: least share by which an edge is longer than the hands that hold it are apart at first.
        thickness: distance that vertices keep from object and floor, m.
        friction: Coulomb's coefficient on object and floor.
        drag: of the air, share of the velocity lost in a second, for short times, 1/s.
        color: RGB from 0 to 1.

    Raises:
        InputError: lengths not above zero, other numbers below zero.

    Example:
        >>> bag = ClothBag(perimeter=2.4, length=0.4, spacing=0.1)
        >>> hands = np.array([[0.4, -0.5, 0.3], [0.4, -0.5, 0.1], [0.9, -0.5, 0.1], [0.9, -0.5, 0.3]])
        >>> state = bag.init(hands)
        >>> state = bag.step(state, hands + [0.0, 0.01, 0.0], 1 / 30, Obstacle(floor=-0.93))
        >>> state.position[state.held][0].round(9).tolist(), bag.stretch(state) < 0.1
        ([0.4, -0.49, 0.3], True)
        >>> float(bag.mesh(state).extent()[0, 2].round(1))
        -0.2
    """

    perimeter: float = 5.6
    length: float = 1.2
    spacing: float = 0.1
    slack: float = 0.05
    thickness: float = 0.025
    friction: float = 0.1
    drag: float = 3.0
    color: Color = (0.80, 0.82, 0.86)

    def __post_init__(self) -> None:
        shares = {name: getattr(self, name) for name in ("slack", "thickness", "friction", "drag")}
        if not all(0.0 <= value < np.inf for value in shares.values()):
            raise InputError(f"Expected slack, thickness, friction and drag finite and not below zero, got {shares}.")
        _ = self.layout

    @cached_property
    def layout(self) -> BagMesh:
        """Vertices, edges and triangles."""
        return BagMesh(self.perimeter, self.length, self.spacing)

    def init(self, handles: Float[np.ndarray, "handles 3"], obstacle: Obstacle | None = None) -> ClothState:
        """The bag after it has hung from the handles for three seconds, on that side of the mouth where it starts.

        It starts at right angles to the mouth: outwards (-y) where the carrying hands are above the others, upwards
        where they are to the left (+y) of them.

        Args:
            handles: (4, 3), robot's left and right, partner's left and right hand, m.
            obstacle: what it hangs beside or rests on; nothing if None.

        Raises:
            ShapeError: handles of another shape.
            InputError: handles that are not finite, or so far apart that the mouth does not reach.
        """
        handles = _checked(handles)
        apart = np.linalg.norm(handles[[3, 2]] - handles[[0, 1]], axis=1)
        held = self.layout.held(float(apart.max()) * (1.0 + self.slack))
        side = 2 * held[1] * self.perimeter / self.layout.num_columns  # of the robot; the partner's is no shorter
        sides = np.linalg.norm(handles[[1, 3]] - handles[[0, 2]], axis=1)
        if sides.max() > side:
            raise InputError(
                f"Expected the two hands of the robot, and those of the partner, at most {side:.3g} m apart, which is "
                f"what the mouth leaves them, got {sides.max():.3g} m. Bring them together, or enlarge the perimeter."
            )
        position = self.layout.straight(handles, held)
        position[held] = handles
        state = ClothState(position, np.zeros_like(position), held)
        return self._advanced(state, handles, _SETTLING, obstacle or Obstacle(_NOWHERE), _SETTLING_DRAG)

    def step(
        self, state: ClothState, handles: Float[np.ndarray, "handles 3"], dt: float, obstacle: Obstacle
    ) -> ClothState:
        """The bag a moment later; the handles go straight to where they are told to be.

        Args:
            state: now.
            handles: (4, 3), at the end of the step, as for `init`, m.
            dt: s, above zero.
            obstacle: what the bag touches.

        Raises:
            ShapeError: handles of another shape, or a state of another bag.
            InputError: handles that are not finite, or no time.
        """
        handles = _checked(handles)
        if not 0.0 < dt < np.inf:
            raise InputError(f"Expected dt above zero and finite, got {dt} s.")
        self._check(state)
        return self._advanced(state, handles, dt, obstacle, self.drag)

    def _advanced(
        self, state: ClothState, handles: np.ndarray, dt: float, obstacle: Obstacle, drag: float
    ) -> ClothState:
        # Numba is imported by those who move a cloth only.
        from eaip_prob.simulation._cloth_loops import advance

        position, velocity = state.position.copy(), state.velocity.copy()
        free = np.ones(len(position))
        free[state.held] = 0.0
        num = max(int(np.ceil(dt / _SUBSTEP - 1e-6)), 1)
        advance(
            *(position, velocity, free, state.held, position[state.held], handles),
            *(*self.layout.edges, self.layout.triangles, np.ascontiguousarray(obstacle.planes, float)),
            *(float(obstacle.floor), (_GRAVITY, drag, self.friction, self.thickness), dt / num, num),
        )
        return ClothState(position, velocity, state.held)

    def mesh(self, state: ClothState) -> Mesh:
        """The bag's triangles, for images and rays.

        Args:
            state: of this bag.
        """
        self._check(state)
        triangles = self.layout.triangles.astype(np.int32)
        return Mesh(state.position, triangles, np.tile(np.asarray(self.color, np.float32), (len(triangles), 1)))

    def stretch(self, state: ClothState) -> float:
        """Share by which the edge that is stretched most is longer than at rest.

        In forty sweeps of ten seconds over the training objects it stayed below 0.12, for other paths below 0.21 where
        the edge that was carried caught on the object for a moment; of a bag that was held back it went past 0.4.

        Args:
            state: of this bag.
        """
        self._check(state)
        edges, rest = self.layout.edges
        one, other = state.position[edges.T]
        return float((np.linalg.norm(other - one, axis=1) / rest).max() - 1.0)

    def _check(self, state: ClothState) -> None:
        if state.position.shape != (self.layout.num_vertices, 3):
            raise ShapeError(
                f"Expected a state of this bag's {self.layout.num_vertices} vertices, got positions with shape "
                f"{state.position.shape}. Start with init."
            )


def _checked(handles: np.ndarray) -> np.ndarray:
    handles = np.ascontiguousarray(handles, float)
    if handles.shape != (4, 3):
        raise ShapeError(
            f"Expected handles with shape (4, 3), robot's left and right, partner's left and right hand, got "
            f"{handles.shape}."
        )
    if not np.isfinite(handles).all():
        raise InputError("Expected handles that are finite, got NaN or infinity. Hold the last place of a lost hand.")
    return handles

"""Dynamic movement primitives (Ijspeert et al., 2013) in the paper's form, Eq. 1-4, affine in their weights.

Per signal the weights are [w, g, y0, v0]: forcing weights, goal, start, start velocity (units per second).
"""

from __future__ import annotations

from dataclasses import dataclass

import torch
from jaxtyping import Bool, Float
from torch import Tensor

from eaip_prob.checks import as_float64, check_positive
from eaip_prob.data.trajectory import Trajectory
from eaip_prob.errors import InputError
from eaip_prob.primitives.attractor import AttractorParameters, Response, attractor_response, free_response
from eaip_prob.primitives.base import AbstractPrimitive, Boundary
from eaip_prob.primitives.basis import forcing_basis
from eaip_prob.primitives.differences import advancing, matrix_from_rules, three_point_rules
from eaip_prob.primitives.least_squares import evenly, mean_power, ridge_fit


@dataclass(frozen=True)
class DMP(AbstractPrimitive):
    """Attractor to a goal with a learnt forcing term.

        y'' = alpha_y (beta_y (g - y) - y') + phi(x)^T w,   x = exp(-alpha_x s),   ' = d / d phase

    With `boundary="learned"` the start is part of the weights, [w, g, y0, v0], and motions are encoded by least squares
    on positions. With `boundary="given"` the weights are the paper's [w, g]; w comes from the forces (Eq. 3, 4), g is
    the last value, and the start is given when a motion is decoded.

    Args:
        num_basis: forcing bases of one signal, at least 2.
        alpha_y: damping; the attractor is critically damped with beta_y = alpha_y / 4.
        beta_y: stiffness over damping.
        alpha_x: decay of the canonical system; x falls to exp(-alpha_x) over a motion.
        ridge: of the encoder, relative to each basis' mean square over [0, limit].
        overlap: width of a basis in units of the distance to the next centre.
        boundary: "learned" or "given".
        limit: last phase that the bases span.

    Raises:
        InputError: constants that are not positive, a negative ridge, or another word for `boundary`.
    """

    limit: float = 1.0
    num_basis: int = 20
    alpha_y: float = 25.0
    beta_y: float = 6.25
    alpha_x: float = 3.0
    ridge: float = 1e-6
    overlap: float = 1.0
    boundary: str = "learned"

    def __post_init__(self) -> None:
        if self.boundary not in ("learned", "given"):
            raise InputError(f"Expected boundary 'learned' or 'given', got {self.boundary!r}.")
        if self.num_basis < 2 or self.ridge < 0:
            raise InputError(
                f"Expected num_basis of at least 2 and ridge of at least 0, got {self.num_basis} and {self.ridge}."
            )
        for name in ("alpha_y", "beta_y", "alpha_x", "limit", "overlap"):
            check_positive(name, getattr(self, name))

    @property
    def num_weights(self) -> int:
        """B + 1 with the start given, B + 3 with it learned."""
        return self.num_basis + (1 if self.needs_boundary else 3)

    @property
    def needs_boundary(self) -> bool:
        """Whether the start is given rather than learned."""
        return self.boundary == "given"

    @property
    def _response(self) -> Response:
        return attractor_response(
            AttractorParameters(self.num_basis, self.limit, self.alpha_y, self.beta_y, self.alpha_x, self.overlap)
        )

    def rows(
        self,
        phase: Float[Tensor, "*#batch time"],
        duration: Float[Tensor, "*#batch"],
        boundary: Boundary | None,
        order: int,
    ) -> tuple[Tensor, Tensor]:
        """See `AbstractPrimitive.rows`."""
        columns = self._response.at(phase, order)
        if not self.needs_boundary:
            return _times_duration(columns, duration), columns.new_zeros(1, 1)
        if boundary is None:
            raise InputError(
                "Expected a Boundary (start and velocity), got None: this DMP's weights do not hold the start."
            )
        state = torch.stack(torch.broadcast_tensors(boundary.start, boundary.velocity * duration[..., None]), -1)
        return columns[..., :-2], state @ columns[..., -2:].mT

    def encode(
        self, trajectory: Trajectory, phase: Float[Tensor, "*#batch time"], duration: Tensor | float
    ) -> Float[Tensor, "*batch weights"]:
        """Least squares on positions (start learned), or on forces as in Eq. 3 and 4 (start given)."""
        if self.needs_boundary:
            return self._encode_forces(trajectory, phase)
        # By phase the design does not depend on the duration: one for all motions on one clock.
        matrix, _ = self.design(phase, 1.0)
        rest = matrix.new_zeros(self.num_weights)
        rest[self.num_basis : self.num_basis + 2] = 1.0
        ridge = self.ridge * mean_power(self.design(evenly(self.limit), 1.0)[0])
        weights = ridge_fit(matrix, trajectory.values, trajectory.mask, ridge, rest)
        return _times_duration(weights, 1.0 / as_float64("duration", duration)).flatten(-2)

    def _encode_forces(self, trajectory: Trajectory, phase: Tensor) -> Tensor:
        """Fits phi(x)^T w to the forces left when the goal's pull is taken off: those of y - g."""
        values, mask, goal = trajectory.values, trajectory.mask, _last_seen(trajectory)[..., None, :]
        basis = self.forcing_design(phase)[..., : self.num_basis]
        ridge = self.ridge * mean_power(self.forcing_design(evenly(self.limit))[:, : self.num_basis])
        if phase.ndim == 1 and bool(mask.all()):
            # One matrix for all motions: the weights of a unit displacement at each sample.
            unit = torch.eye(phase.shape[-1], dtype=torch.float64)
            per_sample = ridge_fit(basis, *self.forces(unit, unit >= 0, phase), ridge)
            weights = values.mT @ per_sample - goal.mT * per_sample.sum(0)
        else:
            weights = ridge_fit(basis, *self.forces(values - goal, mask, phase), ridge)
        return torch.cat([weights, goal.mT], -1).flatten(-2)

    def forces(
        self,
        values: Float[Tensor, "*#batch time signals"],
        mask: Bool[Tensor, "*#batch time signals"],
        phase: Float[Tensor, "*#batch time"],
    ) -> tuple[Float[Tensor, "*batch time signals"], Bool[Tensor, "*batch time signals"]]:
        """(forces f* of Eq. 12, where they are known): y'' + alpha_y (beta_y y + y'), derivatives by phase.

        A force uses its sample and the neighbours; it is known where all three were seen and the phase grew.

        Args:
            values: positions.
            mask: True where a sample was seen.
            phase: of each sample, at least three.

        Raises:
            InputError: fewer than three samples.
        """
        used, coefficients, moves = self._force_rules(phase)
        force = sum(coefficients[..., k, None] * values[..., used[:, k], :] for k in range(3))
        seen = mask & moves[..., None]
        known = seen[..., used[:, 0], :] & seen[..., used[:, 1], :] & seen[..., used[:, 2], :]
        return torch.where(known, force, 0.0), known

    def force_operator(self, phase: Float[Tensor, "*batch time"]) -> Float[Tensor, "*batch time time"]:
        """Matrix from positions to forces, by three-point differences in phase."""
        used, coefficients, _ = self._force_rules(phase)
        return matrix_from_rules(used, coefficients)

    def _force_rules(self, phase: Tensor) -> tuple[Tensor, Tensor, Tensor]:
        points, moves = advancing(as_float64("phase", phase))
        used, first, second = three_point_rules(points)
        own = used == torch.arange(points.shape[-1])[:, None]
        return used, second + self.alpha_y * first + self.alpha_y * self.beta_y * own, moves

    def forcing_design(self, phase: Float[Tensor, "*batch time"]) -> Float[Tensor, "*batch time basis"]:
        """Rows [phi(x)^T, alpha_y beta_y] of Eq. 13 on [w, g]; the start has no part in a force."""
        basis = forcing_basis(phase, self.num_basis, self.limit, self.alpha_x, self.overlap)
        goal = basis.new_full((*basis.shape[:-1], 1), self.alpha_y * self.beta_y)
        rest = basis.new_zeros(*basis.shape[:-1], self.num_weights - self.num_basis - 1)
        return torch.cat([basis, goal, rest], -1)

    def rollout(
        self,
        weights: Float[Tensor, "*batch weights"],
        present: Boundary,
        from_phase: Tensor | float,
        phase: Float[Tensor, "*#batch time"],
        duration: Tensor | float,
    ) -> Float[Tensor, "*batch time signals"]:
        """Positions of the running attractor from the state where the robot really is.

        Eq. 1 is linear: the state's distance from the motion decays as the free response, behind the limit too.

        Args:
            weights: (*batch, K); a start held in them does not matter.
            present: position and velocity (units per second) at `from_phase`.
            from_phase: (*batch,), phase at which the robot takes over.
            phase: (*batch, T), phases from `from_phase` on.
            duration: time in which the phase grows by 1, seconds.

        Example:
            >>> dmp, phase = DMP(num_basis=5), torch.tensor([0.5, 1.0, 2.0])
            >>> weights = torch.tensor([0.0, 0.0, 0.0, 0.0, 0.0, 3.0, 3.0, 0.0])
            >>> pushed = Boundary(start=torch.tensor([3.4]), velocity=torch.tensor([0.0]))
            >>> dmp.rollout(weights, pushed, 0.5, phase, duration=2.0)[:, 0].round(decimals=3)
            tensor([3.4000, 3.0060, 3.0000], dtype=torch.float64)
        """
        phase, from_phase = as_float64("phase", phase), as_float64("from_phase", from_phase)[..., None]
        zero = Boundary(phase.new_zeros(1), phase.new_zeros(1)) if self.needs_boundary else None
        start = present.start - self.decode(weights, from_phase, duration, zero)[..., 0, :]
        velocity = present.velocity - self.velocity(weights, from_phase, duration, zero)[..., 0, :]
        apart = torch.stack([start, velocity * as_float64("duration", duration)[..., None]], -1)
        free = free_response(phase - from_phase, self.alpha_y, self.beta_y)
        return self.decode(weights, phase, duration, zero) + (apart @ free.mT).mT


def _times_duration(
    columns: Float[Tensor, "*#batch rows weights"], duration: Float[Tensor, "*#batch"]
) -> Float[Tensor, "*batch rows weights"]:
    """The last column, of the start velocity, times the duration."""
    duration = duration[..., None, None]
    if columns.shape[:-2] == duration.shape[:-2]:
        return torch.cat([columns[..., :-1], columns[..., -1:] * duration], -1)
    batch = torch.broadcast_shapes(columns.shape[:-2], duration.shape[:-2])
    return torch.cat(
        [columns[..., :-1].expand(*batch, -1, -1), (columns[..., -1:] * duration).expand(*batch, -1, -1)], -1
    )


def _last_seen(trajectory: Trajectory) -> Float[Tensor, "*batch signals"]:
    """Value of each signal at its last seen sample, 0 where it was never seen."""
    values, mask = trajectory.values, trajectory.mask
    if bool(mask[..., -1, :].all()):
        return values[..., -1, :]
    last = torch.where(mask, torch.arange(mask.shape[-2])[:, None], 0).amax(-2, keepdim=True)
    return values.gather(-2, last)[..., 0, :]

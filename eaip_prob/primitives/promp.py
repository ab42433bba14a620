"""Probabilistic movement primitives (Paraschos et al., 2013): positions linear in the weights of Gaussian bases."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

from jaxtyping import Float
from torch import Tensor

from eaip_prob.checks import check_positive
from eaip_prob.data.trajectory import Trajectory
from eaip_prob.errors import InputError
from eaip_prob.primitives.base import AbstractPrimitive, Boundary
from eaip_prob.primitives.basis import phase_basis
from eaip_prob.primitives.least_squares import evenly, mean_power, ridge_fit


@dataclass(frozen=True)
class ProMP(AbstractPrimitive):
    """y(s) = psi(s)^T w with normalised Gaussian bases in phase.

    Args:
        num_basis: bases of one signal, at least 4, centred evenly from one spacing before 0 to one after `limit`.
        ridge: of the encoder, relative to each basis' mean square over [0, limit].
        overlap: width of a basis in units of the spacing of the centres.
        limit: last phase that the bases span.

    Raises:
        InputError: too few bases, a negative ridge, or an overlap or limit that is not positive.

    Example:
        >>> import torch
        >>> phase = torch.linspace(0.0, 1.0, 50, dtype=torch.float64)
        >>> line, promp = Trajectory(time=2.0 * phase, values=5.0 * phase[:, None]), ProMP(num_basis=10)
        >>> weights = promp.encode(line, phase, duration=2.0)
        >>> bool((promp.decode(weights, phase) - line.values).abs().max() < 1e-3)
        True
    """

    weights_are_positions: ClassVar[bool] = True
    limit: float = 1.0
    num_basis: int = 20
    ridge: float = 1e-6
    overlap: float = 1.0

    def __post_init__(self) -> None:
        if self.num_basis < 4 or self.ridge < 0:
            raise InputError(
                f"Expected num_basis of at least 4 and ridge of at least 0, got {self.num_basis} and {self.ridge}."
            )
        check_positive("limit", self.limit)
        check_positive("overlap", self.overlap)

    @property
    def num_weights(self) -> int:
        """B."""
        return self.num_basis

    def rows(
        self,
        phase: Float[Tensor, "*#batch time"],
        duration: Float[Tensor, "*#batch"],
        boundary: Boundary | None,
        order: int,
    ) -> tuple[Tensor, Tensor]:
        """See `AbstractPrimitive.rows`; neither the duration nor a start matters."""
        return phase_basis(phase, self.num_basis, self.limit, self.overlap, order), phase.new_zeros(1, 1)

    def encode(
        self, trajectory: Trajectory, phase: Float[Tensor, "*#batch time"], duration: Tensor | float
    ) -> Float[Tensor, "*batch weights"]:
        """Ridge least squares on the seen samples."""
        basis, _ = self.design(phase)
        ridge = self.ridge * mean_power(self.design(evenly(self.limit))[0])
        rest = basis.new_ones(self.num_basis)
        return ridge_fit(basis, trajectory.values, trajectory.mask, ridge, rest).flatten(-2)

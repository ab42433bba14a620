"""A path that is known beforehand in the form of a prediction: to check and to execute what no model predicted."""

from __future__ import annotations

from collections.abc import Sequence

import torch

from eaip_prob.checks import as_float64, check_finite, check_type
from eaip_prob.data.trajectory import Trajectory
from eaip_prob.errors import InputError, ShapeError
from eaip_prob.forecast import Prediction
from eaip_prob.gaussian import BlockGaussian, BlockLayout
from eaip_prob.models import Posterior
from eaip_prob.phase import PhaseEstimate
from eaip_prob.primitives import DMP, AbstractPrimitive


def known_path(
    motion: Trajectory, std: float | Sequence[float] = 0.0, primitive: AbstractPrimitive | None = None
) -> Prediction:
    """A recorded or planned motion as a prediction, each signal displaced as a whole by an unknown amount.

    Args:
        motion: one whole motion, sampled so densely that a primitive says the same in between.
        std: standard deviation of the displacement, one for all signals or one each, in their units.
        primitive: that represents the motion, with its start among the weights; default `DMP()`.

    Raises:
        InputError: a deviation that is negative or not finite, or a primitive whose weights do not hold the start.
        ShapeError: a batch of motions, or another number of deviations than of signals.

    Example:
        >>> share = torch.linspace(0.0, 1.0, 30)[:, None]
        >>> sweep = torch.tensor([0.4, -0.6, 0.3]) + share**2 * (3.0 - 2.0 * share) * torch.tensor([0.0, 1.2, 0.0])
        >>> path = known_path(Trajectory(8.0 * share[:, 0], sweep, ("x", "y", "z")), std=(0.0, 0.0, 0.02))
        >>> path.mean[-1].round(decimals=3).tolist(), path.variance[1].sqrt().round(decimals=3).tolist()
        ([0.4, 0.6, 0.3], [0.0, 0.0, 0.02])
    """
    check_type("motion", motion, Trajectory, "Make one with Trajectory(time, values, names).")
    primitive = DMP() if primitive is None else primitive
    deviation = _checked(motion, std, primitive)
    phase = PhaseEstimate.linear(motion.time, motion.duration)
    along = phase.paths[0]
    mean = primitive.encode(motion, along, phase.duration[0])
    # What a displacement by 1 does to the weights of one signal, whatever the primitive.
    unit = Trajectory(motion.time, torch.ones(motion.num_samples, 1))
    root = torch.kron(torch.diag(deviation), primitive.encode(unit, along, phase.duration[0])[:, None])
    components = BlockGaussian(mean[None], (root @ root.mT)[None], BlockLayout({"robot": len(mean)}))
    one = torch.zeros(1, dtype=torch.float64)
    exact = torch.zeros(motion.num_signals, dtype=torch.float64)
    return Prediction(
        motion.time, Posterior(components, one, one[0]), phase, primitive, "robot", motion.names, residual=exact
    )


def _checked(motion: Trajectory, std: float | Sequence[float], primitive: AbstractPrimitive) -> torch.Tensor:
    """The deviations (D,)."""
    if motion.batch_shape:
        raise ShapeError(f"Expected one motion, got a batch {tuple(motion.batch_shape)}. Take one with motion[0].")
    if primitive.needs_boundary:
        raise InputError("Expected a primitive whose weights hold the start. Use DMP(boundary='learned') or ProMP().")
    deviation = as_float64("std", std)
    if deviation.shape not in ((), (motion.num_signals,)):
        raise ShapeError(f"Expected std as one number or {motion.num_signals}, got shape {tuple(deviation.shape)}.")
    check_finite("std", deviation, advice="Give standard deviations in the signals' units.")
    if bool((deviation < 0).any()):
        raise InputError(f"Expected std of at least 0, got {std}.")
    return deviation.expand(motion.num_signals)

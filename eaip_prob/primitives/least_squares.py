"""Masked ridge least squares, batched over motions and signals: the encoder behind every primitive."""

from __future__ import annotations

import torch
from jaxtyping import Bool, Float
from torch import Tensor

from eaip_prob.errors import InputError, ShapeError
from eaip_prob.linalg import safe_cholesky


def ridge_fit(
    design: Float[Tensor, "*#batch time basis"],
    values: Float[Tensor, "*batch time signals"],
    mask: Bool[Tensor, "*batch time signals"],
    ridge: Float[Tensor, "basis"],
    rest: Float[Tensor, "basis"] | None = None,
) -> Float[Tensor, "*batch signals basis"]:
    """Weights that reproduce the samples seen, w = (A^T M A / n + diag(ridge))^-1 A^T M y / n (Eq. 4, stabilised).

    M selects the n samples seen. With `rest` the ridge shrinks towards rest at their mean, so that the weights follow
    the origin as they follow the units.

    Args:
        design: shared by the signals; shared by the batch where it has no batch axes.
        values: samples, entries where the mask is False are not read.
        mask: True where a sample was seen.
        ridge: (B,), in the units of the design squared; zeros for plain least squares.
        rest: (B,), weights with which the design gives 1 everywhere.

    Raises:
        InputError: a signal without any seen sample.
        ShapeError: another number of samples than rows of the design.

    Example:
        >>> design = torch.tensor([[1.0, 0.0], [1.0, 1.0], [1.0, 2.0]], dtype=torch.float64)
        >>> values = torch.tensor([[5.0], [7.0], [9.0]], dtype=torch.float64)
        >>> ridge_fit(design, values, values > 0, ridge=torch.zeros(2)).round(decimals=9)
        tensor([[5., 2.]], dtype=torch.float64)
    """
    if design.shape[-2] != values.shape[-2]:
        raise ShapeError(
            f"Expected as many phases as samples, got {design.shape[-2]} phases for {values.shape[-2]} samples."
        )
    if design.ndim == 2 and mask.numpy().all():  # torch reads a boolean at a time
        return _applied(_encoder(design, torch.diag(ridge), rest), values)
    _check_seen(mask)
    return _masked_fit(design, values, mask, torch.diag(ridge), rest)


def evenly(limit: float) -> Float[Tensor, "time"]:
    """Phases that cover [0, limit] evenly."""
    return torch.linspace(0.0, limit, 201, dtype=torch.float64)


def mean_power(design: Float[Tensor, "time basis"]) -> Float[Tensor, "basis"]:
    """Mean square of each basis: a ridge in proportion to it does not depend on units, nor on the samples seen."""
    return design.square().mean(-2)


def _check_seen(mask: Tensor) -> None:
    unseen = ~mask.any(-2)
    if bool(unseen.any()):
        at = tuple(int(i) for i in unseen.nonzero()[0])
        raise InputError(
            f"Expected at least one seen sample of every signal to encode (three in a row where forces are encoded), "
            f"got none for (motion.., signal) {at}. Leave that demonstration out or drop the signal."
        )


def _encoder(design: Tensor, ridge: Tensor, rest: Tensor | None) -> Float[Tensor, "basis time"]:
    """One matrix from complete samples to weights, for all motions and signals."""
    num_samples = design.shape[-2]
    factor = safe_cholesky(design.mT @ design / num_samples + ridge, "normal matrix of the bases")
    encoder = torch.cholesky_solve(design.mT, factor) / num_samples
    if rest is None:
        return encoder
    return encoder + ((rest - encoder.sum(-1)) / num_samples)[:, None]


def _applied(encoder: Tensor, values: Tensor) -> Float[Tensor, "*batch signals basis"]:
    """One product for all motions; `values.mT @ encoder.mT` means the same and takes twice as long."""
    samples = values.mT.reshape(-1, values.shape[-2])
    return (encoder @ samples.mT).mT.reshape(*values.shape[:-2], values.shape[-1], len(encoder))


def _masked_fit(design: Tensor, values: Tensor, mask: Tensor, ridge: Tensor, rest: Tensor | None) -> Tensor:
    weight = mask.to(torch.float64) / mask.sum(-2, keepdim=True)
    values = torch.where(mask, values, 0.0)
    mean = (weight * values).sum(-2, keepdim=True)
    right = design.mT @ (weight * (values if rest is None else values - mean))
    # Signals seen together, as in a padded batch, share one factor.
    weight = weight[..., :1] if bool((mask == mask[..., :1]).all()) else weight
    normal = _normal(design, weight) + ridge
    grouped = right.mT.unflatten(-2, (weight.shape[-1], -1)).mT
    solved = torch.cholesky_solve(grouped, safe_cholesky(normal, "normal matrix of the bases"))
    weights = solved.mT.flatten(-3, -2)
    return weights if rest is None else weights + mean.mT * rest


def _normal(design: Tensor, weight: Tensor) -> Float[Tensor, "*batch signals basis basis"]:
    """A^T diag(weight) A for each column of weights."""
    num_basis = design.shape[-1]
    if design.ndim == 2:
        products = (design[:, :, None] * design[:, None, :]).flatten(-2)
        return (weight.mT @ products).unflatten(-1, (num_basis, num_basis))
    design = design[..., None, :, :]
    return (design * weight.mT[..., None]).mT @ design

"""Evidence as linear-Gaussian observations of blocks of weights.

    y = A theta + offset + noise,  noise ~ N(0, R)

What an observation says about the weights is A^T R^-1 A and A^T R^-1 (y - offset - A m), so that conditioning costs the
same however long the observation is. Unobserved rows carry precision zero, which equals selecting the observed rows
first; their values, offsets and noise are never read and may hold anything, NaN included.

Letters: M rows, K weights of a block, T samples, D signals, B weights of one signal (K = D B, signal-major).
"""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections.abc import Mapping
from dataclasses import dataclass

import torch
from jaxtyping import Bool, Float
from torch import Tensor

from eaip_prob.checks import as_bool, as_float64, check_finite, check_shape
from eaip_prob.conditioning import LOG_2PI, Information, correlated_terms, white_information_alone, white_terms
from eaip_prob.errors import InputError, ShapeError
from eaip_prob.linalg import single_arrays


class AbstractObservation(ABC):
    """One piece of evidence; a subclass names its blocks and says what it knows about their weights.

    In return `BlockGaussian.condition` accepts it beside any other observation.
    """

    @property
    @abstractmethod
    def num_columns(self) -> Mapping[str, int]:
        """Number of weights of each block that the observation touches."""

    @property
    def blocks(self) -> tuple[str, ...]:
        """Blocks that the observation touches."""
        return tuple(self.num_columns)

    @abstractmethod
    def information(self, mean: Mapping[str, Tensor]) -> Information | None:
        """Information around the given block means, blocks in the order of `self.blocks`.

        None where a row is observed without noise, which has no finite precision.
        """

    @abstractmethod
    def dense(self) -> LinearObservation:
        """The same observation with its rows written out."""


@dataclass(frozen=True, eq=False)
class LinearObservation(AbstractObservation):
    """Rows written out: a via-point, a detected object, a relation between two agents.

    Args:
        matrices: {block: (*batch, M, K_block)}.
        offset: (*batch, M).
        value: (*batch, M), the observed y.
        noise: (*batch, M) variances, or (*batch, M, M) a covariance when `correlated`.
        mask: (*batch, M), False rows were not observed; default all were.
        correlated: whether `noise` is a covariance.

    Raises:
        ShapeError: rows do not match.
        InputError: NaN, infinity, or a negative variance.

    Example:
        >>> via = LinearObservation({"robot": torch.eye(2)}, torch.zeros(2), torch.ones(2), torch.zeros(2))
        >>> via.blocks
        ('robot',)
    """

    matrices: Mapping[str, Float[Tensor, "*#batch rows weights"]]
    offset: Float[Tensor, "*#batch rows"]
    value: Float[Tensor, "*#batch rows"]
    noise: Float[Tensor, "*#batch rows"] | Float[Tensor, "*#batch rows rows"]
    mask: Bool[Tensor, "*#batch rows"] | None = None
    correlated: bool = False

    def __post_init__(self) -> None:
        value = as_float64("value", self.value)
        if not self.matrices or value.ndim == 0:
            raise InputError("Expected at least one block and a value with shape (*batch, M) in an observation.")
        rows = value.shape[-1]
        matrices = {block: as_float64(f"matrices[{block!r}]", matrix) for block, matrix in self.matrices.items()}
        for block, matrix in matrices.items():
            if matrix.ndim < 2:
                raise ShapeError(
                    f"Expected matrices[{block!r}] with shape (*batch, {rows}, K), got {tuple(matrix.shape)}."
                )
            check_shape(f"matrices[{block!r}]", matrix, [rows, "K"])
            check_finite(f"matrices[{block!r}]", matrix)
        mask = None if self.mask is None else as_bool("mask", self.mask)
        if mask is not None:
            check_shape("mask", mask, [rows])
        offset, noise = as_float64("offset", self.offset), as_float64("noise", self.noise)
        check_shape("offset", offset, [rows])
        check_shape("noise", noise, [rows, rows] if self.correlated else [rows])
        _check_seen(value, offset, noise, mask, self.correlated)
        for key, field in {
            "matrices": matrices,
            "offset": offset,
            "value": value,
            "noise": noise,
            "mask": mask,
        }.items():
            object.__setattr__(self, key, field)

    @property
    def num_columns(self) -> Mapping[str, int]:
        """Columns of each matrix."""
        return {block: matrix.shape[-1] for block, matrix in self.matrices.items()}

    def dense(self) -> LinearObservation:
        """Itself."""
        return self

    def information(self, mean: Mapping[str, Tensor]) -> Information | None:
        """See `AbstractObservation.information`."""
        design, residual, noise = self.rows(mean)
        if not float((noise.diagonal(dim1=-2, dim2=-1) if self.correlated else noise).amin()) > 0:
            return None
        count = residual.shape[-1] if self.mask is None else self.mask.sum(-1, dtype=torch.float64)
        if self.correlated:
            precision, shift, squares, log_noise = correlated_terms(design, residual, noise)
        else:
            precision, shift, squares = white_terms(design, residual, 1.0 / noise)
            log_noise = noise.log().sum(-1)
        return Information(precision[..., None, :, :], shift, -0.5 * (squares + log_noise + count * LOG_2PI))

    def rows(self, mean: Mapping[str, Tensor]) -> tuple[Tensor, Tensor, Tensor]:
        """(design, residual, noise) where an unobserved row is a row of zeros with unit noise and no residual.

        Such a row is independent of everything, so that a batch with different masks stays rectangular.
        """
        design = torch.cat([*_broadcast_batch(list(self.matrices.values()), 2)], dim=-1)
        residual = self.value - self.offset
        for block, matrix in self.matrices.items():
            residual = residual - (matrix @ mean[block][..., None])[..., 0]
        if self.mask is None:
            return design, residual, self.noise
        design = torch.where(self.mask[..., None], design, 0.0)
        residual = torch.where(self.mask, residual, 0.0)
        if not self.correlated:
            return design, residual, torch.where(self.mask, self.noise, 1.0)
        both = self.mask[..., :, None] & self.mask[..., None, :]
        return design, residual, torch.where(both, self.noise, torch.eye(self.mask.shape[-1], dtype=residual.dtype))


@dataclass(frozen=True, eq=False)
class SharedDesignObservation(AbstractObservation):
    """Samples of several signals that share one design: part of a motion seen through a movement primitive.

    Row (d, t) reads y_dt = design_t . theta_d + offset_dt + noise; theta is signal-major.

    Args:
        block: the agent whose weights are observed.
        design: (*batch, T, B).
        offset: (*batch, D, T) or broadcastable to it.
        value: (*batch, D, T).
        noise: (*batch, D, T) variances, or (*batch, D, T, T) covariances over time when `correlated`.
        mask: (*batch, D, T), True where a sample was seen; None, its default, where all were.
        correlated: whether `noise` holds covariances.

    Raises:
        ShapeError: axes do not match.
        InputError: NaN, infinity, or a negative variance where a sample was seen, or anywhere in the design.

    Example:
        >>> design, value = torch.eye(3, 2), torch.ones(4, 3)
        >>> SharedDesignObservation("human", design, torch.zeros(1, 1), value, torch.ones(4, 1)).num_columns
        {'human': 8}
    """

    block: str
    design: Float[Tensor, "*#batch time basis"]
    offset: Float[Tensor, "*#batch #signals #time"]
    value: Float[Tensor, "*#batch signals time"]
    noise: Float[Tensor, "*#batch #signals #time"] | Float[Tensor, "*#batch #signals time time"]
    mask: Bool[Tensor, "*#batch #signals #time"] | None = None
    correlated: bool = False

    def __post_init__(self) -> None:
        design, value = as_float64("design", self.design), as_float64("value", self.value)
        check_shape("value", value, ["D", "T"])
        signals, samples = value.shape[-2:]
        check_shape("design", design, [samples, "B"])
        offset, noise = as_float64("offset", self.offset), as_float64("noise", self.noise)
        _check_broadcast("offset", offset, (signals, samples))
        if self.correlated:
            check_shape("noise", noise, [samples, samples])
        _check_broadcast("noise", noise, (signals, samples, samples) if self.correlated else (signals, samples))
        mask = None if self.mask is None else as_bool("mask", self.mask)
        if mask is not None:
            _check_broadcast("mask", mask, (signals, samples))
            mask = None if bool(mask.all()) else mask.expand(*mask.shape[:-2], signals, samples)
        if not _all_finite(design):
            check_finite("design", design)
        _check_seen(value, offset, noise, mask, self.correlated)
        fields = {"design": design, "value": value, "offset": offset, "noise": noise, "mask": mask}
        for key, field in fields.items():
            object.__setattr__(self, key, field)

    @classmethod
    def of_motion(
        cls, block: str, design: Tensor, offset: Tensor, value: Tensor, variance: Tensor, mask: Tensor
    ) -> SharedDesignObservation:
        """The same from a trajectory's samples and a primitive's design, which have been checked: only the noise is.

        Raises:
            InputError: NaN or infinity in the noise.

        Example:
            >>> design, value, seen = torch.eye(3, 2), torch.ones(4, 3), torch.ones(4, 3, dtype=torch.bool)
            >>> motion = SharedDesignObservation.of_motion(
            ...     "human", design, torch.zeros(1, 1), value, torch.ones(4, 1), seen
            ... )
            >>> motion.num_columns, motion.mask is None
            ({'human': 8}, True)
        """
        check_finite("noise", variance)
        seen = None if mask.numpy().all() else mask
        result = object.__new__(cls)
        parts = {"block": block, "design": design, "offset": offset, "value": value, "noise": variance, "mask": seen}
        for key, part in parts.items():
            object.__setattr__(result, key, part)
        return result

    @property
    def num_columns(self) -> Mapping[str, int]:
        """D B columns of the one block."""
        return {self.block: self.value.shape[-2] * self.design.shape[-1]}

    def information(self, mean: Mapping[str, Tensor]) -> Information | None:
        """See `AbstractObservation.information`; one diagonal block of precision for each signal."""
        if self.mask is None and not self.correlated:
            fields = (self.design, 2), (self.value, 2), (self.offset, 2), (self.noise, 2), (mean[self.block], 1)
            single = single_arrays(*fields)
            if single is not None:
                return white_information_alone(single[1], *single[0])
        noise = self._seen_noise()
        if not float((noise.diagonal(dim1=-2, dim2=-1) if self.correlated else noise).amin()) > 0:
            return None
        reference, (signals, samples) = mean[self.block], self.value.shape[-2:]
        expected = reference.reshape(*reference.shape[:-1], signals, self.design.shape[-1]) @ self.design.mT
        residual = self.value - self.offset - expected
        if self.mask is not None:
            residual = torch.where(self.mask, residual, 0.0)
        terms = self._correlated_terms if self.correlated else self._white_terms
        precision, shift, squares, log_noise = terms(residual, noise)
        count = signals * samples if self.mask is None else self.mask.sum((-2, -1), dtype=torch.float64)
        return Information(precision, shift.flatten(-2), -0.5 * (squares + log_noise + count * LOG_2PI))

    def _seen_noise(self) -> Tensor:
        if self.mask is None:
            return self.noise
        if not self.correlated:
            return torch.where(self.mask, self.noise, 1.0)
        both = self.mask[..., :, None] & self.mask[..., None, :]
        return torch.where(both, self.noise, torch.eye(both.shape[-1], dtype=self.noise.dtype))

    def _correlated_terms(self, residual: Tensor, noise: Tensor) -> tuple[Tensor, Tensor, Tensor, Tensor]:
        design = self.design[..., None, :, :]
        design = design if self.mask is None else torch.where(self.mask[..., None], design, 0.0)
        precision, shift, squares, log_noise = correlated_terms(design, residual, noise)
        return precision, shift, squares.sum(-1), log_noise.sum(-1) * (residual.shape[-2] // noise.shape[-3])

    def _white_terms(self, residual: Tensor, noise: Tensor) -> tuple[Tensor, Tensor, Tensor, Tensor]:
        weight, shared = noise.reciprocal(), self.mask is None and noise.shape[-1] == 1
        scaled = residual * weight
        if shared:  # Every sample of a signal counts alike, so that one Gram matrix serves all signals.
            precision = (self.design.mT @ self.design).unsqueeze(-3) * weight.unsqueeze(-1)
        else:
            weight = weight if self.mask is None else weight * self.mask
            design = self.design[..., None, :, :]
            precision = (design * weight[..., None]).mT @ design
        repeats = residual.shape[-2:].numel() // noise.shape[-2:].numel()
        log_noise = noise.log().sum((-2, -1)) * repeats
        return precision, scaled @ self.design, (scaled * residual).sum((-2, -1)), log_noise

    def dense(self) -> LinearObservation:
        """Rows (d, t) signal-major."""
        num_signals, num_samples = self.value.shape[-2:]
        eye = torch.eye(num_signals, dtype=self.value.dtype)
        rows = eye[:, None, :, None] * self.design[..., None, :, None, :]
        matrix = rows.flatten(-2).flatten(-3, -2)
        if self.correlated:
            noise = self.noise.expand(*self.noise.shape[:-3], num_signals, num_samples, num_samples)
            same = eye[:, None, :, None] > 0
            flat_noise = torch.where(same, noise[..., :, :, None, :], 0.0).flatten(-2).flatten(-3, -2)
        else:
            flat_noise = self.noise.expand(*self.noise.shape[:-2], num_signals, num_samples).flatten(-2)
        offset = self.offset.expand(*self.offset.shape[:-2], num_signals, num_samples).flatten(-2)
        mask = None if self.mask is None else self.mask.flatten(-2)
        return LinearObservation(
            {self.block: matrix}, offset, self.value.flatten(-2), flat_noise, mask, self.correlated
        )


def _all_finite(tensor: Tensor) -> bool:
    """In one pass; a sum that overflows reads as not finite and leaves the word to `check_finite`."""
    return math.isfinite(float(tensor.sum()))


def _check_seen(value: Tensor, offset: Tensor, noise: Tensor, mask: Tensor | None, correlated: bool) -> None:
    """Refuses NaN, infinity and negative variances among the rows that `mask` shows."""
    variance, both = (noise.diagonal(dim1=-2, dim2=-1), None) if correlated else (noise, mask)
    if correlated and mask is not None:
        both = mask[..., :, None] & mask[..., None, :]
    for name, tensor, where in (("value", value, mask), ("offset", offset, mask), ("noise", noise, both)):
        if not _all_finite(tensor):
            tensor = tensor if where is None else torch.broadcast_tensors(tensor, where)[0]
            check_finite(name, tensor, where)
    if float((variance if mask is None else torch.where(mask, variance, 0.0)).amin()) < 0:
        raise InputError("Expected noise as variances (units squared), got a negative one. Square standard deviations.")


def _check_broadcast(name: str, tensor: Tensor, expected: tuple[int, ...]) -> None:
    trailing = tensor.shape[-len(expected) :]
    fits = len(trailing) == len(expected) and all(
        got in (1, want) for got, want in zip(trailing, expected, strict=True)
    )
    if not fits:
        wanted = ", ".join(["*batch", *map(str, expected)])
        raise ShapeError(f"Expected {name} with shape ({wanted}), or 1 for an axis, got {tuple(tensor.shape)}.")


def _broadcast_batch(tensors: list[Tensor], num_event: int) -> list[Tensor]:
    batch = torch.broadcast_shapes(*[tensor.shape[:-num_event] for tensor in tensors])
    return [tensor.expand(*batch, *tensor.shape[-num_event:]) for tensor in tensors]

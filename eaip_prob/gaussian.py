"""A Gaussian over named blocks of weights: the belief that everything else reads and updates.

Conditioning itself is in `conditioning.py`. Observations with noise add information in weight space, at a cost that
does not grow with their length; those without noise, or with so little that digits would be lost, are taken by rows.
"""

from __future__ import annotations

import builtins
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, field
from itertools import pairwise
from typing import Any, TypeAlias

import torch
from jaxtyping import Float
from torch import Tensor

from eaip_prob.checks import as_float64, check_finite, check_shape
from eaip_prob.conditioning import LOG_2PI, SplitRoot, update_by_information, update_by_rows
from eaip_prob.errors import InputError, ShapeError
from eaip_prob.linalg import log_det, psd_root, safe_cholesky, symmetrised, whitened
from eaip_prob.observation import AbstractObservation


@dataclass(frozen=True)
class BlockLayout:
    """Names and sizes of the blocks of a weight vector, in order.

    Example:
        >>> BlockLayout({"human": 4, "robot": 3}).slice("robot")
        slice(4, 7, None)
    """

    sizes: Mapping[str, int]

    def __post_init__(self) -> None:
        if not self.sizes or any(size < 1 for size in self.sizes.values()):
            raise InputError(f"Expected at least one block and sizes of at least 1, got {dict(self.sizes)}.")

    @property
    def names(self) -> tuple[str, ...]:
        """Block names in order."""
        return tuple(self.sizes)

    @property
    def total(self) -> int:
        """Z, the sum of the sizes."""
        return sum(self.sizes.values())

    def slice(self, block: str) -> slice:
        """Where a block lies.

        Raises:
            InputError: no such block.
        """
        self._require([block])
        start = 0
        for name, size in self.sizes.items():
            if name == block:
                break
            start += size
        return slice(start, start + self.sizes[block])

    def indices(self, blocks: Sequence[str]) -> Tensor:
        """Positions of several blocks, in the order asked for."""
        slices = [self.slice(block) for block in blocks]
        return torch.cat([torch.arange(part.start, part.stop) for part in slices])

    def positions(self, blocks: Sequence[str]) -> builtins.slice | Tensor:
        """The same as an index that makes no copy where the blocks follow one another."""
        parts = [self.slice(block) for block in blocks]
        if all(one.stop == two.start for one, two in pairwise(parts)):
            return slice(parts[0].start, parts[-1].stop)
        return self.indices(blocks)

    def select(self, blocks: Sequence[str]) -> BlockLayout:
        """The layout of those blocks alone."""
        self._require(blocks)
        return BlockLayout({block: self.sizes[block] for block in blocks})

    def _require(self, blocks: Collection[str]) -> None:
        unknown = [block for block in blocks if block not in self.sizes]
        if unknown or len(set(blocks)) != len(blocks):
            raise InputError(f"Expected different blocks among {self.names}, got {unknown or list(blocks)}.")


_Names: TypeAlias = tuple[str, ...]
_Split: TypeAlias = tuple[SplitRoot, Tensor, BlockLayout]


@dataclass(frozen=True, eq=False)
class BlockGaussian:
    """Gaussian with named blocks.

    Args:
        mean: (*batch, Z).
        covariance: (*batch, Z, Z), positive semi-definite; its batch axes may be fewer where members share it.
        layout: blocks.

    Raises:
        ShapeError: sizes do not match the layout.
        InputError: NaN or infinity.

    Example:
        >>> prior = BlockGaussian(torch.zeros(2), torch.tensor([[1.0, 0.5], [0.5, 1.0]]), BlockLayout({"a": 1, "b": 1}))
        >>> from eaip_prob.observation import LinearObservation
        >>> seen = LinearObservation({"a": torch.ones(1, 1)}, torch.zeros(1), torch.ones(1), torch.ones(1))
        >>> prior.condition([seen]).block_mean("b")
        tensor([0.2500], dtype=torch.float64)
    """

    mean: Float[Tensor, "*batch weights"]
    covariance: Float[Tensor, "*#batch weights weights"]
    layout: BlockLayout
    _roots: dict[_Names, Tensor] = field(default_factory=dict, init=False, repr=False)
    _splits: dict[tuple[_Names, _Names], _Split] = field(default_factory=dict, init=False, repr=False)

    def __post_init__(self) -> None:
        mean, covariance = as_float64("mean", self.mean), as_float64("covariance", self.covariance)
        check_shape("mean", mean, [self.layout.total])
        check_shape("covariance", covariance, [self.layout.total, self.layout.total])
        advice = "Mend what computed this Gaussian; look for a division by zero."
        check_finite("mean", mean, advice=advice)
        check_finite("covariance", covariance, advice=advice)
        if torch.broadcast_shapes(mean.shape[:-1], covariance.shape[:-2]) != mean.shape[:-1]:
            raise ShapeError(
                f"Expected a covariance with the batch axes of the mean or fewer, got {tuple(covariance.shape)} for a "
                f"mean of shape {tuple(mean.shape)}. Expand the mean."
            )
        object.__setattr__(self, "mean", mean)
        object.__setattr__(self, "covariance", covariance)

    @classmethod
    def _computed(cls, mean: Tensor, covariance: Tensor, layout: BlockLayout) -> BlockGaussian:
        """A result of this module, whose checks were those of its inputs."""
        result = object.__new__(cls)
        for key, part in {
            "mean": mean,
            "covariance": covariance,
            "layout": layout,
            "_roots": {},
            "_splits": {},
        }.items():
            object.__setattr__(result, key, part)
        return result

    def block_mean(self, block: str) -> Float[Tensor, "*batch weights"]:
        """Mean of one block."""
        return self.mean[..., self.layout.slice(block)]

    def block_covariance(self, block: str) -> Float[Tensor, "*#batch weights weights"]:
        """Covariance of one block."""
        rows = self.layout.slice(block)
        return self.covariance[..., rows, rows]

    def marginal(self, blocks: Sequence[str]) -> BlockGaussian:
        """The Gaussian of the named blocks alone, in that order."""
        if tuple(blocks) == self.layout.names:
            return self
        index = self.layout.indices(blocks)
        covariance = self.covariance[..., index[:, None], index]
        return self._computed(self.mean[..., index], covariance, self.layout.select(blocks))

    def condition(
        self, observations: Sequence[AbstractObservation], keep: Sequence[str] | None = None
    ) -> BlockGaussian:
        """The posterior given observations, in any order; without observations, the prior.

        Args:
            observations: batch axes broadcast against the mean's.
            keep: blocks of the result; default all. Fewer blocks cost less.

        Raises:
            InputError: an unknown block.
            ShapeError: an observation's columns do not match its block.
        """
        return self.update(observations, keep)[0]

    def log_evidence(self, observations: Sequence[AbstractObservation]) -> Float[Tensor, "*batch"]:
        """Log density of the observed values under the prior, nats."""
        return self.update(observations, keep=self.layout.names[:1])[1]

    def update(
        self, observations: Sequence[AbstractObservation], keep: Sequence[str] | None = None
    ) -> tuple[BlockGaussian, Float[Tensor, "*batch"]]:
        """(posterior over the blocks in `keep`, log evidence) in one pass."""
        keep = self.layout.names if keep is None else tuple(keep)
        if not observations:
            return self.marginal(keep), self.mean.new_zeros(self.mean.shape[:-1])
        touched = self._touched(observations)
        split, kept_mean, layout = self._split(touched, keep)
        pulled, scales, exact = [], [], []
        for observation in observations:
            information = observation.information({block: self.block_mean(block) for block in observation.blocks})
            rows = split.seen
            if observation.blocks != touched:
                rows = rows[..., self.layout.select(touched).positions(observation.blocks), :]
            terms = None if information is None else information.pulled(rows)
            if information is None or terms is None:
                exact.append(observation)
            else:
                pulled.append(terms)
                scales.append(information.log_scale)
        if exact:
            return self._update_by_rows(observations, exact, touched, keep)
        step, covariance, gained = update_by_information(split, pulled)
        return self._computed(kept_mean + step, covariance, layout), sum(scales, gained)

    def _touched(self, observations: Sequence[AbstractObservation]) -> _Names:
        """Blocks that are observed, in the layout's order, once the observations fit them."""
        columns = [pair for observation in observations for pair in observation.num_columns.items()]
        touched = dict(columns)
        self.layout._require(touched)
        for block, size in columns:
            if size != self.layout.sizes[block]:
                raise ShapeError(
                    f"Expected an observation of block {block!r} with {self.layout.sizes[block]} columns, got "
                    f"{size}. Pass that block's rows only, from the primitive the model was fitted with."
                )
        return tuple(block for block in self.layout.sizes if block in touched)

    def _split(self, touched: _Names, keep: _Names) -> _Split:
        """What every update of these blocks shares; kept, as a fitted joint is conditioned many times."""
        if (touched, keep) not in self._splits:
            order = touched + tuple(block for block in keep if block not in touched)
            layout = self.layout.select(order)
            num_seen = self.layout.select(touched).total
            split = SplitRoot.of(self._root(order), num_seen, layout.indices(keep))
            kept_mean = self.mean[..., self.layout.indices(keep)]
            self._splits[touched, keep] = split, kept_mean, self.layout.select(keep)
        return self._splits[touched, keep]

    def _root(self, order: _Names) -> Tensor:
        """Root of the covariance of the blocks in that order."""
        if order not in self._roots:
            self._roots[order] = psd_root(self.marginal(order).covariance)
        return self._roots[order]

    def _update_by_rows(
        self,
        observations: Sequence[AbstractObservation],
        exact: Sequence[AbstractObservation],
        touched: _Names,
        keep: _Names,
    ) -> tuple[BlockGaussian, Tensor]:
        """The exact observations one after another, after all the others together."""
        others = [observation for observation in observations if not any(observation is one for one in exact)]
        order = touched + tuple(block for block in keep if block not in touched)
        belief, log_evidence = self.update(others, order)
        for observation in exact:
            rows = observation.dense()
            matrix, residual, noise = rows.rows({block: belief.block_mean(block) for block in rows.blocks})
            noise = noise if rows.correlated else torch.diag_embed(noise)
            seen = belief.layout.positions(rows.blocks)
            step, covariance, gained = update_by_rows(belief._root(order), seen, matrix, residual, noise)
            hidden = 0 if rows.mask is None else (~rows.mask).sum(-1, dtype=torch.float64)
            log_evidence = log_evidence + gained + 0.5 * LOG_2PI * hidden
            belief = self._computed(belief.mean + step, covariance, belief.layout)
        return belief.marginal(keep), log_evidence

    def affine(
        self,
        block: str,
        matrix: Float[Tensor, "*#batch rows weights"],
        offset: Float[Tensor, "*#batch rows"],
        name: str = "value",
    ) -> BlockGaussian:
        """Distribution of `matrix @ theta_block + offset` as a Gaussian with the one block `name`."""
        matrix, offset = as_float64("matrix", matrix), as_float64("offset", offset)
        check_shape("matrix", matrix, ["M", self.layout.select([block]).total])
        check_shape("offset", offset, [matrix.shape[-2]])
        mean = (matrix @ self.block_mean(block)[..., None])[..., 0] + offset
        covariance = symmetrised(matrix @ self.block_covariance(block) @ matrix.mT)
        return BlockGaussian(mean, covariance, BlockLayout({name: matrix.shape[-2]}))

    def log_prob(self, value: Float[Tensor, "*batch weights"]) -> Float[Tensor, "*batch"]:
        """Log density, nats."""
        value = as_float64("value", value)
        check_shape("value", value, [self.layout.total])
        factor = safe_cholesky(self.covariance)
        quadratic = whitened(factor, value - self.mean).square().sum(-1)
        return -0.5 * (quadratic + log_det(factor) + self.layout.total * LOG_2PI)

    def sample(self, num: int, generator: torch.Generator) -> Float[Tensor, "num *batch weights"]:
        """Draws from the Gaussian; singular covariances included."""
        root = self._root(self.layout.names)
        noise = torch.randn(num, *self.mean.shape[:-1], root.shape[-1], generator=generator, dtype=torch.float64)
        # Draws as rows of one product for each member of the batch: as vectors, the root would be copied for each draw.
        return self.mean + (noise.movedim(0, -2) @ root.mT).movedim(-2, 0)

    def to_pyro(self) -> Any:
        """The same distribution as a `pyro.distributions.MultivariateNormal`."""
        import pyro.distributions

        return pyro.distributions.MultivariateNormal(self.mean, scale_tril=safe_cholesky(self.covariance))

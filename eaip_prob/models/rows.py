"""Demonstrations as one table of weights, and the coordinates in which covariances of it are regularised."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Self

import torch
from jaxtyping import Float
from torch import Tensor

from eaip_prob.checks import as_bool, as_float64, check_finite
from eaip_prob.errors import InputError, ShapeError
from eaip_prob.folds import group_folds
from eaip_prob.gaussian import BlockLayout
from eaip_prob.linalg import orthonormal_coordinates, psd_root, symmetrised
from eaip_prob.models.missing import completed

ENVIRONMENT = "environment"


@dataclass(frozen=True, eq=False)
class Coordinates:
    """Coordinates R w in which every Gram matrix is the identity.

    Args:
        forward: (Z, Z), R, block by block.
        back: (Z, Z), its inverse.

    Example:
        >>> plain = Coordinates.of(BlockLayout({"human": 2}), {"human": 4.0 * torch.eye(2, dtype=torch.float64)})
        >>> plain.forward.diagonal().tolist()
        [2.0, 2.0]
    """

    forward: Float[Tensor, "joint joint"]
    back: Float[Tensor, "joint joint"]

    @classmethod
    def of(cls, layout: BlockLayout, grams: Mapping[str, Tensor]) -> Self:
        """Those of the Gram matrices; blocks without one stay as they are.

        Raises:
            ShapeError: a Gram matrix that fits no block.
        """
        for block, gram in grams.items():
            size = layout.sizes.get(block, 0)
            if gram.shape != (size, size):
                raise ShapeError(
                    f"Expected grams[{block!r}] with shape {(size, size)} for its {size} weights, "
                    f"got {tuple(gram.shape)}."
                )
        eye = {block: torch.eye(size, dtype=torch.float64) for block, size in layout.sizes.items()}
        pairs = [orthonormal_coordinates(grams[block]) if block in grams else (eye[block], eye[block]) for block in eye]
        return cls(torch.block_diag(*[pair[0] for pair in pairs]), torch.block_diag(*[pair[1] for pair in pairs]))

    def of_some(self, columns: Tensor) -> Coordinates:
        """The coordinates of whole blocks, given the positions of their weights."""
        return Coordinates(self.forward[columns[:, None], columns], self.back[columns[:, None], columns])

    def covariance(self, inner: Float[Tensor, "*batch joint joint"]) -> Float[Tensor, "*batch joint joint"]:
        """A covariance of R w as one of the weights w; a product of roots, which stays positive semi-definite."""
        half = self.back @ psd_root(inner)
        return symmetrised(half @ half.mT)


@dataclass(frozen=True, eq=False)
class WeightTable:
    """What every joint model is fitted to.

    Args:
        rows: (N, Z), all blocks side by side, entries that were not observed filled with their expectation.
        layout: blocks.
        coordinates: in which covariances are regularised.
        folds: index tensors of the demonstrations that are held out together.
        target: positions of the weights to be predicted.
        features: positions of the environment's features, empty where there are none.

    Example:
        >>> table = WeightTable.of({"human": torch.eye(3), "environment": torch.ones(3, 1)}, target="human")
        >>> table.layout.names, table.features.tolist()
        (('human', 'environment'), [3])
    """

    rows: Float[Tensor, "demonstrations joint"]
    layout: BlockLayout
    coordinates: Coordinates
    folds: Sequence[Tensor]
    target: Tensor
    features: Tensor

    @classmethod
    def of(
        cls,
        weights: Mapping[str, Float[Tensor, "demonstrations weights"]],
        observed: Mapping[str, Tensor] | None = None,
        groups: Sequence[int | str] | None = None,
        target: str = "robot",
        grams: Mapping[str, Tensor] | None = None,
    ) -> Self:
        """The table of what `AbstractJointModel.fit` is given.

        Raises:
            ShapeError: blocks with different numbers of rows, or masks, groups or Gram matrices that do not fit them.
            InputError: fewer than two demonstrations, NaN, or an unknown target.
        """
        rows, layout = _joined(weights, observed)
        if groups is not None and len(groups) != len(rows):
            raise ShapeError(f"Expected {len(rows)} groups, one per demonstration, got {len(groups)}.")
        columns = layout.indices([target])
        features = layout.indices([ENVIRONMENT]) if ENVIRONMENT in layout.names else columns[:0]
        folds = group_folds(range(len(rows)) if groups is None else groups)
        return cls(rows, layout, Coordinates.of(layout, grams or {}), folds, columns, features)


def _joined(
    weights: Mapping[str, Tensor], observed: Mapping[str, Tensor] | None
) -> tuple[Float[Tensor, "demonstrations joint"], BlockLayout]:
    """All blocks side by side, completed."""
    if not weights:
        raise InputError("Expected weights of at least one block, got none.")
    blocks = {name: as_float64(f"weights[{name!r}]", rows) for name, rows in weights.items()}
    counts = {name: rows.shape[0] if rows.ndim == 2 else -1 for name, rows in blocks.items()}
    if len(set(counts.values())) > 1 or -1 in counts.values():
        shapes = {name: tuple(rows.shape) for name, rows in blocks.items()}
        raise ShapeError(f"Expected weights (N, K) with one N for all blocks, got {shapes}.")
    if next(iter(counts.values())) < 2:
        raise InputError("Expected at least two demonstrations to learn a covariance, got one. Record more.")
    rows = torch.cat(list(blocks.values()), -1)
    layout = BlockLayout({name: block.shape[-1] for name, block in blocks.items()})
    if observed is None:
        check_finite("weights", rows)
        return rows, layout
    everything = {name: torch.ones_like(block, dtype=torch.bool) for name, block in blocks.items()}
    for name, mask in observed.items():
        if name not in blocks:
            raise InputError(f"Expected observed for blocks among {tuple(blocks)}, got {name!r}.")
        if mask.shape != blocks[name].shape:
            raise ShapeError(
                f"Expected observed[{name!r}] with shape {tuple(blocks[name].shape)}, got {tuple(mask.shape)}."
            )
        everything[name] = as_bool(f"observed[{name!r}]", mask)
    mask = torch.cat([everything[name] for name in layout.names], -1)
    check_finite("weights", rows, where=mask)
    return completed(rows, mask), layout

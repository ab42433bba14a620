"""Groups of motions: which of them belong to one person, object or recording."""

from __future__ import annotations

from collections.abc import Sequence

import torch
from jaxtyping import Float, Int
from torch import Tensor

from eaip_prob.errors import ShapeError


def group_index(groups: Sequence[int | str] | Tensor, count: int) -> tuple[Int[Tensor, "motions"], int]:
    """Group number of every motion, 0 upwards in the order of first appearance, and the number of groups.

    Args:
        groups: one integer or string per motion, or an integer tensor.
        count: number of motions.

    Raises:
        ShapeError: another number of groups than motions, or no motion.

    Example:
        >>> group_index(["ann", "bob", "ann"], 3)
        (tensor([0, 1, 0]), 2)
    """
    labels = groups.reshape(-1).tolist() if isinstance(groups, Tensor) else list(groups)
    if len(labels) != count or count == 0:
        raise ShapeError(f"Expected one group per motion, {count} of them (at least 1), got {len(labels)}.")
    numbers = {label: number for number, label in enumerate(dict.fromkeys(labels))}
    return torch.tensor([numbers[label] for label in labels]), len(numbers)


def group_means(
    values: Float[Tensor, "motions"], index: Int[Tensor, "motions"], num_groups: int
) -> Float[Tensor, "groups"]:
    """Mean over the motions of each group."""
    sums = values.new_zeros(num_groups).index_add(0, index, values)
    return sums / torch.bincount(index, minlength=num_groups)

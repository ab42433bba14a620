"""Which columns of a table say something that the columns before them do not."""

from __future__ import annotations

import torch
from jaxtyping import Bool, Float, Int
from torch import Tensor

_SAME = 1e-6  # share of a column's norm below which what earlier columns leave of it is round-off


def independent_columns(
    columns: Float[Tensor, "rows columns"], observed: Bool[Tensor, "rows columns"], num_given: int = 0
) -> Int[Tensor, "kept"]:
    """Places of the columns that are no affine function of kept ones before them.

    A column is compared over the rows that observe it, with those earlier columns that all of these rows observe too;
    one that no row observes is left out.

    Args:
        columns: (rows, columns), of comparable size.
        observed: of the same shape.
        num_given: this many columns are kept whatever they say.

    Example:
        >>> table = torch.tensor([[1.0, 3.0, 1.0], [2.0, 5.0, 4.0], [3.0, 7.0, 9.0]], dtype=torch.float64)
        >>> independent_columns(table, table > 0).tolist()
        [0, 2]
    """
    kept: list[int] = []
    bases: dict[bytes, tuple[Tensor, int]] = {}
    for number in range(columns.shape[1]):
        rows = observed[:, number]
        key = rows.numpy().tobytes()
        basis, num_used = bases.get(key, (_extended(columns.new_empty(int(rows.sum()), 0), columns.new_ones(1)), 0))
        for earlier in kept[num_used:]:
            if bool(observed[rows, earlier].all()):
                basis = _extended(basis, columns[rows, earlier])
        bases[key] = (basis, len(kept))
        if number < num_given or _extended(basis, columns[rows, number]).shape[1] > basis.shape[1]:
            kept.append(number)
    return torch.tensor(kept, dtype=torch.int64)


def _extended(basis: Tensor, column: Tensor) -> Tensor:
    """The orthonormal basis with what is new in the column; unchanged where nothing is."""
    column = column.expand(basis.shape[0])
    rest = column
    for _ in range(2):  # the second pass removes the round-off of the first
        rest = rest - basis @ (basis.mT @ rest)
    norm = rest.norm()
    return torch.cat([basis, (rest / norm)[:, None]], -1) if bool(norm > _SAME * column.norm()) else basis

"""Which demonstrations are held out together."""

from __future__ import annotations

from collections.abc import Iterable

import torch
from torch import Tensor


def group_folds(groups: Iterable[int | str], max_folds: int = 5) -> list[Tensor]:
    """Index tensors of at most `max_folds` folds; each leaves whole groups out, in the order of first appearance.

    Folds that would leave fewer than two demonstrations, from which no covariance can be learnt, are left out. Empty
    where there is one group only: nothing can be held out then.

    Example:
        >>> [fold.tolist() for fold in group_folds(["ann", "ben", "ann", "ben"])]
        [[0, 2], [1, 3]]
    """
    labels = list(groups)
    order = list(dict.fromkeys(labels))
    if len(order) < 2:
        return []
    num_folds = min(max_folds, len(order))
    fold_of = {group: number * num_folds // len(order) for number, group in enumerate(order)}
    member = torch.tensor([fold_of[label] for label in labels])
    folds = [(member == fold).nonzero()[:, 0] for fold in range(num_folds)]
    return [fold for fold in folds if len(labels) - len(fold) >= 2]

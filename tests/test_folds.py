from __future__ import annotations

import pytest
import torch

from eaip_prob.folds import group_folds


@pytest.mark.parametrize("num", [3, 4, 5, 7, 23])
@pytest.mark.parametrize("max_folds", [2, 5])
def test_folds_hold_each_demonstration_once(num: int, max_folds: int) -> None:
    folds = group_folds(range(num), max_folds)
    if num > 3 or max_folds > 2:
        assert sorted(torch.cat(folds).tolist()) == list(range(num))
    assert len(folds) <= max_folds
    sizes = [len(fold) for fold in folds]
    assert max(sizes) - min(sizes) <= 1


def test_groups_are_never_torn() -> None:
    groups = ["c", "a", "b", "a", "c", "d", "e", "f", "f", "a"]
    folds = group_folds(groups, 3)
    members = [{groups[i] for i in fold.tolist()} for fold in folds]
    assert len(folds) == 3
    assert not (members[0] & members[1] or members[0] & members[2] or members[1] & members[2])
    assert sorted(torch.cat(folds).tolist()) == list(range(10))


def test_order_of_first_appearance() -> None:
    assert [fold.tolist() for fold in group_folds([9, 1, 9, 5, 1, 5])] == [[0, 2], [1, 4], [3, 5]]


@pytest.mark.parametrize("groups", [["a"], ["a"] * 6, ["a", "b"]])
def test_nothing_to_hold_out(groups: list[str]) -> None:
    assert group_folds(groups) == []


def test_a_fold_leaves_at_least_two_demonstrations() -> None:
    assert [fold.tolist() for fold in group_folds(["a", "a", "a", "b"])] == [[3]]

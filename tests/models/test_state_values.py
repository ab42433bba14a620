from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from fractions import Fraction
from typing import Any

import pytest
import torch

from eaip_prob.errors import InputError
from eaip_prob.models import ShrinkageCovariance
from eaip_prob.models.state import decode, encode


@dataclass(frozen=True)
class Pair:
    many: tuple[Any, ...]
    names: Mapping[str, Any]
    some: list[Any]
    total: int = field(init=False, default=0)

    def __post_init__(self) -> None:
        object.__setattr__(self, "total", len(self.many) + len(self.some))


def test_tuples_lists_and_mappings_keep_their_kind_and_order() -> None:
    pair = Pair((1, (True, None), [2.5]), {"b": (), "a": {"x": "y"}}, [(3,), Pair((), {}, [])])
    again = decode(encode(pair))
    assert again == pair and again.total == 5
    assert [type(part) for part in (again.many, again.many[1], again.many[2], again.some)] == [tuple, tuple, list, list]
    assert list(again.names) == ["b", "a"]
    assert type(again.many[1][0]) is bool


def test_gradients_stay_behind() -> None:
    came = encode(torch.ones(2, requires_grad=True))
    assert not came.requires_grad


def local_class() -> object:
    @dataclass(frozen=True)
    class Inside:
        pass

    return Inside()


@pytest.mark.parametrize(
    ("value", "message"),
    [
        (Fraction(1, 2), r"Expected value.many\[0\] as a tensor.*got Fraction. Keep it"),
        ({1, 2}, r"value.many\[0\] .* got set"),
        (torch.Size([2]), r"value.many\[0\] .* got Size"),
        (torch.float64, r"value.many\[0\] .* got dtype"),
        (ShrinkageCovariance, r"value.many\[0\] .* got ABCMeta"),
        ({3: 1}, r"Expected the keys of value.many\[0\] as text, got 3"),
        (local_class(), r"value.many\[0\] of a class that can be imported, got .*<locals>.Inside. Define it"),
    ],
)
def test_what_cannot_be_written_is_named(value: object, message: str) -> None:
    with pytest.raises(InputError, match=message):
        encode(Pair((value,), {}, []))

"""Gate on the scene and trust in the motion, as far as they were earned on groups left out.

Before anything of a motion is seen the gate scales what the scene says; it stays near 1 unless the groups left out say
otherwise, because the joint model has weighed the scene already. Trust in the motion stays near 0 unless it is earned,
because a motion that tells nothing of a new person's does harm. Trust in the scene beside the motion stays near 1.
"""

from __future__ import annotations

from collections.abc import Sequence

import torch
from jaxtyping import Float
from torch import Tensor

from eaip_prob.held_out import SHARES_SEEN, HeldOut, Moved
from eaip_prob.slope import Slope
from eaip_prob.trust import Trust

_NEIGHBOUR = 0.5  # how much a share of a motion counts for the one next to it


def earned_gate(parts: Sequence[HeldOut]) -> Slope:
    """How far the scene alone is believed."""
    product, power, total = _sums([part.moved_by_scene() for part in parts], _groups(parts))
    return Slope.of(product, power, total, towards=1.0)


def earned_trust(parts: Sequence[HeldOut]) -> Trust:
    """How far the motion is believed, the scene known where there is one."""
    return _trust(parts, "trust", towards=0.0)


def earned_scene_trust(parts: Sequence[HeldOut]) -> Trust:
    """How far the scene is believed beside what was seen of the motion."""
    return _trust(parts, "scene_trust", towards=1.0)


def _trust(parts: Sequence[HeldOut], which: str, towards: float) -> Trust:
    """A slope after each share of a motion that leaves something to predict.

    Neighbouring shares count too: the slopes of few people after one share alone are mostly noise.
    """
    found: dict[float, Tensor] = {}
    for share in SHARES_SEEN:
        there = [pair for part in parts if (pair := part.moved_by(which, share)) is not None]
        if there:
            place = sum(place for place, _ in there) / len(there)
            found[place] = _sums([part for _, part in there], _groups(parts))
    if not found:
        return Trust()
    number = torch.arange(len(found), dtype=torch.float64)
    weight = _NEIGHBOUR ** (number[:, None] - number).abs()
    pooled = dict(zip(found, torch.einsum("st,tkg->skg", weight, torch.stack(list(found.values()))), strict=True))
    slopes = [Slope.of(*pooled[place].unbind(), towards=towards) for place in sorted(found)]  # pyright: ignore[reportArgumentType]
    return Trust(tuple(sorted(found)), tuple(slopes))


def _groups(parts: Sequence[HeldOut]) -> list[int | str]:
    return list(dict.fromkeys(group for part in parts for group in part.left_out.groups))


def _sums(parts: Sequence[Moved], groups: Sequence[int | str]) -> Float[Tensor, "3 groups"]:
    """Products, powers and totals of the groups of all folds, as shares of the total of all of them."""
    index = {group: number for number, group in enumerate(groups)}
    member = torch.tensor([index[label] for part in parts for label in part.groups])
    columns = [torch.cat([getattr(part, name) for part in parts]) for name in ("product", "power", "total")]
    sums = torch.zeros(3, len(index), dtype=torch.float64).index_add(1, member, torch.stack(columns))
    return sums / sums[2].sum().clamp_min(1e-300)

"""What the first second of a partner's motion tells of the object: if it told all, nobody would need to look."""

from __future__ import annotations

from collections.abc import Sequence

import torch

from eaip_prob.evaluation import explained, identified
from eaip_prob.tasks.bag_covering.recorded import RecordedCovering

WATCHED = 1.0  # s


def tells(recorded: Sequence[RecordedCovering], watched: float = WATCHED) -> dict[str, float]:
    """`decodable/object` (accuracy) and `decodable/size` (R^2 of the object's height), partners left out.

    Args:
        recorded: demonstrations of three or more partners, whose first samples are at the same times.
        watched: how much of the motion is looked at, s.
    """
    starts = [
        torch.cat([torch.from_numpy(hand.position).flatten() for hand in one.hands if hand.time <= watched + 1e-6])
        for one in recorded
    ]
    beginnings = torch.stack([start[: min(map(len, starts))] for start in starts])
    partners = [one.partner for one in recorded]
    height = torch.tensor([[float(one.truth.place[5])] for one in recorded], dtype=torch.float64)
    return {
        "decodable/object": identified([one.thing for one in recorded], beginnings, partners),
        "decodable/size": float(explained(height, beginnings, partners)[0]),
    }

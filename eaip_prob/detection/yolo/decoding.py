"""From the raw answers of YOLO v2 to boxes: sigmoid and exponential around cells and anchors, then suppression.

Redmon and Farhadi (2017), Sec. 2: with the cell's corner (c_x, c_y) and the anchor's size (p_w, p_h), in cells,
b_x = sigmoid(t_x) + c_x, b_y = sigmoid(t_y) + c_y, b_w = p_w exp(t_w), b_h = p_h exp(t_h).
"""

from __future__ import annotations

from dataclasses import dataclass

import torch
from jaxtyping import Float
from torch import Tensor

from eaip_prob.errors import ShapeError

_LARGEST = 6.0  # of t_w and t_h, so that an exponential of a wild answer stays finite


@dataclass(frozen=True, eq=False)
class YoloAnswers:
    """What the network says of every cell and anchor; letters as in `yolo_network`, rows and columns of cells.

    Args:
        offset: (B, A, rows, columns, 2), sigmoid of x and y: the centre within its cell.
        log_size: (B, A, rows, columns, 2), logarithm of width and height over the anchor's.
        box: (B, A, rows, columns, 4), centre and size, in cells.
        objectness: (B, A, rows, columns), from 0 to 1.
        class_logits: (B, A, rows, columns, C).

    Example:
        >>> answers(torch.zeros(1, 14, 2, 3), torch.ones(2, 2)).box[0, 0, 1, 2].tolist()
        [2.5, 1.5, 1.0, 1.0]
    """

    offset: Float[Tensor, "batch anchors rows columns 2"]
    log_size: Float[Tensor, "batch anchors rows columns 2"]
    box: Float[Tensor, "batch anchors rows columns 4"]
    objectness: Float[Tensor, "batch anchors rows columns"]
    class_logits: Float[Tensor, "batch anchors rows columns classes"]


def answers(raw: Float[Tensor, "batch answers rows columns"], anchors: Float[Tensor, "anchors 2"]) -> YoloAnswers:
    """The raw output of a network, in its parts.

    Args:
        raw: (B, A (5 + C), rows, columns).
        anchors: (A, 2), width and height in cells.

    Raises:
        ShapeError: channels that are no multiple of A, or leave no class.

    Example:
        >>> answers(torch.zeros(1, 14, 2, 3), torch.ones(2, 2)).class_logits.shape
        torch.Size([1, 2, 2, 3, 2])
    """
    batch, channels, rows, columns = raw.shape
    if channels % len(anchors) or channels // len(anchors) < 6:
        raise ShapeError(f"Expected answers with {len(anchors)} x (5 + C) channels, C >= 1, got {tuple(raw.shape)}.")
    parts = raw.reshape(batch, len(anchors), -1, rows, columns).permute(0, 1, 3, 4, 2)
    offset, log_size = parts[..., :2].sigmoid(), parts[..., 2:4].clamp(max=_LARGEST)
    down, along = torch.meshgrid(torch.arange(rows), torch.arange(columns), indexing="ij")
    corner = torch.stack([along, down], -1).to(raw)
    size = anchors.to(raw)[:, None, None] * log_size.exp()
    box = torch.cat([offset + corner, size], -1)
    return YoloAnswers(offset, log_size, box, parts[..., 4].sigmoid(), parts[..., 5:])


def box_iou(first: Float[Tensor, "*batch 4"], second: Float[Tensor, "*batch 4"]) -> Float[Tensor, "*batch"]:
    """Intersection over union of boxes, pair by pair.

    Args:
        first: (..., 4), centre and size.
        second: (..., 4), in the same unit.

    Example:
        >>> box_iou(torch.tensor([1.0, 1.0, 2.0, 2.0]), torch.tensor([2.0, 1.0, 2.0, 2.0])).item()
        0.3333333432674408
    """
    low = torch.maximum(first[..., :2] - first[..., 2:] / 2, second[..., :2] - second[..., 2:] / 2)
    high = torch.minimum(first[..., :2] + first[..., 2:] / 2, second[..., :2] + second[..., 2:] / 2)
    common = (high - low).clamp(min=0).prod(-1)
    return common / (first[..., 2:].prod(-1) + second[..., 2:].prod(-1) - common).clamp(min=1e-9)

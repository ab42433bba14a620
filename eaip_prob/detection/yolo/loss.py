"""The loss of YOLO v2 (Redmon and Farhadi 2017), as its authors' program computes it.

Of each labelled box, the cell that holds its centre and the anchor nearest to its shape answer. Squares of the errors
of (x, y) within the cell and of the logarithms of the size, weighted by 2 - w h (shares of the image) so that small
boxes count; the objectness should be the IoU of the answered box there, and zero elsewhere unless that box overlaps a
labelled one by more than 0.6; cross-entropy of the class.
"""

from __future__ import annotations

from dataclasses import dataclass

import torch
from jaxtyping import Float, Int
from torch import Tensor

from eaip_prob.detection.yolo.decoding import YoloAnswers, box_iou

_GOOD = 0.6  # an answer that overlaps this much is not punished where it is not responsible


@dataclass(frozen=True)
class LossScales:
    """Weights of the parts.

    Args:
        object: of the objectness where an object is.
        nothing: of the objectness where none is.
        box: of place and size.
        label: of the class.

    Example:
        >>> LossScales().object
        5.0
    """

    object: float = 5.0
    nothing: float = 1.0
    box: float = 2.0
    label: float = 2.0


@dataclass(frozen=True, eq=False)
class Targets:
    """Labelled boxes of a batch of B images, in cells.

    Args:
        image: (M,), which image a box is in.
        box: (M, 4), centre and size.
        label: (M,), index of its class.

    Example:
        >>> Targets(torch.tensor([0]), torch.tensor([[2.5, 1.5, 1.0, 2.0]]), torch.tensor([1])).label.tolist()
        [1]
    """

    image: Int[Tensor, "boxes"]
    box: Float[Tensor, "boxes 4"]
    label: Int[Tensor, "boxes"]


def yolo_loss(
    said: YoloAnswers, truth: Targets, anchors: Float[Tensor, "anchors 2"], scales: LossScales | None = None
) -> Float[Tensor, ""]:
    """The loss, a mean over the images.

    Args:
        said: by the network.
        truth: labelled boxes whose centres lie in the image.
        anchors: (A, 2), width and height in cells.
        scales: as `LossScales()` if None.

    Example:
        >>> from eaip_prob.detection.yolo.decoding import answers
        >>> raw, anchors = torch.zeros(1, 6, 2, 3), torch.ones(1, 2)
        >>> raw[:, 4] = -9.0
        >>> truth = Targets(torch.tensor([0]), torch.tensor([[1.5, 0.5, 1.0, 1.0]]), torch.tensor([0]))
        >>> round(float(yolo_loss(answers(raw, anchors), truth, anchors)), 2)  # only the objectness is wrong
        5.0
    """
    scales = scales or LossScales()
    column, row = truth.box[:, 0].long(), truth.box[:, 1].long()
    anchor = _shape_iou(truth.box[:, 2:], anchors).argmax(1)
    at = (truth.image, anchor, row, column)
    with torch.no_grad():
        nothing = _best_iou(said, truth) <= _GOOD
        nothing[at] = False
        iou = box_iou(said.box[at], truth.box)
    rows, columns = said.box.shape[2:4]
    small = 2.0 - truth.box[:, 2] * truth.box[:, 3] / (rows * columns)
    offset = truth.box[:, :2] - torch.stack([column, row], -1)
    log_size = (truth.box[:, 2:] / anchors[anchor]).log()
    error = (said.offset[at] - offset).square().sum(-1) + (said.log_size[at] - log_size).square().sum(-1)
    label = torch.nn.functional.cross_entropy(said.class_logits[at], truth.label, reduction="sum")
    total = scales.box * (small * error).sum() + scales.label * label
    total = total + scales.object * (said.objectness[at] - iou).square().sum()
    total = total + scales.nothing * (said.objectness.square() * nothing).sum()
    return total / len(said.objectness)


def _shape_iou(size: Tensor, anchors: Tensor) -> Tensor:
    common = torch.minimum(size[:, None], anchors[None]).prod(-1)
    return common / (size.prod(-1)[:, None] + anchors.prod(-1)[None] - common)


def _best_iou(said: YoloAnswers, truth: Targets) -> Tensor:
    best = torch.zeros_like(said.objectness)
    for image, box in zip(truth.image.tolist(), truth.box, strict=True):
        best[image] = torch.maximum(best[image], box_iou(said.box[image], box))
    return best

from __future__ import annotations

import numpy as np
import pytest
import torch

from eaip_prob.detection.yolo.decoding import answers
from eaip_prob.detection.yolo.loss import LossScales, Targets, yolo_loss

ANCHORS = torch.tensor([[1.0, 2.0], [3.0, 1.0]])


def truth():
    box = torch.tensor([[2.3, 1.6, 1.2, 1.9], [0.4, 0.5, 2.5, 1.1], [3.5, 2.5, 1.0, 2.0]])
    return Targets(torch.tensor([0, 0, 1]), box, torch.tensor([2, 0, 1]))


def slow_loss(raw, scales):
    """Cell by cell, in numpy, from the paper's description."""

    def sigmoid(t):
        return 1 / (1 + np.exp(-t))

    def iou(p, q):
        low = np.maximum(p[:2] - p[2:] / 2, q[:2] - q[2:] / 2)
        high = np.minimum(p[:2] + p[2:] / 2, q[:2] + q[2:] / 2)
        common = np.clip(high - low, 0, None).prod()
        return common / (p[2:].prod() + q[2:].prod() - common)

    t, anchors = raw.double().numpy().reshape(2, 2, 8, 3, 4), ANCHORS.double().numpy()
    goal, total = truth(), 0.0
    boxes = goal.box.double().numpy()
    owners = {}
    for m, box in enumerate(boxes):
        shapes = [iou(np.r_[0, 0, box[2:]], np.r_[0, 0, a]) for a in anchors]
        owners[int(goal.image[m]), int(np.argmax(shapes)), int(box[1]), int(box[0])] = m
    for b, a, r, c in np.ndindex(2, 2, 3, 4):
        x = t[b, a, :, r, c]
        said = np.r_[c + sigmoid(x[0]), r + sigmoid(x[1]), anchors[a] * np.exp(x[2:4])]
        if (m := owners.get((b, a, r, c))) is not None:
            box, small = boxes[m], 2 - boxes[m, 2] * boxes[m, 3] / 12
            place = (sigmoid(x[:2]) - (box[:2] - [c, r])) ** 2
            size = (x[2:4] - np.log(box[2:] / anchors[a])) ** 2
            total += scales.box * small * (place.sum() + size.sum())
            total += scales.object * (sigmoid(x[4]) - iou(said, box)) ** 2
            total += scales.label * (np.log(np.exp(x[5:]).sum()) - x[5 + int(goal.label[m])])
        elif max([iou(said, box) for m, box in enumerate(boxes) if goal.image[m] == b]) <= 0.6:
            total += scales.nothing * sigmoid(x[4]) ** 2
    return total / 2


@pytest.mark.parametrize("scales", [LossScales(), LossScales(3.0, 0.7, 1.3, 2.0)])
def test_the_loss_is_that_of_a_slow_loop(scales):
    raw = torch.randn(2, 16, 3, 4, generator=torch.Generator().manual_seed(0)) * 0.5
    assert float(yolo_loss(answers(raw, ANCHORS), truth(), ANCHORS, scales)) == pytest.approx(slow_loss(raw, scales))


def test_only_better_answers_lower_it():
    raw = torch.zeros(2, 16, 3, 4, requires_grad=True)
    losses = []
    for _ in range(200):
        loss = yolo_loss(answers(raw, ANCHORS), truth(), ANCHORS)
        (slope,) = torch.autograd.grad(loss, raw)
        raw = (raw - 0.5 * slope).detach().requires_grad_()
        losses.append(float(loss.detach()))
    said = answers(raw.detach(), ANCHORS)
    assert losses[-1] < 0.05 * losses[0]
    torch.testing.assert_close(said.box[0, 0, 1, 2], truth().box[0], atol=0.05, rtol=0.0)
    assert said.class_logits[1, 0, 2, 3].argmax() == 1
    assert said.objectness[0, 0, 1, 2] > 0.8 and said.objectness[1, 1, 0, 0] < 0.2

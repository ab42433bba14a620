from __future__ import annotations

import numpy as np
import pytest
import torch

from eaip_prob.detection.yolo.decoding import answers, box_iou
from eaip_prob.errors import ShapeError


def test_answers_are_the_formula_of_the_paper_in_a_slow_loop():
    g = torch.Generator().manual_seed(0)
    raw, anchors = torch.randn(2, 3 * 7, 4, 5, generator=g), torch.tensor([[1.0, 2.0], [3.0, 1.5], [0.5, 0.7]])
    said = answers(raw, anchors)
    for b, a, r, c in [(0, 0, 0, 0), (1, 2, 3, 4), (0, 1, 2, 3), (1, 0, 3, 0)]:
        t = raw[b, 7 * a : 7 * a + 7, r, c].double().numpy()
        box = [
            c + 1 / (1 + np.exp(-t[0])),
            r + 1 / (1 + np.exp(-t[1])),
            float(anchors[a, 0]) * np.exp(t[2]),
            float(anchors[a, 1]) * np.exp(t[3]),
        ]
        assert said.box[b, a, r, c].tolist() == pytest.approx(box, rel=1e-5)
        assert float(said.objectness[b, a, r, c]) == pytest.approx(1 / (1 + np.exp(-t[4])), rel=1e-5)
        assert said.class_logits[b, a, r, c].tolist() == pytest.approx(t[5:].tolist())


def test_wild_answers_stay_finite():
    assert answers(torch.full((1, 6, 1, 1), 1e4), torch.ones(1, 2)).box.isfinite().all()


def test_channels_that_fit_no_anchors_are_refused():
    for channels in (13, 10):
        with pytest.raises(ShapeError, match=r"2 x \(5 \+ C\)"):
            answers(torch.zeros(1, channels, 2, 2), torch.ones(2, 2))


def test_iou_is_that_of_pixels():
    rng = np.random.default_rng(0)
    y, x = np.mgrid[:30, :30] + 0.5
    for _ in range(20):
        low, size = rng.integers(0, 15, (2, 2)), rng.integers(1, 15, (2, 2))
        masks = [
            (x > lo[0]) & (x < lo[0] + s[0]) & (y > lo[1]) & (y < lo[1] + s[1]) for lo, s in zip(low, size, strict=True)
        ]
        boxes = torch.tensor(np.concatenate([low + size / 2, size], -1))
        expected = (masks[0] & masks[1]).sum() / (masks[0] | masks[1]).sum()
        assert float(box_iou(boxes[0], boxes[1])) == pytest.approx(expected)

from __future__ import annotations

import numpy as np
import pytest

from eaip_prob.detection.boxes import box_iou, suppressed


def test_overlap_is_that_of_areas():
    rng = np.random.default_rng(2)
    points = rng.uniform(0.0, 10.0, (200_000, 2))
    for _ in range(5):
        boxes = np.column_stack([rng.uniform(3.0, 7.0, (2, 2)), rng.uniform(1.0, 6.0, (2, 2))])
        first, second = ((np.abs(points - box[:2]) <= box[2:] / 2).all(1) for box in boxes)
        sampled = (first & second).sum() / (first | second).sum()
        assert box_iou(*boxes) == pytest.approx(sampled, abs=0.01)
    assert box_iou(np.array([0.0, 0.0, 1.0, 1.0]), np.array([5.0, 5.0, 1.0, 1.0])) == 0.0


def test_suppression_keeps_the_best_of_each_heap():
    box = np.array([[10.0, 10, 8, 8], [11.0, 10, 8, 8], [30.0, 10, 8, 8], [12.0, 10, 8, 8]])
    score, label = np.array([0.5, 0.9, 0.3, 0.7]), np.array([0, 0, 0, 1])
    assert suppressed(box, score).tolist() == [1, 2]
    assert suppressed(box, score, label).tolist() == [1, 3, 2]
    assert suppressed(box, score, overlap=0.7).tolist() == [1, 2]  # IoU 7/9 of both
    assert suppressed(box, score, overlap=0.8).tolist() == [1, 3, 0, 2]
    assert suppressed(np.zeros((0, 4)), np.zeros(0)).tolist() == []


def test_weaker_boxes_are_suppressed_as_in_a_slow_loop():
    generator = np.random.default_rng(3)
    box = np.concatenate([generator.uniform(0, 30, (60, 2)), generator.uniform(4, 12, (60, 2))], 1)
    score, labels = generator.uniform(size=60), generator.choice(["chair", "table"], 60)

    def iou(a, b):
        sides = [
            min(a[i] + a[i + 2] / 2, b[i] + b[i + 2] / 2) - max(a[i] - a[i + 2] / 2, b[i] - b[i + 2] / 2)
            for i in (0, 1)
        ]
        shared = max(sides[0], 0.0) * max(sides[1], 0.0)
        return shared / (a[2] * a[3] + b[2] * b[3] - shared)

    for names in (labels, None):
        kept = []
        for index in sorted(range(60), key=lambda i: -score[i]):
            rivals = [k for k in kept if names is None or names[k] == names[index]]
            if all(iou(box[k], box[index]) <= 0.3 for k in rivals):
                kept.append(index)
        assert suppressed(box, score, names, 0.3).tolist() == kept
    assert suppressed(box[:0], score[:0], None, 0.3).shape == (0,)

from __future__ import annotations

import numpy as np
import pytest

from eaip_prob.detection.yolo.anchors import anchors_from_boxes, shape_iou
from eaip_prob.errors import InputError, ShapeError


def test_iou_of_shapes_is_that_of_pixels():
    rng = np.random.default_rng(0)
    boxes, anchors = rng.integers(1, 40, (6, 2)), rng.integers(1, 40, (4, 2))
    y, x = np.mgrid[:40, :40]
    for i, (w, h) in enumerate(boxes):
        for j, (v, g) in enumerate(anchors):
            one, other = (x < w) & (y < h), (x < v) & (y < g)
            expected = (one & other).sum() / (one | other).sum()
            assert shape_iou(boxes.astype(float), anchors.astype(float))[i, j] == pytest.approx(expected)


def test_anchors_sit_on_the_medians_of_groups():
    rng = np.random.default_rng(1)
    centres = np.array([[1.0, 1.5], [2.5, 1.0], [3.0, 4.0]])
    boxes = np.concatenate([centre * np.exp(rng.normal(0.0, 0.05, (51, 2))) for centre in centres])
    found = anchors_from_boxes(boxes, 3, np.random.default_rng(2))
    groups = [np.median(boxes[51 * k : 51 * (k + 1)], 0) for k in range(3)]
    np.testing.assert_allclose(found, sorted(groups, key=np.prod), rtol=1e-12)


def test_anchors_are_better_than_boxes_picked_at_random():
    rng = np.random.default_rng(3)
    boxes = np.exp(rng.normal(0.5, 0.5, (300, 2)))
    found = shape_iou(boxes, anchors_from_boxes(boxes, 5, np.random.default_rng(0))).max(1).mean()
    picked = [shape_iou(boxes, boxes[rng.choice(300, 5)]).max(1).mean() for _ in range(200)]
    assert found > max(picked)
    again = anchors_from_boxes(boxes, 5, np.random.default_rng(0))
    np.testing.assert_array_equal(again, anchors_from_boxes(boxes, 5, np.random.default_rng(0)))


@pytest.mark.parametrize(
    ("boxes", "error"),
    [(np.ones((3, 3)), ShapeError), (np.ones((9, 2)), InputError), (np.array([[1.0, 0.0], [1.0, 2.0]]), InputError)],
)
def test_bad_boxes_are_refused(boxes, error):
    with pytest.raises(error, match="Expected"):
        anchors_from_boxes(boxes, 2, np.random.default_rng(0))

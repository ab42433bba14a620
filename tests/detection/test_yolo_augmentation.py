from __future__ import annotations

import numpy as np
import pytest
from detector_world import rectangles

from eaip_prob.detection.yolo.augmentation import Augmentation
from eaip_prob.detection.yolo.batches import Batches
from eaip_prob.detection.yolo.pasting import cut_out, pasted
from eaip_prob.errors import InputError


def plain(**changes):
    return Augmentation(**{"recolor": 0.0, "cover": 0.0, "blur": 0.0, "noise": 0.0, "paste": 0, **changes})


def test_boxes_follow_the_pixels():
    images, change = rectangles(24), plain()
    for index in range(24):
        generator = np.random.default_rng(index)
        view = images.image[index], images.box[index], images.visible[index]
        picture, box = change.apply(*view, (96, 64), 1.0, generator)
        rows, columns = np.nonzero(picture[..., images.label[index] % 2] > 1.6 * picture[..., 2].astype(float) + 50)
        seen = [columns.min(), rows.min(), columns.max() + 1, rows.max() + 1]
        edges = np.concatenate([box[:2] - box[2:] / 2, box[:2] + box[2:] / 2])
        np.testing.assert_allclose(edges, seen, atol=1.6)
        assert (edges >= -1e-9).all() and (edges <= [96, 64, 96, 64]).all()


def test_changes_follow_from_the_generator_and_leave_the_image():
    images = rectangles(1)
    before = images.image.copy()
    arguments = images.image[0], images.box[0], images.visible[0], (96, 64), 1.0
    one, other, third = (Augmentation().apply(*arguments, np.random.default_rng(seed))[0] for seed in (0, 0, 1))
    assert (one == other).all() and (one != third).any() and (images.image == before).all()


def test_the_object_is_recoloured_apart_from_the_room():
    images, change = rectangles(1), plain(recolor=1.0, zoom=1.0, stretch=1.0)
    ratios = []
    for seed in range(40):
        picture, box = change.reframed(
            images.image[0], images.box[0], images.visible[0], (96, 64), 1.0, np.random.default_rng(seed)
        )
        low, high = (box[:2] - box[2:] / 2 + 2).astype(int), (box[:2] + box[2:] / 2 - 2).astype(int)
        ratios.append(picture[low[1] : high[1], low[0] : high[0]].mean((0, 1)).argmax())
    assert len(set(ratios)) == 3  # red became each of the colours


def test_pieces_are_pasted_where_they_hide_nothing_that_is_labelled():
    piece, mask = np.full((10, 12, 3), 200, np.uint8), np.ones((10, 12), bool)
    mask[0] = False
    boxes = np.array([[40.0, 20.0, 30.0, 20.0]])
    for seed in range(30):
        image = np.zeros((48, 80, 3), np.uint8)
        box = pasted(image, boxes, piece, mask, np.random.default_rng(seed))
        assert box is not None
        left, top = (box[:2] - box[2:] / 2).astype(int)
        assert not image[top, left : left + 12].any() and (image[top + 1 : top + 10, left : left + 12] == 200).all()
        assert (image > 0).any(-1).sum() == 9 * 12
        assert (image[10:30, 25:55] > 0).any(-1).sum() < 0.16 * 120
    assert pasted(np.zeros((8, 80, 3), np.uint8), boxes, piece, mask, np.random.default_rng(0)) is None
    with pytest.raises(InputError, match="mask"):
        pasted(np.zeros((48, 80, 3), np.uint8), boxes, piece, mask[1:], np.random.default_rng(0))


def test_a_cut_out_is_the_object():
    images = rectangles(4)
    for index in range(4):
        piece, mask = cut_out(images.image[index], images.box[index], images.visible[index], (1.0, 1.0))
        assert mask.all() and mask.shape == tuple(images.box[index, [3, 2]]) and (piece[..., index % 2] == 250).all()


def test_a_batch_holds_every_box_of_every_image():
    batches = Batches(rectangles(8), 1.0, Augmentation(paste=3))
    image, truth = batches.batch(np.arange(8), (96, 64), np.random.default_rng(0))
    assert image.shape == (8, 3, 64, 96) and image.min() >= 0.0 and image.max() <= 1.0
    first = [int(truth.label[truth.image == k][0]) for k in range(8)]
    assert first == [0, 1, 2, 3, 0, 1, 2, 3] and len(truth.label) > 12
    low, high = truth.box[:, :2], truth.box[:, :2]
    assert (low >= 0).all() and (high[:, 0] < 3).all() and (high[:, 1] < 2).all()
    alone = Batches(rectangles(8), 1.0, Augmentation(paste=0))
    assert len(alone.batch(np.arange(8), (96, 64), np.random.default_rng(0))[1].label) == 8


def test_a_near_cut_keeps_the_scale_and_most_of_the_object():
    images, change = rectangles(24, size=(320, 192)), plain(zoom=1.0, stretch=1.0)
    for index in range(24):
        view = images.image[index], images.box[index], images.visible[index]
        picture, box = change.apply(*view, (64, 64), 1.0, np.random.default_rng(index))
        assert picture.shape == (64, 64, 3)
        assert box[2:].tolist() == images.box[index, 2:].tolist()  # whole, and as large as it was

"""Small pictures of bright rectangles, two of them wide and two of them high, as labelled images."""

from __future__ import annotations

import numpy as np

from eaip_prob.detection.labelled import LabelledImages
from eaip_prob.detection.yolo.weights_file import YoloSettings

SMALL = YoloSettings(1 / 16, (96, 64), ((1.0, 0.5), (0.5, 1.0)), ("chair", "stepladder", "table", "bookshelf"))


def rectangles(num: int, seed: int = 0, size: tuple[int, int] = (96, 64)) -> LabelledImages:
    """Class 0 is red and high, 1 green and high, 2 red and wide, 3 green and wide."""
    rng = np.random.default_rng(seed)
    image = rng.integers(0, 30, (num, size[1], size[0], 3), np.uint8)
    visible, box, label = np.zeros(image.shape[:3], bool), np.zeros((num, 4)), np.arange(num) % 4
    for index in range(num):
        wide, high = (16, 32) if label[index] < 2 else (32, 16)
        left, top = int(rng.integers(0, size[0] - wide)), int(rng.integers(0, size[1] - high))
        visible[index, top : top + high, left : left + wide] = True
        image[index, top : top + high, left : left + wide, label[index] % 2] = 250
        box[index] = left + (wide - 1) / 2, top + (high - 1) / 2, wide, high
    return LabelledImages(image, box, label, visible)

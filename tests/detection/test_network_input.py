from __future__ import annotations

import cv2
import numpy as np
import pytest

from eaip_prob.detection import NetworkInput
from eaip_prob.detection.labelled import LabelledImages
from eaip_prob.detection.network_input import in_image, part_of
from eaip_prob.errors import InputError


@pytest.mark.parametrize("region", [(0.0, 0.0, 1.0, 1.0), (0.1, 0.2, 0.8, 0.9)])
@pytest.mark.parametrize("fit", ["corner", "center", "stretch"])
def test_what_stands_in_the_image_is_found_where_it_was(fit, region):
    image = np.zeros((90, 200, 3), np.uint8)
    image[30:60, 40:120] = 255
    values, factor, offset = NetworkInput((96, 64), fit=fit, fill=0, region=region).prepared(image)
    rows, columns = np.nonzero(values[0, 0] > 0.5)
    low, high = np.array([columns.min(), rows.min()]), np.array([columns.max(), rows.max()]) + 1.0
    box = in_image(np.array([[*(low + high) / 2, *(high - low)]]), factor, offset, (200, 90))
    np.testing.assert_allclose(box, [[79.5, 44.5, 80.0, 30.0]], atol=1.2 / factor.min())


@pytest.mark.parametrize("width", [400, 399, 120])  # halved, odd, and too small for that
def test_halves_of_a_large_image_show_what_one_step_would(width):
    rng = np.random.default_rng(0)
    image = cv2.resize(rng.integers(0, 255, (12, 30, 3), np.uint8), (width, 160), interpolation=cv2.INTER_CUBIC)
    shown, factor, _ = NetworkInput((64, 48), fit="stretch").filled(image)
    once = cv2.resize(image, (64, 48), interpolation=cv2.INTER_AREA)
    assert factor.tolist() == [64 / width, 48 / 160] and shown.shape == (48, 64, 3)
    assert np.abs(shown.astype(float) - once).mean() < 4.0
    assert width == 400 or (shown == once).all()


def test_boxes_beyond_the_image_keep_a_pixel():
    beyond = in_image(np.array([[500.0, -50.0, 20.0, 20.0]]), np.ones(2), np.zeros(2), (200, 90))
    assert (beyond[:, 2:] >= 1.0).all() and (beyond[:, 0] <= 199.5).all() and (beyond[:, 1] >= 0.0).all()


def test_an_image_of_one_column_has_an_input():
    assert NetworkInput((32, 32)).prepared(np.zeros((10, 1, 3), np.uint8))[0].shape == (1, 3, 32, 32)


@pytest.mark.parametrize("region", [(0.0, 0.0, 1.0), (0.5, 0.0, 0.5, 1.0), (0.0, 0.0, 1.1, 1.0), (-0.1, 0.0, 1.0, 1.0)])
def test_regions_without_an_area_are_refused(region):
    with pytest.raises(InputError, match="left, top, right, bottom"):
        NetworkInput((32, 32), region=region)


def test_labelled_images_are_cut_with_their_boxes():
    image = np.random.default_rng(0).integers(0, 255, (3, 40, 80, 3), np.uint8)
    box = np.array([[30.0, 20.0, 20.0, 10.0], [23.0, 20.0, 10.0, 10.0], [5.0, 20.0, 8.0, 8.0]])
    visible = np.zeros((3, 40, 80), bool)
    visible[0, 16:25, 21:40] = True
    part = LabelledImages(image, box, np.array([0, 1, 2]), visible).within((0.25, 0.25, 1.0, 1.0))
    assert len(part) == 2 and part.names == ["chair", "stepladder"] and part.size == (60, 30)
    corner, pixels = part_of(image[0], (0.25, 0.25, 1.0, 1.0))
    assert corner.tolist() == [20, 10] and np.array_equal(part.image[0], pixels)
    np.testing.assert_allclose(part.box[0], [10.0, 10.0, 20.0, 10.0])
    # the second began at 18, two pixels before the part, which begins with the edge of its first pixel
    np.testing.assert_allclose(part.box[1], [(-0.5 + 8.0) / 2, 10.0, 8.5, 10.0])
    assert part.visible[0].sum() == visible[0].sum()

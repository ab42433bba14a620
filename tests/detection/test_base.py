from __future__ import annotations

import numpy as np
import pytest
from detection_world import COLOR, room, seen, shelf

from eaip_prob.detection.base import AbstractImageDetector, Detections, check_image, frame_of
from eaip_prob.errors import InputError, ShapeError

BOXES = np.array([[10.0, 20.0, 4.0, 6.0], [30.0, 10.0, 8.0, 2.0], [50.0, 40.0, 2.0, 2.0]])


def three(**changed) -> Detections:
    known = {"labels": ("chair", "table", "chair"), "score": np.array([0.9, 0.5, 0.1]), "box": BOXES}
    return Detections(**(known | {"image_size": (80, 45)} | changed))


def test_corners_are_half_a_size_from_the_centre():
    assert three().corners[1].tolist() == [26.0, 9.0, 34.0, 11.0]


def test_some_detections_keep_what_belongs_to_them():
    place = np.arange(18.0).reshape(3, 6)
    covariance = np.arange(3.0)[:, None, None] * np.eye(6)
    chosen = three(place=place, place_covariance=covariance)[np.array([2, 0])]
    assert chosen.labels == ("chair", "chair") and chosen.score.tolist() == [0.1, 0.9]
    assert chosen.box.tolist() == BOXES[[2, 0]].tolist() and chosen.place.tolist() == place[[2, 0]].tolist()
    assert chosen.place_covariance[0, 0, 0] == 2.0 and chosen.box_covariance is None


@pytest.mark.parametrize(
    ("changed", "error", "message"),
    [
        ({"score": np.ones(2)}, ShapeError, "score"),
        ({"box": BOXES[:2]}, ShapeError, "box"),
        ({"box_covariance": np.zeros((3, 4))}, ShapeError, "box_covariance"),
        ({"place": np.zeros((3, 6))}, InputError, "together"),
        ({"score": np.array([0.5, 1.5, 0.1])}, InputError, "0 to 1"),
        ({"score": np.array([0.5, np.nan, 0.1])}, InputError, "0 to 1"),
        ({"box": BOXES * [1.0, 1.0, 0.0, 1.0]}, InputError, "area"),
    ],
)
def test_what_does_not_fit_together_is_refused(changed, error, message):
    with pytest.raises(error, match=message):
        three(**changed)


@pytest.mark.parametrize(
    ("image", "error"),
    [
        (np.zeros((4, 4), np.uint8), ShapeError),
        (np.zeros((4, 4, 4), np.uint8), ShapeError),
        (np.zeros((0, 4, 3), np.uint8), ShapeError),
        (np.zeros((4, 4, 3), np.float32), InputError),
    ],
)
def test_what_is_no_image_is_refused(image, error):
    with pytest.raises(error, match="image"):
        check_image(image)


class Fixed(AbstractImageDetector):
    def detect_image(self, image):
        check_image(image)
        return Detections(("chair",), np.ones(1), self.box[None], (image.shape[1], image.shape[0]))


def test_a_detector_of_images_reads_its_camera_and_places_what_it_finds():
    scene = room(shelf())
    frames = [seen(scene, name) for name in ("left", "right")]
    detector = Fixed("right")
    detector.box = frame_of(frames, "right").objects[0].box
    answer = detector.detect(frames)
    assert answer.image_size == (COLOR.width, COLOR.height)
    assert answer.place[0] == pytest.approx(frames[1].objects[0].place, abs=0.06)
    with pytest.raises(InputError, match="'overhead'.*camera=NAME"):
        Fixed("overhead").detect(frames)

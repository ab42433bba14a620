from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch
from detector_world import SMALL, rectangles

from eaip_prob.detection.validation import judged
from eaip_prob.detection.yolo.detector import SHIPPED, YoloDetector, decoded
from eaip_prob.detection.yolo.network import YoloNetwork
from eaip_prob.detection.yolo.weights_file import write_weights
from eaip_prob.errors import DataFileError, InputError, MissingDataError, ShapeError


@pytest.fixture
def weights(tmp_path: Path) -> Path:
    network = YoloNetwork(SMALL.shape, torch.Generator().manual_seed(0))
    return write_weights(tmp_path / "weights.safetensors", network, SMALL, {})


def planted(raw: torch.Tensor, anchor: int, row: int, column: int, label: int, sure: float) -> None:
    raw.view(1, 2, 9, *raw.shape[2:])[0, anchor, :, row, column] = torch.tensor([0, 0, 0, 0, sure, *[0.0] * 4])
    raw.view(1, 2, 9, *raw.shape[2:])[0, anchor, 5 + label, row, column] = 20.0


def test_what_the_network_says_arrives_as_detections(weights, monkeypatch):
    detector = YoloDetector(weights)
    raw = torch.full((1, 18, 2, 3), -9.0)
    planted(raw, 0, 0, 2, 3, sure=2.0)
    planted(raw, 1, 1, 0, 1, sure=4.0)
    planted(raw, 0, 1, 0, 0, sure=-3.0)
    monkeypatch.setattr(detector, "_network", lambda image: raw)
    found = detector.detect_image(np.zeros((128, 192, 3), np.uint8))
    assert found.labels == ("stepladder", "bookshelf") and found.image_size == (192, 128)
    # Cells of 32 px of the input are 64 px here; pixel 0 has its centre half a pixel inside.
    np.testing.assert_allclose(found.box, [[31.5, 95.5, 32.0, 64.0], [159.5, 31.5, 64.0, 32.0]], atol=1e-4)
    np.testing.assert_allclose(found.score, 1 / (1 + np.exp([-4.0, -2.0])), atol=1e-6)
    deviation = 0.05 * found.box[0, [2, 3, 2, 3]]
    assert found.box_covariance is not None
    np.testing.assert_allclose(found.box_covariance[0], np.diag(deviation**2))
    assert len(YoloDetector(weights, threshold=1.0).detect_image(np.zeros((128, 192, 3), np.uint8))) == 0


def test_scores_are_calibrated():
    raw = torch.zeros(1, 18, 1, 1)
    plain, (_, steep, _) = decoded(raw, SMALL)[1], decoded(raw, replace(SMALL, score_slope=2.0, score_offset=1.0))
    assert plain == pytest.approx(0.125)
    assert steep == pytest.approx(1 / (1 + np.exp(-(2.0 * np.log(0.125 / 0.875) + 1.0))))


def test_a_network_that_sees_a_part_answers_in_the_whole_image(tmp_path, monkeypatch):
    settings = replace(SMALL, region=(0.25, 0.5, 1.0, 1.0))
    network = YoloNetwork(settings.shape, torch.Generator().manual_seed(0))
    detector = YoloDetector(write_weights(tmp_path / "part.safetensors", network, settings, {}))
    raw, shown = torch.full((1, 18, 2, 3), -9.0), []
    planted(raw, 0, 0, 0, 3, sure=2.0)
    monkeypatch.setattr(detector, "_network", lambda image: shown.append(image) or raw)
    image = np.zeros((256, 256, 3), np.uint8)
    image[128:, 64:] = 255
    found = detector.detect_image(image)
    # The part of 192 x 128 px starts at (64, 128); a cell of the input is 64 px of the image.
    np.testing.assert_allclose(found.box, [[95.5, 159.5, 64.0, 32.0]], atol=1e-4)
    assert found.image_size == (256, 256) and float(shown[0].min()) == 1.0


def test_bad_images_and_arguments_are_refused(weights):
    detector = YoloDetector(weights)
    for image, error, message in [
        (np.zeros((9, 9), np.uint8), ShapeError, "RGB"),
        (np.zeros((9, 9, 4), np.uint8), ShapeError, "RGB"),
        (np.zeros((0, 9, 3), np.uint8), ShapeError, "RGB"),
        (np.zeros((9, 9, 3)), InputError, "uint8"),
    ]:
        with pytest.raises(error, match=message):
            detector.detect_image(image)
    with pytest.raises(InputError, match="threshold and overlap"):
        YoloDetector(weights, threshold=1.5)
    with pytest.raises(MissingDataError, match="train_detector"):
        YoloDetector("no/such/file.safetensors")
    weights.write_bytes(b"cut off")
    with pytest.raises(DataFileError, match="damaged"):
        YoloDetector(weights)


def test_an_untrained_network_is_judged(weights):
    one = judged(YoloDetector(weights, threshold=0.0), rectangles(4))
    assert len(one.said) == 4 and np.isfinite(one.error).all() and (one.iou < 1.0).all()


def test_the_shipped_weights_are_small_enough_and_find_nothing_in_the_dark():
    assert SHIPPED.stat().st_size < 15e6
    detector = YoloDetector()
    assert detector.settings.input_size == (192, 192)
    assert len(detector.detect_image(np.zeros((540, 960, 3), np.uint8))) == 0


@pytest.mark.slow
def test_onnx_says_the_same(weights, tmp_path):
    pytest.importorskip("onnxscript")
    import cv2

    from eaip_prob.detection.yolo.export import export_onnx
    from eaip_prob.detection.yolo.weights_file import read_weights

    path = export_onnx(weights, tmp_path / "network.onnx")
    image = np.random.default_rng(0).random((1, 3, 64, 96), np.float32)
    net = cv2.dnn.readNetFromONNX(str(path))
    net.setInput(image)
    with torch.inference_mode():
        expected = read_weights(weights)[0](torch.from_numpy(image)).numpy()
    np.testing.assert_allclose(net.forward(), expected, atol=1e-4)

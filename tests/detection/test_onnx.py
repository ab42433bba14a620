from __future__ import annotations

import math

import numpy as np
import pytest
from detection_world import ANCHORS, SAID, tiny_network
from omegaconf import OmegaConf

from eaip_prob.config import build, conf_dir
from eaip_prob.detection.network_input import NetworkInput
from eaip_prob.detection.onnx import OnnxDetector
from eaip_prob.detection.onnx_layouts import YoloV2Layout, YoloV8Layout, YoloXLayout
from eaip_prob.detection.onnx_metadata import read_settings
from eaip_prob.errors import DataFileError, InputError, ShapeError

INPUT, NAMES = NetworkInput((64, 32)), ["seat", "lamp", "desk"]
CLASSES = {"seat": "chair", "desk": "table"}
IMAGE = np.zeros((270, 480, 3), np.uint8)


def sigmoid(value):
    return 1.0 / (1.0 + math.exp(-value))


def slow_v2(output, anchors, classes):
    box, score = [], []
    rows, columns = output.shape[2:]
    for anchor, (width, height) in enumerate(anchors):
        for row in range(rows):
            for column in range(columns):
                t = [float(output[0, anchor * (5 + classes) + k, row, column]) for k in range(5 + classes)]
                box.append([(sigmoid(t[0]) + column) * 32, (sigmoid(t[1]) + row) * 32])
                box[-1] += [width * math.exp(t[2]) * 32, height * math.exp(t[3]) * 32]
                total = sum(math.exp(value) for value in t[5:])
                score.append([sigmoid(t[4]) * math.exp(value) / total for value in t[5:]])
    return np.array(box), np.array(score)


def slow_x(output, size, strides):
    box, score, index = [], [], 0
    for stride in strides:
        for row in range(size[1] // stride):
            for column in range(size[0] // stride):
                t = output[0, index].astype(float)
                box.append([(t[0] + column) * stride, (t[1] + row) * stride])
                box[-1] += [math.exp(t[2]) * stride, math.exp(t[3]) * stride]
                score.append([t[4] * value for value in t[5:]])
                index += 1
    return np.array(box), np.array(score)


def outputs(generator):
    v2 = generator.normal(0.0, 1.0, (1, 3 * 8, 1, 2)).astype(np.float32)
    x = generator.uniform(0.0, 1.0, (1, 32 + 8 + 2, 8)).astype(np.float32)
    v8 = generator.uniform(0.0, 1.0, (1, 7, 11)).astype(np.float32)
    return v2, x, v8


def test_layouts_agree_with_slow_loops():
    v2, x, v8 = outputs(np.random.default_rng(0))
    cases = [
        (YoloV2Layout(ANCHORS).decode(v2, (64, 32), 3), slow_v2(v2, ANCHORS, 3)),
        (YoloXLayout().decode(x, (64, 32), 3), slow_x(x, (64, 32), (8, 16, 32))),
        (YoloV8Layout().decode(v8, (64, 32), 3), (v8[0, :4].T, v8[0, 4:].T)),
    ]
    for (box, score), (slow_box, slow_score) in cases:
        assert box == pytest.approx(slow_box, rel=1e-6) and score == pytest.approx(slow_score, rel=1e-6)


def test_a_calibrated_score_keeps_the_order_and_the_formula():
    v2 = outputs(np.random.default_rng(1))[0]
    plain, turned = (YoloV2Layout(ANCHORS, 32, a, b).decode(v2, (64, 32), 3)[1] for a, b in ((1.0, 0.0), (1.7, -0.4)))
    expected = [[sigmoid(1.7 * math.log(p / (1.0 - p)) - 0.4) for p in row] for row in plain]
    assert turned == pytest.approx(np.array(expected), rel=1e-6)


def test_wild_answers_stay_finite():
    v2 = np.full((1, 24, 1, 2), 1e4, np.float32)
    box, score = YoloV2Layout(ANCHORS).decode(v2, (64, 32), 3)
    assert np.isfinite(box).all() and np.isfinite(score).all()


@pytest.mark.parametrize("size", [(270, 480), (480, 270), (32, 64), (20, 20)])
@pytest.mark.parametrize("fit", ["corner", "center", "stretch"])
def test_places_in_the_input_are_found_again(size, fit):
    image = np.zeros((*size, 3), np.uint8)
    rows, columns = (slice(int(0.25 * n), int(0.75 * n)) for n in size)
    image[rows, columns] = (255, 128, 0)
    values, factor, offset = NetworkInput((64, 32), fit, fill=0, order="bgr", scale=1.0).prepared(image)
    weight = values[0, 2].astype(float)
    assert values.shape == (1, 3, 32, 64) and weight.max() == 255.0 and values[0, 0].max() == 0.0
    middle = np.array([(weight.sum(0) * (np.arange(64) + 0.5)).sum(), (weight.sum(1) * (np.arange(32) + 0.5)).sum()])
    true = np.array([(columns.start + columns.stop) / 2, (rows.start + rows.stop) / 2])
    assert (middle / weight.sum() - offset) / factor == pytest.approx(true, abs=0.3 / factor.min())


def v8_network(path, boxes, scores, **more):
    return tiny_network(path, np.concatenate([np.array(boxes).T, np.array(scores).T])[None], **more)


def test_boxes_come_back_in_the_image_with_the_names_of_the_task(tmp_path):
    boxes = [[32.0, 8.0, 16.0, 8.0], [34.0, 9.0, 16.0, 8.0], [12.0, 20.0, 8.0, 8.0], [50.0, 20.0, 8.0, 8.0]]
    scores = [[0.1, 0.0, 0.8], [0.6, 0.2, 0.3], [0.1, 0.9, 0.2], [0.55, 0.5, 0.1]]
    path = v8_network(tmp_path / "net.onnx", boxes, scores)
    detector = OnnxDetector(path, YoloV8Layout(), INPUT, NAMES, CLASSES, threshold=0.5, box_std=0.1)
    answer = detector.detect_image(IMAGE)  # eight image pixels and a half for each of the input, from the corner
    assert answer.labels == ("table", "chair") and answer.score == pytest.approx([0.8, 0.55])
    factor = 32 / 270
    assert answer.box[0] == pytest.approx([32 / (57 / 480) - 0.5, 8 / factor - 0.5, 16 / (57 / 480), 8 / factor])
    assert answer.box_covariance[0].diagonal() == pytest.approx((0.1 * np.tile(answer.box[0, 2:], 2)) ** 2)
    both = OnnxDetector(path, YoloV8Layout(), INPUT, NAMES, CLASSES, threshold=0.5, per_class=True)
    assert both.detect_image(IMAGE).labels == ("table", "chair", "chair")
    none = OnnxDetector(path, YoloV8Layout(), INPUT, NAMES, CLASSES, threshold=0.95).detect_image(IMAGE)
    assert len(none) == 0 and none.image_size == (480, 270)


def test_boxes_are_cut_off_at_the_image(tmp_path):
    path = v8_network(tmp_path / "net.onnx", [[0.0, 0.0, 20.0, 10.0], [-30.0, 5.0, 4.0, 4.0]], [[0.9, 0, 0]] * 2)
    answer = OnnxDetector(path, YoloV8Layout(), INPUT, NAMES, CLASSES).detect_image(IMAGE)
    assert len(answer) == 1 and answer.corners[0, :2].tolist() == [-0.5, -0.5]


@pytest.mark.parametrize("layout", [YoloV2Layout(ANCHORS), YoloXLayout(), YoloV8Layout()])
def test_a_network_of_each_family_is_read(layout, tmp_path):
    output = dict(zip((YoloV2Layout, YoloXLayout, YoloV8Layout), outputs(np.random.default_rng(2)), strict=True))
    path = tiny_network(tmp_path / "net.onnx", output[type(layout)])
    box, score = layout.decode(output[type(layout)], (64, 32), 3)
    answer = OnnxDetector(path, layout, INPUT, NAMES, CLASSES, threshold=0.0, overlap=1.0).detect_image(IMAGE)
    assert answer.score[0] == pytest.approx(score[:, [0, 2]].max(), rel=1e-5)
    assert len(answer) <= len(box)
    wrong = YoloXLayout() if not isinstance(layout, YoloXLayout) else YoloV8Layout()
    with pytest.raises(ShapeError, match=f"{type(wrong).__name__}, got .*layout"):
        OnnxDetector(path, wrong, INPUT, NAMES, CLASSES)


def test_a_file_may_say_itself_what_it_is(tmp_path):
    output = outputs(np.random.default_rng(4))[0]
    path = tiny_network(tmp_path / "net.onnx", output, said=SAID)
    alone = OnnxDetector(path, threshold=0.05)
    told = OnnxDetector(
        path,
        YoloV2Layout(ANCHORS, 32, 1.5, -0.2),
        INPUT,
        SAID["classes"],
        {name: name for name in SAID["classes"]},
        threshold=0.05,
    )
    one, other = alone.detect_image(IMAGE), told.detect_image(IMAGE)
    assert len(one) > 0 and one.labels == other.labels and one.box.tolist() == other.box.tolist()
    expected = (np.array([0.01, 0.02, 0.03, 0.04]) * one.box[0, [2, 3, 2, 3]]) ** 2
    assert one.box_covariance[0].diagonal() == pytest.approx(expected)
    silent = tiny_network(tmp_path / "silent.onnx", output)
    assert read_settings(silent) is None
    with pytest.raises(InputError, match=r"\['layout', 'names'\] for silent.onnx"):
        OnnxDetector(silent, input=INPUT)


def test_settings_that_are_no_literals_are_refused_and_not_executed(tmp_path):
    path = tiny_network(tmp_path / "net.onnx", np.zeros((1, 24, 1, 2)), said=SAID)
    raw = path.read_bytes()
    assert raw.count(b"(64, 32)") == 1
    path.write_bytes(raw.replace(b"(64, 32)", b"(8*8,32)"))
    with pytest.raises(DataFileError, match=r"numbers and names in net.onnx"):
        read_settings(path)


@pytest.mark.parametrize("damage", ["cut", "empty", "text"])
def test_damaged_files_are_refused(damage, tmp_path):
    whole = tiny_network(tmp_path / "net.onnx", np.zeros((1, 7, 4))).read_bytes()
    path = tmp_path / "broken.onnx"
    path.write_bytes({"cut": whole[: len(whole) // 2], "empty": b"", "text": b"no network at all"}[damage])
    with pytest.raises(DataFileError, match="broken.onnx"):
        OnnxDetector(path, YoloV8Layout(), INPUT, NAMES, CLASSES)


def test_networks_that_do_not_fit_are_refused(tmp_path):
    two = tiny_network(tmp_path / "two.onnx", np.zeros((1, 7, 4)), np.zeros((1, 7, 4)))
    with pytest.raises(DataFileError, match="one output in two.onnx, got 2"):
        OnnxDetector(two, YoloV8Layout(), INPUT, NAMES, CLASSES)
    with pytest.raises(InputError, match="no file"):
        OnnxDetector(tmp_path / "none.onnx", YoloV8Layout(), INPUT, NAMES, CLASSES)


@pytest.mark.parametrize(
    "classes", [{}, {"seat": "sofa"}, {"sofa": "chair"}, {"lamp": "lamp"}], ids=["none", "target", "source", "same"]
)
def test_classes_that_lead_nowhere_are_refused(classes, tmp_path):
    path = tiny_network(tmp_path / "net.onnx", np.zeros((1, 7, 4)))
    with pytest.raises(InputError, match="classes of the task"):
        OnnxDetector(path, YoloV8Layout(), INPUT, NAMES, classes)


def test_bad_arguments_are_refused(tmp_path):
    path = tiny_network(tmp_path / "net.onnx", np.zeros((1, 7, 4)))
    with pytest.raises(InputError, match="threshold"):
        OnnxDetector(path, YoloV8Layout(), INPUT, NAMES, CLASSES, threshold=1.5)
    with pytest.raises(InputError, match="anchors"):
        YoloV2Layout([])
    with pytest.raises(InputError, match="fit of"):
        NetworkInput((64, 32), fit="crop")
    detector = OnnxDetector(path, YoloV8Layout(), INPUT, NAMES, CLASSES)
    with pytest.raises(ShapeError, match="RGB"):
        detector.detect_image(np.zeros((4, 4), np.uint8))


def test_the_detector_is_built_from_its_configuration(tmp_path):
    path = tiny_network(tmp_path / "net.onnx", np.zeros((1, 24, 1, 2)), said=SAID)
    detector = build(OmegaConf.load(conf_dir() / "detector" / "onnx.yaml"), path=str(path))
    assert detector.names == SAID["classes"] and detector.input.size == (64, 32)

"""Cuboids on a floor seen by small Kinects, and tiny ONNX networks that put out what they are told to."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from eaip_prob.data.frames import Intrinsics, RGBDFrame
from eaip_prob.detection.base import Detections
from eaip_prob.simulation import Kinect, KinectModel, Part, Scene, box, looking_at
from eaip_prob.simulation.oracle import LabelledFrame, render_labelled

FLOOR = -0.93
DEPTH = Intrinsics(160, 132, 114.2, 114.2, 79.2, 63.7, (0.0905, -0.2683, 0.0, 0.0, 0.0951))
COLOR = Intrinsics(240, 135, 132.3, 132.4, 119.2, 64.6, (0.054, -0.068, 0.0, 0.0, 0.0))
PLACES = {"left": (0.55, 1.75, 1.15), "overhead": (0.30, 0.0, 1.55), "right": (0.55, -1.75, 1.15)}
SIZE, MIDDLE = (0.6, 0.3, 0.9), (0.95, 0.1)


def camera(name: str = "right") -> Kinect:
    model = KinectModel(DEPTH, COLOR, (-0.0519, -0.0005, 0.0001), (0.0, 1.0, 0.0))
    return Kinect(name, model, looking_at(PLACES[name], (0.95, 0.0, -0.15)))


def cuboid(name: str, low: tuple[float, ...], high: tuple[float, ...], color=(0.5, 0.3, 0.2)) -> Part:
    low_, high_ = np.array(low), np.array(high)
    middle = (low_ + high_) / 2.0
    return Part(name, box(tuple(high_ - low_), color).at(*middle))


def shelf(middle=MIDDLE, size=SIZE) -> Part:
    (x, y), (dx, dy, dz) = middle, size
    return cuboid("thing", (x - dx / 2, y - dy / 2, FLOOR), (x + dx / 2, y + dy / 2, FLOOR + dz))


def room(*parts: Part) -> Scene:
    return Scene([cuboid("floor", (-4.0, -5.0, FLOOR - 0.2), (6.0, 5.0, FLOOR)), *parts])


def seen(scene: Scene, name: str = "right", time: float = 0.0, label: str = "bookshelf") -> LabelledFrame:
    return render_labelled(scene, camera(name), time, {"thing": label})[0]


def found(frame: RGBDFrame, box_: np.ndarray, label: str = "bookshelf", score: float = 0.9) -> Detections:
    return Detections((label,), np.array([score]), np.asarray(box_, float)[None], (COLOR.width, COLOR.height))


def faces(place: np.ndarray) -> np.ndarray:
    """Lowest and highest along x, y and z."""
    return np.concatenate([place[:3] - place[3:] / 2.0, place[:3] + place[3:] / 2.0])


ANCHORS = ((1.0, 2.0), (3.0, 1.5), (0.7, 0.7))
SAID = {
    "input_size": (64, 32),
    "anchors": ANCHORS,
    "classes": ("chair", "table", "bookshelf"),
    "score_slope": 1.5,
    "score_offset": -0.2,
    "box_errors": (0.01, 0.02, 0.03, 0.04),
    "region": (0.0, 0.0, 1.0, 1.0),
}


def tiny_network(
    path: Path, *outputs: np.ndarray, size: tuple[int, int] = (64, 32), said: dict[str, Any] | None = None
) -> Path:
    """An ONNX file whose outputs are these arrays, whatever image it gets."""
    from onnx import TensorProto, helper, numpy_helper

    image = helper.make_tensor_value_info("image", TensorProto.FLOAT, [1, 3, size[1], size[0]])
    zero = numpy_helper.from_array(np.zeros(1, np.float32), "zero")
    nodes = [
        helper.make_node("GlobalMaxPool", ["image"], ["pooled"]),
        helper.make_node("Flatten", ["pooled"], ["flat"]),
        helper.make_node("ReduceMean", ["flat"], ["mean"], axes=[1], keepdims=0),
        helper.make_node("Mul", ["mean", "zero"], ["nothing"]),
    ]
    made, constants = [], [zero]
    for index, output in enumerate(outputs):
        constants.append(numpy_helper.from_array(output.astype(np.float32), f"constant{index}"))
        nodes.append(helper.make_node("Add", [f"constant{index}", "nothing"], [f"output{index}"]))
        made.append(helper.make_tensor_value_info(f"output{index}", TensorProto.FLOAT, list(output.shape)))
    graph = helper.make_graph(nodes, "tiny", [image], made, constants)
    model = helper.make_model(graph, opset_imports=[helper.make_opsetid("", 13)], ir_version=8)
    if said:
        helper.set_model_props(model, {name: repr(value) for name, value in said.items()})
    path.write_bytes(model.SerializeToString())
    return path

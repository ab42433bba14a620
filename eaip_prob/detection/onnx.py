"""Any exported detection network: an ONNX file, run by OpenCV, whose classes are named after the task's.

Reading an ONNX file executes nothing in it. Importing this module imports no OpenCV.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import UInt8

from eaip_prob.config import repository_path
from eaip_prob.detection.base import CLASSES, AbstractImageDetector, Detections, check_image
from eaip_prob.detection.boxes import suppressed
from eaip_prob.detection.network_input import NetworkInput, in_image
from eaip_prob.detection.onnx_layouts import AbstractOutputLayout
from eaip_prob.detection.onnx_metadata import NetworkSettings, read_settings
from eaip_prob.errors import DataFileError, InputError


class OnnxDetector(AbstractImageDetector):
    """An exported network, whatever trained it.

    What the file itself says of the network (`read_settings`), as those do that `export_onnx` wrote, may be left out.

    Args:
        path: of the ONNX file, if relative within the repository; it has one input and one output.
        layout: what its output means; None for what the file says.
        input: how an image becomes its input; None for what the file says.
        names: of its classes, in its order; None for what the file says.
        classes: name of a class of the network -> class of the task; what it finds of other classes is ignored. None
            where all its classes are the task's.
        camera: as of `AbstractImageDetector`.
        threshold: score below which nothing is found.
        overlap: intersection over union above which the weaker of two boxes is dropped.
        per_class: whether boxes of different classes of the task may overlap more than that.
        box_std: standard deviation of the box's centre and size, a share of its width and height; None for what the
            file says, or 0.09: that of the small YOLOX of its authors on rendered office chairs in full view (0.013 and
            0.075 for the centre, 0.044 and 0.159 for the size, over 20 views).

    Raises:
        InputError: no file there; a class that the network or the task does not have, or none at all.
        DataFileError: no ONNX file, or a damaged one.
        ShapeError: an output that is not of the layout.

    Example:
        >>> from eaip_prob.detection.onnx_layouts import YoloV8Layout
        >>> OnnxDetector("/none.onnx", YoloV8Layout(), NetworkInput((64, 64)), ["seat"], {"seat": "chair"})
        Traceback (most recent call last):
        eaip_prob.errors.InputError: Expected an ONNX file at /none.onnx, got no file. Set detector.path=FILE.
    """

    def __init__(
        self,
        path: str | Path,
        layout: AbstractOutputLayout | None = None,
        input: NetworkInput | None = None,
        names: Sequence[str] | None = None,
        classes: Mapping[str, str] | None = None,
        camera: str = "right",
        threshold: float = 0.25,
        overlap: float = 0.45,
        per_class: bool = False,
        box_std: float | None = None,
    ) -> None:
        super().__init__(camera)
        self.path = repository_path(path)
        said = _said(self.path, {"layout": layout, "input": input, "names": names})
        names = said.names if names is None else names
        classes = {name: name for name in names} if classes is None else classes
        _check_classes(names, classes)
        if not (0.0 <= threshold <= 1.0 and 0.0 <= overlap <= 1.0 and (box_std is None or box_std >= 0.0)):
            raise InputError(
                f"Expected threshold and overlap from 0 to 1 and box_std of at least zero, got {threshold}, {overlap} "
                f"and {box_std}."
            )
        self.layout = said.layout if layout is None else layout
        self.input = NetworkInput(said.input_size, region=said.region) if input is None else input
        self.names, self.classes = tuple(names), dict(classes)
        self.threshold, self.overlap, self.per_class = threshold, overlap, per_class
        self.box_std = np.asarray(said.box_errors) if box_std is None else np.full(4, float(box_std))
        self._network = _loaded(self.path)
        # Once now, so that a file that does not fit is refused here and not in the middle of a task.
        self._candidates(np.zeros((1, 3, self.input.size[1], self.input.size[0]), np.float32))

    def detect_image(self, image: UInt8[np.ndarray, "height width 3"]) -> Detections:
        """What an image shows of the task's classes, the most certain first.

        Args:
            image: RGB.

        Raises:
            ShapeError: no RGB image.
            InputError: no bytes.
        """
        check_image(image)
        values, factor, offset = self.input.prepared(image)
        box, score = self._candidates(values)
        size = (image.shape[1], image.shape[0])
        return self._found(in_image(box, factor, offset, size, least=0.0), score, size)

    def _candidates(self, values: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        import cv2

        try:
            self._network.setInput(values)
            output = np.asarray(self._network.forward())
        except cv2.error as error:
            raise InputError(
                f"Expected {self.path.name} to take an input of {values.shape}, got: {error.err}. Set input.size to "
                "the (width, height) that it was exported with."
            ) from error
        width, height = self.input.size
        return self.layout.decode(output, (width, height), len(self.names))

    def _found(self, box: np.ndarray, score: np.ndarray, image_size: tuple[int, int]) -> Detections:
        mapped = [index for index, name in enumerate(self.names) if name in self.classes]
        best = np.asarray(mapped)[score[:, mapped].argmax(1)]
        value = np.clip(score[np.arange(len(score)), best], 0.0, 1.0)
        good = np.flatnonzero((value >= self.threshold) & (box[:, 2:] > 0.0).all(1))
        labels = np.array([self.classes[self.names[index]] for index in best[good]], dtype=object)
        kept = suppressed(box[good], value[good], labels if self.per_class else None, self.overlap)
        at = good[kept]
        std = self.box_std * np.tile(box[at, 2:], 2)
        covariance = std[:, :, None] ** 2 * np.eye(4)
        return Detections(tuple(labels[kept]), value[at], box[at], image_size, covariance)


def _said(path: Path, given: Mapping[str, Any]) -> NetworkSettings:
    """What the file says of the network; needed only for what is not given."""
    if not path.is_file():
        raise InputError(f"Expected an ONNX file at {path}, got no file. Set detector.path=FILE.")
    said, absent = read_settings(path), [name for name, value in given.items() if value is None]
    if said is None and absent:
        raise InputError(f"Expected {absent} for {path.name}, which says nothing of them itself. Give them.")
    return said or NetworkSettings()


def _loaded(path: Path) -> Any:
    import cv2

    try:
        network = cv2.dnn.readNetFromONNX(str(path))
    except cv2.error as error:
        raise DataFileError(
            f"Expected {path.name} as an ONNX file that OpenCV can read, got: {error.err}. Export the network again."
        ) from error
    outputs = network.getUnconnectedOutLayersNames()
    if len(outputs) != 1:
        raise DataFileError(
            f"Expected a network with one output in {path.name}, got {len(outputs)}: {sorted(outputs)}. Export it with "
            "its answers joined."
        )
    return network


def _check_classes(names: Sequence[str], classes: Mapping[str, str]) -> None:
    if len(set(names)) != len(names) or not names:
        raise InputError(f"Expected names of the network's classes, each once, got {list(names)}.")
    absent, unknown = sorted(set(classes) - set(names)), sorted(set(classes.values()) - set(CLASSES))
    if absent or unknown or not classes:
        raise InputError(
            f"Expected classes as a map from names of the network, {list(names)}, to classes of the task, "
            f"{list(CLASSES)}, got {dict(classes)}. Name at least one of each."
        )

"""YOLO v2 as a detector of furniture (Sec. 4.2.1)."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import torch
from jaxtyping import Float, UInt8

from eaip_prob.config import repository_path
from eaip_prob.detection.base import AbstractImageDetector, Detections, check_image
from eaip_prob.detection.boxes import suppressed
from eaip_prob.detection.network_input import NetworkInput, in_image
from eaip_prob.detection.yolo.decoding import answers
from eaip_prob.detection.yolo.network import CELL
from eaip_prob.detection.yolo.packed import ready
from eaip_prob.detection.yolo.weights_file import YoloSettings, read_weights
from eaip_prob.errors import InputError

SHIPPED = Path(__file__).resolve().parent / "weights" / "furniture.safetensors"


class YoloDetector(AbstractImageDetector):
    """Finds chairs, stepladders, tables and bookshelves in a colour image, with trained weights.

    Args:
        weights: file that `experiments/train_detector.py` wrote, if relative within the repository; None for the one
            that comes with the package.
        threshold: least score of what is reported. The score is the probability, on validation views, that class and
            place (IoU above 0.5) are right.
        overlap: largest IoU of two boxes that are both reported.
        per_class: whether boxes of different classes may overlap more than that; one thing is of one class.
        camera: name of the camera whose colour image is read.

    Raises:
        InputError: a threshold or overlap outside 0 to 1.
        MissingDataError: no such file.
        DataFileError: a damaged file, or weights of another architecture.

    Example:
        >>> detector = YoloDetector()
        >>> detector.settings.classes
        ('chair', 'stepladder', 'table', 'bookshelf')
        >>> len(detector.detect_image(np.zeros((540, 960, 3), np.uint8)))
        0
    """

    def __init__(
        self,
        weights: str | Path | None = None,
        threshold: float = 0.25,
        overlap: float = 0.45,
        per_class: bool = False,
        camera: str = "right",
    ) -> None:
        super().__init__(camera)
        if not (0.0 <= threshold <= 1.0 and 0.0 <= overlap <= 1.0):
            raise InputError(f"Expected threshold and overlap from 0 to 1, got {threshold} and {overlap}.")
        self._given = (weights, threshold, overlap, per_class, camera)
        network, self.settings = read_weights(SHIPPED if weights is None else repository_path(weights))
        self.threshold, self.overlap, self.per_class = threshold, overlap, per_class
        self._input = NetworkInput(self.settings.input_size, region=self.settings.region)
        self._network = ready(network, self.settings.input_size)

    def __reduce__(self) -> tuple:
        # The network is laid out for this machine and cannot be copied to another process, which reads the file again.
        return type(self), self._given

    def detect_image(self, image: UInt8[np.ndarray, "height width 3"]) -> Detections:
        """What an image shows, the most certain first.

        Args:
            image: RGB, of any size.

        Raises:
            ShapeError: no colour image.
            InputError: no bytes.
        """
        check_image(image)
        shown, factor, offset = self._input.filled(image)
        with torch.inference_mode():
            raw = self._network(as_tensor(shown[None]))
        size = (image.shape[1], image.shape[0])
        box, score, label = decoded(raw, self.settings)
        found = np.flatnonzero(score >= self.threshold)
        kept = suppressed(box[found], score[found], label[found] if self.per_class else None, self.overlap)
        box, score, label = in_image(box[found][kept], factor, offset, size), score[found][kept], label[found][kept]
        labels = tuple(self.settings.classes[index] for index in label)
        return Detections(labels, score, box, size, box_covariance=self._covariance(box))

    def _covariance(self, box: Float[np.ndarray, "boxes 4"]) -> Float[np.ndarray, "boxes 4 4"]:
        deviation = np.asarray(self.settings.box_errors) * box[:, [2, 3, 2, 3]]
        return deviation[:, :, None] ** 2 * np.eye(4)


def as_tensor(images: UInt8[np.ndarray, "batch height width 3"]) -> torch.Tensor:
    """Images as a network takes them: (B, 3, H, W), RGB from 0 to 1.

    Args:
        images: (B, H, W, 3), RGB.

    Example:
        >>> as_tensor(np.full((1, 2, 2, 3), 255, np.uint8)).amax().item()
        1.0
    """
    return torch.from_numpy(np.ascontiguousarray(images)).permute(0, 3, 1, 2).float() / 255.0


def decoded(
    raw: torch.Tensor, settings: YoloSettings
) -> tuple[Float[np.ndarray, "boxes 4"], Float[np.ndarray, "boxes"], np.ndarray]:
    """Boxes in the input (px, from the edge of the first pixel), scores from 0 to 1, and classes, of one image.

    Args:
        raw: (1, A (5 + C), rows, columns), from the network.
        settings: of the network.

    Example:
        >>> settings = YoloSettings(0.25, (64, 32), ((1.0, 1.0),))
        >>> box, score, label = decoded(torch.zeros(1, 9, 1, 2), settings)
        >>> box.tolist(), score.tolist()
        ([[16.0, 16.0, 32.0, 32.0], [48.0, 16.0, 32.0, 32.0]], [0.125, 0.125])
    """
    said = answers(raw, torch.tensor(settings.anchors))
    probability, label = (said.objectness[..., None] * said.class_logits.softmax(-1)).max(-1)
    logit = settings.score_slope * probability.double().logit(eps=1e-6) + settings.score_offset
    box = said.box.double().reshape(-1, 4).numpy() * CELL
    return box, logit.sigmoid().reshape(-1).numpy(), label.reshape(-1).numpy()

"""What the numbers mean that an exported detection network puts out: one class for each family of networks.

All give boxes (centre and size, px of the network's input, counted from the edge of its first pixel) and a score for
each class, from 0 to 1. Letters: n candidates, A anchors, C classes, H x W cells.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from eaip_prob.errors import InputError, ShapeError

Candidates = tuple[Float[np.ndarray, "candidates 4"], Float[np.ndarray, "candidates classes"]]
_LEAST_SCORE = 1e-6  # so that its logit is finite
_LARGEST = 30.0  # of a logarithm, so that the exponential of a wild answer stays finite


class AbstractOutputLayout(ABC):
    """Turns the output of a network into boxes and scores.

    A subclass gives `decode`; reading images, names of classes, thresholds and suppression are `OnnxDetector`'s.
    """

    @abstractmethod
    def decode(self, output: np.ndarray, size: tuple[int, int], num_classes: int) -> Candidates:
        """(boxes (n, 4), scores (n, C)).

        Args:
            output: of the network, for one image.
            size: (width, height) of its input, px.
            num_classes: C.

        Raises:
            ShapeError: an output of another shape than networks of this family have.
        """


@dataclass(frozen=True)
class YoloV2Layout(AbstractOutputLayout):
    """Raw answers (1, A (5 + C), H, W) on a grid: t_x, t_y, t_w, t_h, objectness and classes of each anchor.

    Redmon and Farhadi, "YOLO9000" (2017), Sec. 2: with the cell's corner (c_x, c_y) and the anchor (p_w, p_h), in
    cells, b_x = sigmoid(t_x) + c_x, b_y = sigmoid(t_y) + c_y, b_w = p_w exp(t_w), b_h = p_h exp(t_h); the score of
    a class is sigmoid(objectness) times the softmax of its logit, p, or sigmoid(a logit(p) + b) once calibrated.

    Args:
        anchors: A of (width, height), in cells.
        stride: px of the input along a cell.
        score_slope: a.
        score_offset: b.

    Raises:
        InputError: no anchor, or one without an area.

    Example:
        >>> box, score = YoloV2Layout([(2.0, 1.0)]).decode(np.zeros((1, 7, 1, 2), np.float32), (64, 32), 2)
        >>> box.tolist(), score[0].round(6).tolist()
        ([[16.0, 16.0, 64.0, 32.0], [48.0, 16.0, 64.0, 32.0]], [0.25, 0.25])
    """

    anchors: Sequence[Sequence[float]]
    stride: int = 32
    score_slope: float = 1.0
    score_offset: float = 0.0

    def __post_init__(self) -> None:
        anchors = np.asarray(self.anchors, float)
        if anchors.ndim != 2 or anchors.shape[1] != 2 or not len(anchors) or not (anchors > 0.0).all():
            raise InputError(f"Expected anchors as (width, height) above zero, in cells, got {self.anchors}.")

    def decode(self, output: np.ndarray, size: tuple[int, int], num_classes: int) -> Candidates:
        """As in `AbstractOutputLayout`; candidates anchor by anchor, row by row."""
        anchors = np.asarray(self.anchors, float)
        columns, rows = size[0] // self.stride, size[1] // self.stride
        _check(output, (1, len(anchors) * (5 + num_classes), rows, columns), "YoloV2Layout", "anchors, stride or names")
        raw = output.astype(float).reshape(len(anchors), 5 + num_classes, rows * columns).transpose(0, 2, 1)
        center = (_sigmoid(raw[..., :2]) + _cells(rows, columns)) * self.stride
        extent = anchors[:, None] * np.exp(np.minimum(raw[..., 2:4], _LARGEST)) * self.stride
        share = np.exp(raw[..., 5:] - raw[..., 5:].max(-1, keepdims=True))
        score = _sigmoid(raw[..., 4:5]) * share / share.sum(-1, keepdims=True)
        score = np.clip(score, _LEAST_SCORE, 1.0 - _LEAST_SCORE)
        score = _sigmoid(self.score_slope * np.log(score / (1.0 - score)) + self.score_offset)
        return np.concatenate([center, extent], -1).reshape(-1, 4), score.reshape(-1, num_classes)


@dataclass(frozen=True)
class YoloXLayout(AbstractOutputLayout):
    """Answers (1, n, 5 + C) of grids one after the other: x, y, log w, log h in cells, objectness, classes.

    As exported without decoding (YOLOX, Ge et al. 2021, `--decode_in_inference` off); objectness and classes are from
    0 to 1 already, and their product is the score.

    Args:
        strides: px of the input along a cell of each grid.

    Example:
        >>> box, _ = YoloXLayout([16]).decode(np.zeros((1, 2, 7), np.float32), (32, 16), 2)
        >>> box.tolist()
        [[0.0, 0.0, 16.0, 16.0], [16.0, 0.0, 16.0, 16.0]]
    """

    strides: Sequence[int] = (8, 16, 32)

    def decode(self, output: np.ndarray, size: tuple[int, int], num_classes: int) -> Candidates:
        """As in `AbstractOutputLayout`."""
        grids = [_cells(size[1] // stride, size[0] // stride) for stride in self.strides]
        cells, count = np.concatenate(grids), [len(grid) for grid in grids]
        _check(output, (1, len(cells), 5 + num_classes), "YoloXLayout", "size, strides or names")
        raw, stride = output[0].astype(float), np.repeat(np.asarray(self.strides, float), count)[:, None]
        center, extent = (raw[:, :2] + cells) * stride, np.exp(np.minimum(raw[:, 2:4], _LARGEST)) * stride
        return np.concatenate([center, extent], -1), raw[:, 4:5] * raw[:, 5:]


@dataclass(frozen=True)
class YoloV8Layout(AbstractOutputLayout):
    """Decoded answers (1, 4 + C, n): centre, size in px of the input, and the score of each class.

    Example:
        >>> output = np.array([[[8.0], [9.0], [4.0], [6.0], [0.1], [0.7]]], np.float32)
        >>> box, score = YoloV8Layout().decode(output, (32, 32), 2)
        >>> box.tolist(), score.round(1).tolist()
        ([[8.0, 9.0, 4.0, 6.0]], [[0.1, 0.7]])
    """

    def decode(self, output: np.ndarray, size: tuple[int, int], num_classes: int) -> Candidates:
        """As in `AbstractOutputLayout`."""
        _check(output, (1, 4 + num_classes, output.shape[-1] if output.ndim else 0), "YoloV8Layout", "names")
        raw = output[0].T.astype(float)
        return raw[:, :4], raw[:, 4:]


def _check(output: np.ndarray, expected: tuple[int, ...], layout: str, mend: str) -> None:
    if output.shape != expected:
        raise ShapeError(
            f"Expected the network's output with shape {expected} for {layout}, got {output.shape}. Choose the layout "
            f"of this network, or set {mend} as it was exported."
        )


def _cells(rows: int, columns: int) -> Float[np.ndarray, "cells 2"]:
    """Column and row of each cell, row by row."""
    row, column = np.divmod(np.arange(rows * columns), columns)
    return np.column_stack([column, row]).astype(float)


def _sigmoid(value: np.ndarray) -> np.ndarray:
    return 0.5 * (1.0 + np.tanh(0.5 * value))  # no overflow at either end

"""Files of trained weights: safetensors, which hold numbers and text only, with what the network is in their head."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import torch

from eaip_prob.detection.base import CLASSES
from eaip_prob.detection.network_input import WHOLE, check_region
from eaip_prob.detection.yolo.network import CELL, YoloNetwork, YoloShape
from eaip_prob.errors import DataFileError, InputError, MissingDataError
from eaip_prob.files import make_folder_of, replacing

_KEY, _ARCHITECTURE = "eaip_prob", "yolo_v2"


@dataclass(frozen=True)
class YoloSettings:
    """What a network's answers mean.

    Args:
        width: factor on all channels of YOLO v2.
        input_size: (width, height) of the input, px; multiples of 32.
        anchors: width and height of each, in cells of 32 px.
        classes: names, in the order of the answers.
        score_slope: of the logit of the score over that of the raw score, measured on validation views.
        score_offset: of the logit of the score where the raw score is 0.5.
        box_errors: root mean square of the errors of centre column, centre row, width and height, the horizontal ones
            as shares of the box's width and the vertical ones of its height, measured on validation views.
        region: part of the image that the network was trained on and is shown, as of `NetworkInput`.

    Raises:
        InputError: sides that are no multiples of 32 px, no anchors or classes, or other values than these.

    Example:
        >>> YoloSettings(0.25, (288, 160), ((1.0, 2.0),), ("chair", "table")).shape
        YoloShape(width=0.25, num_anchors=1, num_classes=2)
    """

    width: float
    input_size: tuple[int, int]
    anchors: tuple[tuple[float, float], ...]
    classes: tuple[str, ...] = CLASSES
    score_slope: float = 1.0
    score_offset: float = 0.0
    box_errors: tuple[float, float, float, float] = (0.05, 0.05, 0.05, 0.05)
    region: tuple[float, float, float, float] = WHOLE

    def __post_init__(self) -> None:
        if len(self.input_size) != 2 or any(side < CELL or side % CELL for side in self.input_size):
            raise InputError(f"Expected an input of multiples of {CELL} px, got {self.input_size}.")
        if len(self.box_errors) != 4 or any(len(anchor) != 2 for anchor in self.anchors):
            raise InputError(f"Expected anchors of two lengths and four box errors, got {self}.")
        check_region(self.region)
        _ = self.shape

    @property
    def shape(self) -> YoloShape:
        """What the weights must fit."""
        return YoloShape(self.width, len(self.anchors), len(self.classes))


def write_weights(path: Path, network: YoloNetwork, settings: YoloSettings, notes: Mapping[str, str]) -> Path:
    """Writes a network, rounded to half precision, whole or not at all.

    Args:
        path: of the file; missing folders are made.
        network: trained.
        settings: of it.
        notes: how it was made, to be read by people.

    Example:
        >>> import tempfile
        >>> settings = YoloSettings(1 / 32, (64, 64), ((1.0, 1.0),))
        >>> network = YoloNetwork(settings.shape, torch.Generator().manual_seed(0))
        >>> with tempfile.TemporaryDirectory() as folder:
        ...     path = write_weights(Path(folder) / "small.safetensors", network, settings, {})
        ...     read_weights(path)[1] == settings
        True
    """
    from safetensors.torch import save

    half = {name: t.half() if t.is_floating_point() else t for name, t in network.state_dict().items()}
    head = {"architecture": _ARCHITECTURE, "settings": asdict(settings), "notes": dict(notes)}
    make_folder_of(path)
    with replacing(path) as file:
        file.write(save({name: t.contiguous() for name, t in half.items()}, {_KEY: json.dumps(head)}))
    return path


def read_weights(path: Path) -> tuple[YoloNetwork, YoloSettings]:
    """The network of a file, ready for inference, and what its answers mean.

    Args:
        path: of a file that `write_weights` wrote.

    Raises:
        MissingDataError: no such file.
        DataFileError: a damaged file, one of another architecture, or weights that do not fit their description.

    Example:
        >>> read_weights(Path("no/such.safetensors"))
        Traceback (most recent call last):
        eaip_prob.errors.MissingDataError: Expected trained weights at no/such.safetensors, got no such file. Tra...
    """
    if not path.is_file():
        raise MissingDataError(
            f"Expected trained weights at {path}, got no such file. Train them with experiments/train_detector.py."
        )
    head, tensors = _contents(path)
    settings = _settings(path, head)
    network = YoloNetwork(settings.shape)
    expected, came = ({name: tuple(t.shape) for name, t in d.items()} for d in (network.state_dict(), tensors))
    if expected != came:
        strange = sorted(name for name in expected.keys() | came.keys() if expected.get(name) != came.get(name))
        raise DataFileError(
            f"Expected weights of {settings.shape} in {path}, got other shapes of {len(strange)} tensors, such as "
            f"{strange[0]}: {came.get(strange[0])} for {expected.get(strange[0])}. Is it the file that is meant?"
        )
    network.load_state_dict({name: t.float() if t.is_floating_point() else t for name, t in tensors.items()})
    return network.eval(), settings


def _contents(path: Path) -> tuple[dict[str, Any], dict[str, torch.Tensor]]:
    from safetensors import SafetensorError, safe_open

    try:
        with safe_open(path, framework="pt") as file:
            head = json.loads((file.metadata() or {}).get(_KEY, "{}"))
            tensors = {name: file.get_tensor(name) for name in file.keys()}  # noqa: SIM118  # not iterable itself
    except (SafetensorError, ValueError, OSError) as error:
        raise DataFileError(
            f"Expected a complete file of weights (safetensors) at {path}, got one that is damaged, truncated or of "
            f"another kind ({error}). Copy or make it again."
        ) from error
    if any(not t.isfinite().all() for t in tensors.values()):
        raise DataFileError(f"Expected finite weights in {path}, got NaN or infinity. Train again.")
    return head, tensors


def _settings(path: Path, head: dict[str, Any]) -> YoloSettings:
    came = head.get("architecture") if isinstance(head, dict) else None
    if came != _ARCHITECTURE:
        raise DataFileError(
            f"Expected weights of the architecture {_ARCHITECTURE!r} in {path}, got {came!r}. Give a file that "
            "experiments/train_detector.py wrote; other networks go through ONNX."
        )
    try:
        given = dict(head["settings"])
        anchors = tuple((float(wide), float(high)) for wide, high in given.pop("anchors"))
        lists = {name: tuple(value) for name, value in given.items() if isinstance(value, list)}
        return YoloSettings(anchors=anchors, **{**given, **lists})
    except (KeyError, TypeError, ValueError) as error:
        raise DataFileError(f"Expected the settings of a network in the head of {path}, got {error}.") from error

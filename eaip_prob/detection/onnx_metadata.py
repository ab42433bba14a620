"""What an ONNX file says of its network beside the network: named texts in its head, read without the package onnx.

An ONNX file is one protobuf message; its field 14 repeats pairs of a name (field 1) and a text (field 2). `export_onnx`
writes the settings of a network there, as Python literals; they are read as such and nothing is executed.
"""

from __future__ import annotations

import ast
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path

from eaip_prob.detection.network_input import WHOLE
from eaip_prob.detection.onnx_layouts import AbstractOutputLayout, YoloV2Layout, YoloV8Layout
from eaip_prob.errors import DataFileError

_PAIRS, _NAME, _TEXT = 14, 1, 2
_VARINT, _EIGHT, _BYTES, _FOUR = 0, 1, 2, 5  # wire types of protobuf
_KEYS = ("input_size", "anchors", "classes", "score_slope", "score_offset", "box_errors", "region")


@dataclass(frozen=True)
class NetworkSettings:
    """How a network is to be used.

    Args:
        layout: what its output means.
        input_size: (width, height) of its input, px.
        names: of its classes, in its order.
        box_errors: standard deviations of centre column, centre row, width and height, shares of width and height.
        region: part of the image that is shown to it, as of `NetworkInput`.

    Example:
        >>> NetworkSettings(input_size=(288, 160)).box_errors
        (0.09, 0.09, 0.09, 0.09)
    """

    layout: AbstractOutputLayout = field(default_factory=YoloV8Layout)
    input_size: Sequence[int] = (1, 1)
    names: Sequence[str] = ()
    box_errors: Sequence[float] = (0.09, 0.09, 0.09, 0.09)
    region: Sequence[float] = WHOLE


def read_settings(path: Path) -> NetworkSettings | None:
    """The settings that `export_onnx` wrote into an ONNX file; None where it says nothing of that kind.

    Args:
        path: of the file.

    Raises:
        DataFileError: no ONNX file, a damaged one, or settings that are no numbers and names.

    Example:
        >>> import tempfile
        >>> with tempfile.TemporaryDirectory() as folder:
        ...     _ = (Path(folder) / "plain.onnx").write_bytes(bytes([8, 7]))  # field 1, the version, is 7
        ...     read_settings(Path(folder) / "plain.onnx") is None
        True
    """
    try:
        pairs = [dict(_texts(content)) for number, content in _texts(path.read_bytes()) if number == _PAIRS]
        texts = {bytes(pair[_NAME]).decode(): bytes(pair[_TEXT]).decode() for pair in pairs}
    except (IndexError, KeyError, TypeError, ValueError) as error:
        raise DataFileError(f"Expected {path.name} as an ONNX file, got damaged bytes. Export it again.") from error
    if not set(_KEYS) <= set(texts):
        return None
    try:
        said = {name: ast.literal_eval(texts[name]) for name in _KEYS}
        layout = YoloV2Layout(said["anchors"], 32, float(said["score_slope"]), float(said["score_offset"]))
        width, height = (int(side) for side in said["input_size"])
        errors, region = (tuple(float(value) for value in said[name]) for name in ("box_errors", "region"))
    except (SyntaxError, TypeError, ValueError) as error:
        raise DataFileError(
            f"Expected settings of numbers and names in {path.name}, got {[texts[name] for name in _KEYS]}. Export it "
            "again."
        ) from error
    return NetworkSettings(layout, (width, height), tuple(said["classes"]), errors, region)


def _texts(message: bytes | memoryview) -> Iterator[tuple[int, memoryview]]:
    """Number and content of each field of a protobuf message that is a text or a message; numbers are passed over."""
    view, at = memoryview(message), 0
    while at < len(view):
        tag, at = _varint(view, at)
        number, kind = tag >> 3, tag & 7
        if kind not in (_VARINT, _EIGHT, _BYTES, _FOUR) or number == 0:
            raise ValueError(f"no field {number} of type {kind}")
        length, at = _varint(view, at) if kind in (_VARINT, _BYTES) else ({_EIGHT: 8, _FOUR: 4}[kind], at)
        if kind == _VARINT:
            continue
        if at + length > len(view):
            raise ValueError("cut off")
        if kind == _BYTES:
            yield number, view[at : at + length]
        at += length


def _varint(view: memoryview, at: int) -> tuple[int, int]:
    value, shift = 0, 0
    while True:
        byte, at = view[at], at + 1
        value |= (byte & 127) << shift
        if byte < 128:
            return value, at
        shift += 7
        if shift > 63:
            raise ValueError("a number without an end")

"""YOLO v2 as an ONNX file, which other programs read and `cv2.dnn` runs."""

from __future__ import annotations

import warnings
from pathlib import Path

import torch

from eaip_prob.detection.yolo.network import folded
from eaip_prob.detection.yolo.weights_file import read_weights
from eaip_prob.errors import MissingExtraError
from eaip_prob.files import make_folder_of, replacing


def export_onnx(weights: Path, path: Path) -> Path:
    """Writes trained weights as ONNX: one image in, raw answers out, as `answers` and the layout YOLO v2 take them.

    The input `image` is (1, 3, H, W), RGB from 0 to 1, letterboxed into the upper left corner; the output `answers`
    (1, A (5 + C), H / 32, W / 32). Batch normalisation is folded in. Settings are written as metadata of the file.

    Args:
        weights: file that `write_weights` wrote.
        path: of the ONNX file; missing folders are made.

    Raises:
        MissingExtraError: onnx or onnxscript is not installed.

    Example:
        >>> export_onnx(Path("no/such.safetensors"), Path("network.onnx"))
        Traceback (most recent call last):
        eaip_prob.errors.MissingDataError: Expected trained weights at no/such.safetensors, got no such file. Tra...
    """
    network, settings = read_weights(weights)
    try:
        import onnx
        import onnxscript  # noqa: F401  # torch's exporter needs it
    except ImportError as error:
        raise MissingExtraError(
            "Expected the packages onnx and onnxscript, got none. Install them with pip install 'eaip_prob[onnx]'."
        ) from error
    image = torch.zeros(1, 3, settings.input_size[1], settings.input_size[0])
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # the exporter's own use of what torch has deprecated
        program = torch.onnx.export(
            folded(network), (image,), dynamo=True, input_names=["image"], output_names=["answers"], verbose=False
        )
    if program is None:
        raise RuntimeError("torch.onnx.export returned no program")
    model = program.model_proto
    for name, value in vars(settings).items():
        onnx.helper.set_model_props(model, {**{p.key: p.value for p in model.metadata_props}, name: repr(value)})
    make_folder_of(path)
    with replacing(path) as file:
        file.write(model.SerializeToString())
    return path

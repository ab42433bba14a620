from __future__ import annotations

import json
from pathlib import Path

import pytest
import torch
from detector_world import SMALL
from safetensors.torch import load_file, save_file

from eaip_prob.detection.yolo.network import YoloNetwork
from eaip_prob.detection.yolo.weights_file import YoloSettings, read_weights, write_weights
from eaip_prob.errors import DataFileError, InputError, MissingDataError


def written(folder: Path, settings: YoloSettings = SMALL) -> Path:
    network = YoloNetwork(settings.shape, torch.Generator().manual_seed(3))
    return write_weights(folder / "weights.safetensors", network, settings, {"why": "test"})


def rewritten(path: Path, change) -> Path:
    head = json.loads(_head(path))
    change(head)
    save_file(load_file(path), path, {"eaip_prob": json.dumps(head)})
    return path


def _head(path: Path) -> str:
    from safetensors import safe_open

    with safe_open(path, "pt") as file:
        return file.metadata()["eaip_prob"]


def test_weights_come_back_to_half_precision(tmp_path):
    network, settings = read_weights(written(tmp_path))
    fresh = YoloNetwork(SMALL.shape, torch.Generator().manual_seed(3))
    assert settings == SMALL and not network.training
    for name, value in fresh.state_dict().items():
        torch.testing.assert_close(network.state_dict()[name], value, rtol=1e-3, atol=1e-6)
    assert json.loads(_head(tmp_path / "weights.safetensors"))["notes"] == {"why": "test"}


def test_damaged_files_are_refused(tmp_path):
    whole = written(tmp_path).read_bytes()
    for number, content in enumerate([b"", whole[:50], whole[:-100], b"\x80\x04K\x01.", b"\xff" * 100]):
        path = tmp_path / f"bad{number}.safetensors"
        path.write_bytes(content)
        with pytest.raises(DataFileError, match=f"safetensors.*bad{number}.*damaged"):
            read_weights(path)
    with pytest.raises(MissingDataError, match="train_detector"):
        read_weights(tmp_path / "none.safetensors")


def test_weights_of_another_architecture_are_refused(tmp_path):
    path = written(tmp_path)
    with pytest.raises(DataFileError, match="architecture 'yolo_v2' .* got 'yolo_v9'"):
        read_weights(rewritten(path, lambda head: head.update(architecture="yolo_v9")))
    path = rewritten(path, lambda head: head.update(architecture="yolo_v2"))
    with pytest.raises(DataFileError, match=r"YoloShape\(width=0.125.*other shapes of .* tensors, such as"):
        read_weights(rewritten(path, lambda head: head["settings"].update(width=0.125)))
    save_file({"layer": torch.zeros(2)}, tmp_path / "other.safetensors")
    with pytest.raises(DataFileError, match="got None"):
        read_weights(tmp_path / "other.safetensors")


@pytest.mark.parametrize(
    "change",
    [
        lambda head: head.pop("settings"),
        lambda head: head["settings"].pop("anchors"),
        lambda head: head["settings"].update(anchors=[1.0]),
        lambda head: head["settings"].update(input_size=[100, 64]),
        lambda head: head["settings"].update(colour="red"),
    ],
)
def test_settings_that_make_no_sense_are_refused(tmp_path, change):
    with pytest.raises(DataFileError, match="settings of a network"):
        read_weights(rewritten(written(tmp_path), change))


def test_weights_that_are_no_numbers_are_refused(tmp_path):
    path = written(tmp_path)
    tensors, head = load_file(path), _head(path)
    tensors["answer.bias"][0] = float("nan")
    save_file(tensors, path, {"eaip_prob": head})
    with pytest.raises(DataFileError, match="finite weights"):
        read_weights(path)


def test_settings_check_themselves():
    with pytest.raises(InputError, match="multiples of 32"):
        YoloSettings(0.25, (224, 100), ((1.0, 1.0),))
    with pytest.raises(InputError, match="four box errors"):
        YoloSettings(0.25, (224, 96), ((1.0, 1.0),), box_errors=(0.1, 0.1))  # pyright: ignore[reportArgumentType]

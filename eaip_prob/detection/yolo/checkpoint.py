"""The state of a training on disk: one file of tensors and text, written whole or not at all after each epoch."""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path

import torch
from torch import Tensor, nn

from eaip_prob.errors import DataFileError
from eaip_prob.files import make_folder_of, replacing

_KEY = "eaip_prob training 1"


def write_checkpoint(
    path: Path,
    networks: Mapping[str, nn.Module],
    optimizer: torch.optim.Optimizer,
    losses: list[float],
    belongs_to: str,
) -> Path:
    """Writes everything that a training goes on from.

    Args:
        path: of the file; missing folders are made.
        networks: name -> network.
        optimizer: of one of them.
        losses: one an epoch.
        belongs_to: description of the training; another one does not go on from here.

    Example:
        >>> import tempfile
        >>> layer = nn.utils.skip_init(nn.Linear, 2, 1)
        >>> optimizer = torch.optim.AdamW(layer.parameters())
        >>> with tempfile.TemporaryDirectory() as folder:
        ...     path = write_checkpoint(Path(folder) / "state.safetensors", {"a": layer}, optimizer, [0.5], "this")
        ...     read_checkpoint(path, {"a": layer}, optimizer, "this")
        [0.5]
    """
    from safetensors.torch import save

    tensors = {f"{key}/{name}": t for key, network in networks.items() for name, t in network.state_dict().items()}
    for index, state in optimizer.state_dict()["state"].items():
        tensors |= {f"optimizer/{index}/{name}": value for name, value in state.items()}
    head = {"losses": json.dumps(losses), "belongs_to": belongs_to, "format": _KEY}
    make_folder_of(path)
    with replacing(path) as file:
        file.write(save({name: t.contiguous() for name, t in tensors.items()}, head))
    return path


def read_checkpoint(
    path: Path, networks: Mapping[str, nn.Module], optimizer: torch.optim.Optimizer, belongs_to: str
) -> list[float]:
    """Sets networks and optimiser to a state that was kept, and returns the losses of the epochs before it.

    Args:
        path: of the file.
        networks: of the shapes that were kept; written to.
        optimizer: of the same parameters; written to.
        belongs_to: as it was kept.

    Raises:
        DataFileError: a damaged file, or the state of another training.

    Example:
        >>> read_checkpoint(Path("no/such.safetensors"), {}, None, "this")
        Traceback (most recent call last):
        eaip_prob.errors.DataFileError: Expected the state of a training at no/such.safetensors, got one that is dam...
    """
    from safetensors import SafetensorError, safe_open

    try:
        with safe_open(path, framework="pt") as file:
            head = file.metadata() or {}
            tensors = {name: file.get_tensor(name) for name in file.keys()}  # noqa: SIM118  # not iterable itself
        losses = json.loads(head.get("losses", "null"))
    except (SafetensorError, OSError, ValueError) as error:
        raise DataFileError(
            f"Expected the state of a training at {path}, got one that is damaged ({error}). Remove it to begin anew."
        ) from error
    if head.get("format") != _KEY or head.get("belongs_to") != belongs_to:
        raise DataFileError(
            f"Expected the state of this training at {path}, got that of another one: other images, settings or plan. "
            "Choose another folder, or remove it to begin anew."
        )
    for key, network in networks.items():
        network.load_state_dict(_under(tensors, key))
    parameters = [parameter for group in optimizer.param_groups for parameter in group["params"]]
    state: dict[int, dict[str, Tensor]] = {}
    for name, tensor in _under(tensors, "optimizer").items():
        index, part = name.split("/")
        state.setdefault(int(index), {})[part] = _laid_out_as(parameters[int(index)], tensor)
    optimizer.load_state_dict({**optimizer.state_dict(), "state": state})
    return losses


def _laid_out_as(parameter: Tensor, value: Tensor) -> Tensor:
    # The file keeps no strides, and torch's fused optimisers pair parameters and moments by their place in memory.
    return torch.empty_like(parameter).copy_(value) if value.shape == parameter.shape else value


def _under(tensors: dict[str, Tensor], key: str) -> dict[str, Tensor]:
    return {name.removeprefix(f"{key}/"): t for name, t in tensors.items() if name.startswith(f"{key}/")}

"""A tree of dataclasses as plain values, and back: how a fitted model is kept in a file without pickle.

    tensor, None, bool, int, float, str   itself (a tensor as a copy without gradients)
    list                                  [...]
    tuple                                 {"tuple": [...]}
    mapping with text keys                {"mapping": {...}}
    dataclass                             {"class": "module:QualName", "fields": {...}}, the fields of its `__init__`

`torch.save` writes the result and `torch.load(..., weights_only=True)` reads it. Whatever `__post_init__` computes is
computed again, so that its checks also guard what was read.
"""

from __future__ import annotations

import dataclasses
import importlib
import pkgutil
from collections.abc import Mapping
from typing import Any

from torch import Tensor

from eaip_prob.errors import InputError

_PLAIN = (bool, int, float, str)


def encode(value: Any, path: str = "value") -> Any:
    """The value as plain values; it is not changed and shares no memory with them.

    Args:
        value: tensor, number, text, None, tuple, list, mapping with text keys, or dataclass of these.
        path: where the value stands, for messages.

    Raises:
        InputError: something else; the message names where it stands.

    Example:
        >>> from eaip_prob.models import ShrinkageCovariance
        >>> encode(ShrinkageCovariance(0.2))
        {'class': 'eaip_prob.models.covariance:ShrinkageCovariance', 'fields': {'amount': 0.2}}
    """
    if value is None or type(value) in _PLAIN:
        return value
    if isinstance(value, Tensor):
        return value.detach().clone()
    if type(value) is list:
        return [encode(part, f"{path}[{index}]") for index, part in enumerate(value)]
    if type(value) is tuple:
        return {"tuple": [encode(part, f"{path}[{index}]") for index, part in enumerate(value)]}
    if isinstance(value, Mapping):
        return {"mapping": {_text(key, path): encode(part, f"{path}[{key!r}]") for key, part in value.items()}}
    if dataclasses.is_dataclass(value) and not isinstance(value, type):
        fields = {name: encode(getattr(value, name), f"{path}.{name}") for name in _init_names(type(value))}
        return {"class": _name_of(type(value), path), "fields": fields}
    raise InputError(
        f"Expected {path} as a tensor, number, text, None, tuple, list, mapping or dataclass, got "
        f"{type(value).__name__}. Keep it as one of these, or compute it in __post_init__ in a field with init=False."
    )


def decode(state: Any, path: str = "state") -> Any:
    """What `encode` was given.

    Args:
        state: what `encode` returned.
        path: where the state stands, for messages.

    Raises:
        InputError: not a state, or one of a class that cannot be found or has other fields.

    Example:
        >>> from eaip_prob.models import ShrinkageCovariance
        >>> decode(encode(ShrinkageCovariance(0.2)))
        ShrinkageCovariance(amount=0.2)
    """
    if state is None or type(state) in _PLAIN or isinstance(state, Tensor):
        return state
    if type(state) is list:
        return [decode(part, f"{path}[{index}]") for index, part in enumerate(state)]
    keys = set(state) if isinstance(state, Mapping) else set()
    if keys == {"tuple"} and isinstance(state["tuple"], list):
        return tuple(decode(state["tuple"], path))
    if keys == {"mapping"} and isinstance(state["mapping"], Mapping):
        return {_text(key, path): decode(part, f"{path}[{key!r}]") for key, part in state["mapping"].items()}
    if keys == {"class", "fields"} and isinstance(state["fields"], Mapping):
        return _restored(_class_of(state["class"], path), state["fields"], path)
    came = f"a mapping with the keys {sorted(map(str, keys))}" if keys else type(state).__name__
    raise InputError(f"Expected {path} as something that state() wrote, got {came}. Save the model again.")


def _restored(cls: type, fields: Mapping[str, Any], path: str) -> Any:
    expected = _init_names(cls)
    missing, unknown = sorted(set(expected) - set(fields)), sorted(set(fields) - set(expected))
    if missing or unknown:
        raise InputError(
            f"Expected {path} with the fields {list(expected)} of {cls.__name__}, got {missing} missing and {unknown} "
            "unknown. Save the model again with this version of its class."
        )
    values = {name: decode(fields[name], f"{path}.{name}") for name in expected}
    try:
        return cls(**values)
    except (TypeError, AttributeError) as error:
        raise InputError(f"Expected {path} as a {cls.__name__}, got fields it does not take: {error}.") from error


def _init_names(cls: type) -> tuple[str, ...]:
    return tuple(part.name for part in dataclasses.fields(cls) if part.init)


def _name_of(cls: type, path: str) -> str:
    name = f"{cls.__module__}:{cls.__qualname__}"
    if "<locals>" in name or _class_of(name, path) is not cls:
        raise InputError(
            f"Expected {path} of a class that can be imported, got {name}. Define it at the top of a module."
        )
    return name


def _class_of(name: Any, path: str) -> type:
    """The dataclass of that name.

    Raises:
        InputError: nothing of that name can be imported, or it is no dataclass.
    """
    advice = "Install and import what the model was saved with."
    if not (isinstance(name, str) and name.count(":") == 1):
        raise InputError(f"Expected the class of {path} as 'module:Class', got {name!r}. Save the model again.")
    try:
        importlib.import_module(name.partition(":")[0])
        found = pkgutil.resolve_name(name)
    except (ImportError, AttributeError, ValueError) as error:
        raise InputError(f"Expected the class of {path} to be importable, got {name}: {error}. {advice}") from error
    if not (isinstance(found, type) and dataclasses.is_dataclass(found)):
        raise InputError(f"Expected {path} of a dataclass, got {name}. Save the model again.")
    return found


def _text(key: Any, path: str) -> str:
    if type(key) is not str:
        raise InputError(f"Expected the keys of {path} as text, got {key!r}. Use text, or a tuple of pairs.")
    return key

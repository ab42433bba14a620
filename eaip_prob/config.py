"""Where the configuration lies, and the one function that turns a part of it into an object.

Hydra's `_target_` is the only registry: a file in `conf/<group>/` names a class and its arguments, and `build`
calls it. Everything that Hydra or OmegaConf would refuse in its own words is refused here with the configuration
key, what came and what to do.
"""

from __future__ import annotations

import contextlib
import functools
import inspect
import os
import re
import traceback
from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

from eaip_prob.errors import EaipError, InputError

_PACKAGE = Path(__file__).resolve().parent
_FULL_ERROR = "HYDRA_FULL_ERROR"


def conf_dir() -> Path:
    """The folder of configuration files: `conf/` of a checkout, or the copy inside an installed wheel.

    Raises:
        InputError: neither is there.

    Example:
        >>> (conf_dir() / "base.yaml").is_file()
        True
    """
    for folder in (_PACKAGE / "conf", _PACKAGE.parent / "conf"):
        if (folder / "base.yaml").is_file():
            return folder
    raise InputError(
        "Expected the configuration folder conf/ inside the package or beside it, found neither. "
        "Install the package again, from a wheel or with pip install -e."
    )


def repository_path(value: str | Path) -> Path:
    """The path, made absolute against the repository's root where it is relative.

    With the package installed from a wheel there is no repository, and the working directory stands in for it.

    Example:
        >>> repository_path("conf/base.yaml").is_file()
        True
    """
    path = Path(value).expanduser()
    folder = conf_dir()
    root = Path.cwd() if folder.parent == _PACKAGE else folder.parent
    return path if path.is_absolute() else (root / path).resolve()


def build(cfg: Any, **arguments: Any) -> Any:
    """The object that a configuration describes: its `_target_` called with its keys and further arguments.

    Lists and mappings reach the target as plain lists and dicts. `arguments` go to the target untouched, which
    makes tensors and dataclasses safe to pass; they win over keys of the same name.

    Args:
        cfg: mapping with a `_target_`; nested mappings with one are built first.
        **arguments: what the configuration cannot hold.

    Raises:
        InputError: no `_target_`, a `_target_` that does not exist, a value left open, or arguments that do not
            fit; the message names the configuration key.
        EaipError: whatever the target itself raises, unchanged.

    Example:
        >>> build({"_target_": "datetime.timedelta", "minutes": 1}, seconds=30).total_seconds()
        90.0
    """
    from hydra.errors import InstantiationException
    from hydra.utils import instantiate
    from omegaconf.errors import OmegaConfBaseException

    key = _key(cfg)
    if not isinstance(cfg, Mapping) and not hasattr(cfg, "keys"):
        raise InputError(f"Expected {key} as a mapping with a _target_, got {cfg!r}. Choose an option of its group.")
    if "_target_" not in cfg:
        raise InputError(f"Expected {key} with a _target_, got the keys {sorted(map(str, cfg))}. Name a class in it.")
    try:
        _check_no_key_open(key, cfg, arguments)
        deferred = instantiate(cfg, _partial_=True, _convert_="all")
    except (InstantiationException, OmegaConfBaseException) as error:
        raise _explained(key, error) from error
    function = functools.partial(deferred.func, *deferred.args, **{**deferred.keywords, **arguments})
    if cfg.get("_partial_"):
        return function
    _check_complete(key, function.func)
    _check_arguments(key, function)
    return function()


def check_kinds(cfg: Mapping[str, Any] | Any, defaults: Mapping[str, Any] | Any) -> None:
    """Numbers and lists of numbers must stay what they are by default; a word would fail long after the start.

    Args:
        cfg: what a command line gave.
        defaults: the same configuration without overrides.

    Raises:
        InputError: names the key.

    Example:
        >>> check_kinds({"seed": 3, "lengths": [10]}, {"seed": 0, "lengths": [10, 20]})
    """
    for key in cfg:
        default, given = defaults.get(key), cfg.get(key)
        if _are_numbers(default) and not _are_numbers(given):
            raise InputError(f"Expected {key} as a list of numbers, such as {list(default or ())}, got {given!r}.")
        if _is_number(default) and not (_is_number(given) and isinstance(given, (type(default), int))):
            kind = "an integer" if isinstance(default, int) else "a number"
            raise InputError(f"Expected {key} as {kind}, such as {default}, got {given!r}.")


@contextlib.contextmanager
def hydra_hands_errors_on() -> Iterator[bool]:
    """Lets Hydra hand its errors on, which it would print itself; yields whether a full traceback was asked for."""
    before = os.environ.get(_FULL_ERROR)
    os.environ[_FULL_ERROR] = "1"
    try:
        yield before == "1"
    finally:
        os.environ.pop(_FULL_ERROR)
        os.environ.update({} if before is None else {_FULL_ERROR: before})


def refusal(error: Exception) -> InputError:
    """What Hydra says about a command line, in one sentence and without the folders it searched."""
    from eaip_prob.plugins import missing_folders

    text = " ".join(str(error).split("\nConfig search path")[0].split()).rstrip(".")
    hint = "See --help."
    if "hydra/launcher" in text:
        hint = "Its launchers come with pip install 'eaip_prob[sweeps]'."
    return InputError(
        " ".join(filter(None, [f"Expected keys and options that exist, got: {text}.", hint, missing_folders()]))
    )


def _are_numbers(value: Any) -> bool:
    is_list = isinstance(value, Sequence) and not isinstance(value, str)
    return is_list and len(value) > 0 and all(_is_number(entry) for entry in value)


def _is_number(value: Any) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool)


def _key(cfg: Any) -> str:
    full_key = cfg._get_full_key(None) if hasattr(cfg, "_get_full_key") else ""
    return f"configuration key {full_key!r}" if full_key else "the configuration"


def _check_no_key_open(key: str, cfg: Any, arguments: Mapping[str, Any]) -> None:
    from omegaconf import OmegaConf

    # Hydra drops open keys of what it does not call at once, and the target's default would silently stand in.
    still_open = sorted(OmegaConf.missing_keys(cfg) - set(arguments))
    if still_open:
        raise InputError(f"Expected a value for {still_open} in {key}, got ???. Set it on the command line.")


def _check_complete(key: str, target: Callable[..., Any]) -> None:
    lacking = sorted(getattr(target, "__abstractmethods__", ()))
    if lacking:
        raise InputError(
            f"Expected {key} to name a complete class, got {_name(target)}, which lacks {lacking}. Write it."
        )


def _check_arguments(key: str, function: functools.partial[Any]) -> None:
    try:
        signature = inspect.signature(function.func)
    except ValueError:  # some built-in callables have none
        return
    try:
        signature.bind(*function.args, **function.keywords)
    except TypeError as error:
        raise InputError(
            f"Expected {key} to fit {_name(function.func)}{_names(signature)}, got "
            f"{sorted(function.keywords)}: {error}. Mend the keys, or pass the missing ones on the command line."
        ) from error


def _name(target: Callable[..., Any]) -> str:
    return f"{target.__module__}.{getattr(target, '__qualname__', repr(target))}"


def _names(signature: inspect.Signature) -> str:
    return f"({', '.join(name for name in signature.parameters)})"


def _explained(key: str, error: BaseException) -> BaseException:
    """What a caller should see instead of Hydra's error: whatever a target itself raised comes through unchanged."""
    cause = error
    while cause.__cause__ is not None:
        cause = cause.__cause__
    if isinstance(cause, EaipError) or ("Error in call to target" in str(error) and _raised_outside_hydra(cause)):
        return cause
    sentence = str(error).splitlines()[0].replace(", set env var HYDRA_FULL_ERROR=1 to see chained exception", "")
    place = re.search(r"full_key: (\S+)", str(error))
    where = f"configuration key {place[1]!r}" if place else key
    because = f" {type(cause).__name__}: {cause}." if cause is not error else ""
    advice = "the module that it names" if sentence.startswith("Error locating target") else "its keys"
    return InputError(
        f"Expected {where} to describe something that can be built, got: {sentence.rstrip('.:')}.{because} "
        f"Mend its _target_ or {advice}."
    )


def _raised_outside_hydra(error: BaseException) -> bool:
    frames = list(traceback.walk_tb(error.__traceback__))
    return bool(frames) and not frames[-1][0].f_globals.get("__name__", "").startswith(("hydra.", "omegaconf."))

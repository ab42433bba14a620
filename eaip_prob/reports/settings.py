"""What tells the runs of a sweep apart, in the words in which it was typed.

Runs are of one setting where their configurations agree in all but the seed and what changes no result. A setting's
label are those of its command line's overrides that not all runs share; where these were not kept, or do not tell the
settings apart, it is the keys of the configuration that differ.
"""

from __future__ import annotations

import json
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from eaip_prob.errors import InputError
from eaip_prob.reports.reading import Run, counts, natural

_TARGET = "_target_"
_Choices = tuple[tuple[str, str], ...]


@dataclass(frozen=True)
class Setting:
    """The choices that tell some runs of an experiment from others.

    Args:
        choices: (key, value as typed), by key; empty for runs that make none of those that others make.
        otherwise: label without choices.

    Example:
        >>> Setting((("model", "kernel"), ("~recording", ""))).label
        'model=kernel ~recording'
    """

    choices: _Choices = ()
    otherwise: str = "default"

    @property
    def label(self) -> str:
        """The choices as on a command line."""
        return " ".join(self.words) or self.otherwise

    @property
    def words(self) -> tuple[str, ...]:
        """Each choice as on a command line."""
        return tuple(key if key.startswith("~") and not value else f"{key}={value}" for key, value in self.choices)


def settings(runs: Sequence[Run]) -> dict[str, Setting]:
    """The setting of each run of one experiment, by the runs' names; settings are in their order.

    Args:
        runs: with readable configurations.

    Example:
        >>> runs = [Run(name, "finished", config={"model": name}, overrides=(f"model={name}",)) for name in "ab"]
        >>> {name: setting.label for name, setting in settings(runs).items()}
        {'a': 'model=a', 'b': 'model=b'}
    """
    groups: dict[str, list[Run]] = {}
    for run in runs:
        kept = {key: value for key, value in run.config.items() if counts(key)}
        groups.setdefault(json.dumps(kept, sort_keys=True, default=str), []).append(run)
    if len(groups) == 1:
        return {run.name: Setting(otherwise="all runs") for run in runs}
    typed = _without_packages([_typed(group) for group in groups.values()])
    stored = [_stored(group[0].config) for group in groups.values()]
    candidates = _differing(typed), _differing(_short(stored)), _differing(stored)
    chosen = next((found for found in candidates if len(set(found)) == len(found)), candidates[-1])
    of_group = [Setting(choices) for choices in chosen]
    keys = sorted({key for choices in chosen for key, _ in choices})
    order = sorted(range(len(chosen)), key=lambda place: _place(dict(chosen[place]), keys))
    members = list(groups.values())
    return {run.name: of_group[place] for place in order for run in members[place]}


def setting_of(label: str, known: Sequence[Setting]) -> Setting | None:
    """The setting that a label, or a part of it that tells, names; None where no setting or more than one answers.

    Example:
        >>> known = [Setting((("model", name), ("phase", "dtw"))) for name in ("gaussian", "kernel")]
        >>> setting_of("kernel", known).label
        'model=kernel phase=dtw'
    """
    exact = [setting for setting in known if setting.label == label.strip()]
    words = set(re.split(r"[\s,]+", label.strip()))
    partly = [each for each in known if words <= {*each.words, *(value for _, value in each.choices)}]
    found = exact or partly
    return found[0] if len(found) == 1 else None


def check_choice(label: str, known: Sequence[Setting]) -> None:
    """Refuses a label that names no setting, or several.

    Raises:
        InputError: with the labels that there are.
    """
    if setting_of(label, known) is None:
        names = ", ".join(repr(setting.label) for setting in known)
        raise InputError(f"Expected baseline as the label of one setting, got {label!r}. There are {names}.")


def _typed(group: Sequence[Run]) -> dict[str, str]:
    """The overrides of a group's most explicit run."""
    overrides = max((run.overrides for run in group), key=lambda texts: (len(texts), texts))
    pairs = (re.fullmatch(r"\+{0,2}(~?[^=]+)=?(.*)", text, re.DOTALL) for text in overrides)
    return {pair[1]: pair[2] for pair in pairs if pair}


def _without_packages(everyone: Sequence[Mapping[str, str]]) -> list[dict[str, str]]:
    """`covariance@predictor.model.covariance` as `covariance`, unless that stands for several keys."""
    keys = {key for choices in everyone for key in choices}
    groups = [key.split("@")[0] for key in keys]
    names = {key: key.split("@")[0] if groups.count(key.split("@")[0]) == 1 else key for key in keys}
    return [{names[key]: value for key, value in choices.items()} for choices in everyone]


def _stored(config: Mapping[str, Any]) -> dict[str, str]:
    return {key: _text(value) for key, value in config.items() if counts(key)}


def _text(value: Any) -> str:
    return value if isinstance(value, str) else json.dumps(value, default=str)


def _short(everyone: Sequence[Mapping[str, str]]) -> list[dict[str, str]]:
    """Parts by the names of their classes, without the arguments of a part that not all have."""
    targets = {key for choices in everyone for key in choices if key.endswith(_TARGET)}
    changing = {key for key in targets if len({choices.get(key) for choices in everyone}) > 1}
    places = tuple(key.removesuffix(_TARGET) for key in changing)
    outermost = {key for key in changing if not key.removesuffix(_TARGET)[:-1].startswith(places)}
    return [
        {key: value for key, value in choices.items() if not key.startswith(places)}
        | {key[: -len(_TARGET) - 1]: choices[key].rsplit(".", 1)[-1] for key in outermost & set(choices)}
        for choices in everyone
    ]


def _place(choices: Mapping[str, str], keys: Sequence[str]) -> list[Any]:
    """A key that sorts settings: first those that leave a choice out."""
    return [(key in choices, natural(choices.get(key, ""))) for key in keys]


def _differing(everyone: Sequence[Mapping[str, str]]) -> list[_Choices]:
    keys = sorted({key for choices in everyone for key in choices})
    told = [key for key in keys if len({choices.get(key) for choices in everyone}) > 1]
    return [tuple((key, choices[key]) for key in told if key in choices) for choices in everyone]

"""Which metrics a page shows, and how their numbers read."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from fnmatch import fnmatchcase

from eaip_prob.errors import InputError
from eaip_prob.reports.reading import natural
from eaip_prob.reports.statistics import SeedInterval


def selected(metrics: Iterable[str], patterns: Sequence[str]) -> list[str]:
    """The metrics that a pattern matches, in the order of the patterns, then in natural order.

    Args:
        metrics: flat keys.
        patterns: of `fnmatch`: `*` stands for anything, `/` included; those after `!` leave out what they match.

    Example:
        >>> selected(["nll/ip/5", "rmse/ip/20", "rmse/ip/5", "rmse/ip/5/low"], ["rmse/*", "nll/*", "!*/low"])
        ['rmse/ip/5', 'rmse/ip/20', 'nll/ip/5']
    """
    wanted = [pattern for pattern in patterns if not pattern.startswith("!")]
    unwanted = [pattern[1:] for pattern in patterns if pattern.startswith("!")]
    remaining = sorted(set(metrics), key=natural)
    remaining = [metric for metric in remaining if not any(fnmatchcase(metric, pattern) for pattern in unwanted)]
    found = [metric for pattern in wanted for metric in remaining if fnmatchcase(metric, pattern)]
    return list(dict.fromkeys(found))


def checked_patterns(patterns: object) -> list[str]:
    """The patterns, if they are a list of texts.

    Raises:
        InputError: something else.

    Example:
        >>> checked_patterns(["rmse/*"])
        ['rmse/*']
    """
    if not isinstance(patterns, list) or not patterns or not all(isinstance(each, str) for each in patterns):
        raise InputError(f"Expected metrics as a list of patterns, such as ['rmse/*'], got {patterns!r}.")
    return patterns


def shown(value: SeedInterval | None) -> str:
    """`mean [low, high]`, the mean alone with one seed, nothing where there is no value.

    Example:
        >>> shown(SeedInterval(12345.6, 12000.0, 12691.2, 3)), shown(SeedInterval(0.25, None, None, 1))
        ('12346 [12000, 12691]', '0.25')
    """
    if value is None:
        return ""
    if value.low is None or value.high is None:
        return _number(value.mean)
    return f"{_number(value.mean)} [{_number(value.low)}, {_number(value.high)}]"


def _number(value: float) -> str:
    return f"{value:.0f}" if 1e4 <= abs(value) < 1e7 else f"{value:.4g}"

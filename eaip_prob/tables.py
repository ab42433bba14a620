"""Short tables that read well in a console and render in Markdown."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from numbers import Real
from typing import Any

from eaip_prob.errors import InputError


def text_table(rows: Sequence[Mapping[str, Any]], columns: Sequence[str] | None = None, digits: int = 4) -> str:
    """The rows as an aligned Markdown table; numbers stand to the right, with `digits` significant digits.

    Args:
        rows: one mapping a row; a key that is missing, or None, gives an empty cell.
        columns: the keys to show, in order; default the keys of all rows in order of appearance.
        digits: significant digits of numbers that are not whole.

    Raises:
        InputError: no column, or one that no row has.

    Example:
        >>> print(text_table([{"method": "ip", "rmse": 12.3456}, {"method": "eaip", "rmse": 7.0}]))
        | method |  rmse |
        |:-------|------:|
        | ip     | 12.35 |
        | eaip   |     7 |
    """
    known = list(dict.fromkeys(key for row in rows for key in row))
    names = known if columns is None else list(columns)
    unknown = [name for name in names if rows and name not in known]
    if not names or unknown:
        raise InputError(f"Expected columns among {tuple(known)}, at least one, got {tuple(names)}.")
    cells = [[_cell(row.get(name), digits) for name in names] for row in rows]
    right = [_numeric([row.get(name) for row in rows]) for name in names]
    heads = [_escaped(name) for name in names]
    widths = [max(2, *(len(line[i]) for line in [heads, *cells])) for i in range(len(names))]
    dashes = ["-" * (width + 1) for width in widths]
    rule = "|".join(f"{dash}:" if flush else f":{dash}" for dash, flush in zip(dashes, right, strict=True))
    return "\n".join([_line(heads, widths, right), f"|{rule}|", *(_line(row, widths, right) for row in cells)])


def _line(cells: Sequence[str], widths: Sequence[int], right: Sequence[bool]) -> str:
    aligned = (c.rjust(w) if flush else c.ljust(w) for c, w, flush in zip(cells, widths, right, strict=True))
    return "| " + " | ".join(aligned) + " |"


def _cell(value: Any, digits: int) -> str:
    if value is None:
        return ""
    if isinstance(value, Real) and not isinstance(value, (bool, int)):
        text = f"{float(value):.{digits}g}"
        return f"{float(value):.0f}" if "e+" in text and abs(value) < 10 ** (2 * digits) else text
    return _escaped(str(value))


def _escaped(text: str) -> str:
    return text.replace("|", r"\|").replace("\n", " ")


def _numeric(values: Sequence[Any]) -> bool:
    present = [value for value in values if value is not None]
    return bool(present) and all(isinstance(value, Real) and not isinstance(value, bool) for value in present)

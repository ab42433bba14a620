"""House style: one colour, marker and line for each method in all figures, legends outside, files written whole.

Colours are Okabe and Ito's, which colour-blind readers can tell apart; the paper's variants are paler and dashed.
"""

from __future__ import annotations

import os
import re
import tempfile
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from torch import Tensor

from eaip_prob.errors import InputError

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

DOTS_PER_INCH = 150


@dataclass(frozen=True)
class MethodStyle:
    """How the lines of one method look.

    Args:
        color: as `#0072B2`, so that `rgb` reads it.
        marker: a word of matplotlib, such as "o".
        line: a word of matplotlib, such as "--"; default a solid line.

    Example:
        >>> MethodStyle("#0072B2", "o").line
        '-'
    """

    color: str
    marker: str
    line: str = "-"


METHOD_STYLES: Mapping[str, MethodStyle] = {
    "mean": MethodStyle("#767676", "s", ":"),
    "environment": MethodStyle("#009E73", "D", "-."),
    "ip": MethodStyle("#0072B2", "o"),
    "eaip": MethodStyle("#D55E00", "^"),
    "eaip_kernel": MethodStyle("#882255", "P"),
    "eaip_shuffled": MethodStyle("#CC79A7", "v", ":"),
    "paper_ip": MethodStyle("#56B4E9", "o", "--"),
    "paper_eaip": MethodStyle("#E69F00", "^", "--"),
    "eaip_known_phase": MethodStyle("#000000", "x", "-."),
}
_SPARE_STYLES = tuple(
    MethodStyle(color, marker, line)
    for line in ("-", "--", ":")
    for color, marker in (
        ("#332288", "p"),
        ("#AA4499", "X"),
        ("#999933", "h"),
        ("#44AA99", "*"),
        ("#661100", "d"),
        ("#117733", "<"),
    )
)


def method_styles(methods: Iterable[str]) -> dict[str, MethodStyle]:
    """The style of each method; other names take spare styles in their order.

    Args:
        methods: names, such as those in `METHOD_STYLES`; repeated ones count once.

    Raises:
        InputError: more other names than spare styles.

    Example:
        >>> method_styles(["ip", "larger noise"])["ip"].color
        '#0072B2'
    """
    spare = iter(_SPARE_STYLES)
    styles = {name: METHOD_STYLES.get(name) or next(spare, None) for name in dict.fromkeys(methods)}
    found = {name: style for name, style in styles.items() if style is not None}
    if len(found) < len(styles):
        raise InputError(
            f"Expected at most {len(_SPARE_STYLES)} methods without a style of their own, got {len(styles)} methods "
            f"in all. Draw two figures."
        )
    return found


def rgb(color: str) -> tuple[int, int, int]:
    """(red, green, blue), 0..255, of a colour such as `#0072B2`, for what takes no such words.

    Args:
        color: `#` and two hexadecimal digits each of red, green and blue.

    Example:
        >>> rgb("#0072B2")
        (0, 114, 178)
    """
    return int(color[1:3], 16), int(color[3:5], 16), int(color[5:7], 16)


def new_figure(
    num_columns: int = 1, num_rows: int = 1, *, width: float = 5.2, height: float = 3.6, **axes: Any
) -> tuple[Figure, list[Axes]]:
    """A figure with styled axes, row by row.

    Args:
        num_columns: columns of axes.
        num_rows: rows of axes.
        width: inches a column, labels and a share of the legend included.
        height: inches a row.
        **axes: for `Figure.subplots`, e.g. `sharey=True`.

    Example:
        >>> figure, (left, right) = new_figure(2)
    """
    from matplotlib.figure import Figure

    figure = Figure(figsize=(width * num_columns, height * num_rows), layout="constrained")
    grid = figure.subplots(num_rows, num_columns, squeeze=False, **axes)
    for ax in grid.flat:
        ax.spines[["top", "right"]].set_visible(False)
        ax.grid(True, color="#e6e6e6", linewidth=0.6)
        ax.set_axisbelow(True)
    return figure, list(grid.flat)


def save_figure(figure: Figure, folder: str | Path, name: str) -> Path:
    """Writes `folder`/figures/`name`.png (150 dpi), whole or not at all.

    Args:
        figure: from one of the functions here.
        folder: the run's folder; `figures` is made inside it.
        name: file name without ending.

    Raises:
        InputError: a name that is no plain file name.

    Example:
        >>> import tempfile
        >>> with tempfile.TemporaryDirectory() as run_folder:
        ...     save_figure(new_figure()[0], run_folder, "fig03").name
        'fig03.png'
    """
    if not re.fullmatch(r"[\w-]+", name):
        raise InputError(
            f"Expected name as a plain file name of letters, digits, _ and -, without ending, got {name!r}."
        )
    target = Path(folder) / "figures" / f"{name}.png"
    target.parent.mkdir(parents=True, exist_ok=True)
    with tempfile.TemporaryDirectory(dir=target.parent, prefix=".drawing-") as scratch:
        figure.savefig(Path(scratch) / target.name, dpi=DOTS_PER_INCH, bbox_inches="tight", facecolor="white")
        os.replace(Path(scratch) / target.name, target)
    return target


def outside_legend(figure: Figure) -> None:
    """One legend for all panels of a figure, to the right of them; each label once.

    Args:
        figure: from `new_figure`, with labelled lines; the legend is added to it.

    Example:
        >>> figure, (ax,) = new_figure()
        >>> lines = ax.plot([0, 1], [1, 2], label="ip")
        >>> outside_legend(figure)
    """
    entries: dict[str, Any] = {}
    for ax in figure.axes:
        for handle, label in zip(*ax.get_legend_handles_labels(), strict=True):
            entries.setdefault(label, handle)
    figure.legend(list(entries.values()), list(entries), loc="outside right upper", frameon=False)


def as_array(values: Any) -> np.ndarray:
    """What matplotlib takes, from a tensor or anything like an array.

    Example:
        >>> as_array([1.0, 2.0]).shape
        (2,)
    """
    return values.detach().cpu().numpy() if isinstance(values, Tensor) else np.asarray(values)

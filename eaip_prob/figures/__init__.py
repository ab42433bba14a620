"""The figures of the experiments, in one house style, drawn without pyplot and without a display.

matplotlib is imported inside the functions, so that importing this part costs nothing.
"""

from eaip_prob.figures.charts import coverage_plot, pit_histogram, score_label, score_lines, signed_log
from eaip_prob.figures.paths import paths_panel
from eaip_prob.figures.style import (
    METHOD_STYLES,
    MethodStyle,
    method_styles,
    new_figure,
    outside_legend,
    rgb,
    save_figure,
)

__all__ = [
    "METHOD_STYLES",
    "MethodStyle",
    "coverage_plot",
    "method_styles",
    "new_figure",
    "outside_legend",
    "paths_panel",
    "pit_histogram",
    "rgb",
    "save_figure",
    "score_label",
    "score_lines",
    "signed_log",
]

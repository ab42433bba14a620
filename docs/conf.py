from __future__ import annotations

import re
from typing import Any

import eaip_prob

project = "eaip_prob"
author = "the eaip_prob authors"
copyright = author
release = version = eaip_prob.__version__

extensions = ["myst_nb", "sphinx.ext.autodoc", "sphinx.ext.autosummary", "sphinx.ext.mathjax", "sphinx.ext.napoleon"]
exclude_patterns = ["_build", "**/_generated"]
html_theme = "furo"
html_title = "eaip_prob"

myst_enable_extensions = ["amsmath", "dollarmath", "deflist"]
myst_heading_anchors = 3
nb_execution_mode = "off"

autosummary_generate = False
autodoc_typehints = "none"
autodoc_member_order = "bysource"
autodoc_default_options = {"members": True}
napoleon_google_docstring = True
napoleon_numpy_docstring = False


def setup(app: Any) -> None:
    # Before napoleon: "(*batch, T)" in a docstring is a shape and no emphasis.
    app.connect("autodoc-process-docstring", _escape_shapes, priority=100)


def _escape_shapes(app: Any, what: str, name: str, obj: Any, options: Any, lines: list[str]) -> None:
    lines[:] = [re.sub(r"(?<![`\\*\w])\*(?=#?[a-z])", r"\\*", line) for line in lines]

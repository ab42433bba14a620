from __future__ import annotations

import hashlib
import importlib
import logging
import os
import re
from pathlib import Path
from typing import Any

import eaip_prob

HERE = Path(__file__).parent


def _offline_mathjax() -> Path:
    """MathJax as one file with its fonts inside; the extension of the package that holds it would copy 24 MB."""
    (folder,) = importlib.import_module("sphinx-mathjax-offline").__path__
    return Path(folder) / "static" / "mathjax" / "tex-svg.js"


def _digest_of_package() -> str:
    """Executed cells are kept until the package or its configuration changes, not only their own text."""
    digest = hashlib.sha256()
    folders = ("eaip_prob/**/*.py", "conf/**/*.yaml", "experiments/*.py", "docs/extend/plugin_example/**/*.[pty]*[yl]")
    for pattern in folders:
        for path in sorted(HERE.parent.glob(pattern)):
            digest.update(path.read_bytes())
    return digest.hexdigest()[:16]


# Cells run on the Python that builds the pages, whatever kernels the reader has installed ...
os.environ["JUPYTER_PATH"] = str(HERE / "_jupyter")
# ... and on one thread: matrices this small are slower on more.
os.environ.setdefault("OMP_NUM_THREADS", "1")
logging.getLogger("traitlets").setLevel(logging.WARNING)  # says which kernel it starts

project = "eaip_prob"
author = "the eaip_prob authors"
copyright = author
release = version = eaip_prob.__version__

extensions = ["myst_nb", "sphinx.ext.autodoc", "sphinx.ext.mathjax", "sphinx.ext.napoleon"]
exclude_patterns = ["_build", "extend/plugin_example"]
nitpicky = True
# References into this package must lead somewhere; docstrings also hold words that napoleon takes for types.
nitpick_ignore_regex = [("py:.*", r"(?!eaip_prob\.).*"), ("py:obj", ".*")]

html_theme = "furo"
html_title = "eaip_prob"
html_static_path = ["_static", str(_offline_mathjax())]
html_css_files = ["custom.css"]
html_copy_source = html_show_sourcelink = False
mathjax_path = "tex-svg.js"
mathjax3_config = {"svg": {"displayAlign": "left", "displayIndent": "1em"}, "options": {"enableMenu": False}}
toc_object_entries_show_parents = "hide"

myst_enable_extensions = ["amsmath", "attrs_block", "deflist", "dollarmath"]
myst_heading_anchors = 3

nb_execution_mode = "cache"
nb_execution_cache_path = str(HERE / "_build" / ".jupyter_cache" / _digest_of_package())
nb_execution_raise_on_error = True
nb_execution_show_tb = True
nb_execution_timeout = 300
nb_merge_streams = True
nb_render_markdown_format = "myst"
nb_output_stderr = "warn"

# In docstrings `name` is code, and a link where it names something of this class or module.
default_role = "py:obj"
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

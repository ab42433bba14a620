from __future__ import annotations

import importlib
import pkgutil
import re
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

import eaip_prob

DOCS = Path(__file__).parents[2] / "docs"
PAGE = """---
jupytext:
  text_representation:
    format_name: myst
kernelspec:
  name: python3
---

# One page

$$
y = \\Phi w
$$

Inline $x$, and {py:class}`~eaip_prob.data.Trajectory`.

```{code-cell} python
print(6 * 7)
```

```{eval-rst}
.. py:class:: eaip_prob.data.Trajectory
```
"""
SOURCES = re.compile(r"""<(?:script|link|img|iframe|source)\b[^>]*?\b(?:src|href)=["']([^"']+)["']""", re.IGNORECASE)


def _modules() -> list[str]:
    found = pkgutil.walk_packages(eaip_prob.__path__, "eaip_prob.")
    return [module.name for module in found if "._" not in module.name and ".conf" not in module.name]


def _pages() -> str:
    return "\n".join(page.read_text() for page in sorted((DOCS / "api").glob("*.md")))


@pytest.mark.parametrize("name", [name for name in _modules() if name.count(".") == 1])
def test_each_part_is_in_the_reference(name):
    inner = [other for other in _modules() if other.startswith(f"{name}.")]
    pages = _pages()
    assert any(f"automodule:: {module}\n" in pages for module in (name, *inner))


@pytest.mark.parametrize("name", [name for name in _modules() if hasattr(importlib.import_module(name), "__path__")])
def test_each_public_name_is_in_the_reference(name):
    pages, package = _pages(), importlib.import_module(name)
    public = getattr(package, "__all__", ())
    assert not public or f"automodule:: {name}\n   :imported-members:" in pages
    for word in public:
        value = getattr(package, word)
        described = callable(value) and value.__doc__
        assert described or f"py:data:: {name}.{word}\n" in pages, word


def test_top_level_names_are_in_the_reference():
    index = (DOCS / "api" / "index.md").read_text()
    missing = [word for word in eaip_prob.__all__ if f"{{py:class}}`{word} <" not in index]
    missing = [word for word in missing if f"{{py:func}}`{word} <" not in index and f"[`{word}`]" not in index]
    assert missing == []


@pytest.fixture(scope="module")
def site(tmp_path_factory):
    pytest.importorskip("myst_nb")
    folder = tmp_path_factory.mktemp("site")
    shutil.copy(DOCS / "conf.py", folder)
    for name in ("_static", "_jupyter"):
        shutil.copytree(DOCS / name, folder / name)
    (folder / "index.md").write_text(PAGE)
    command = [sys.executable, "-m", "sphinx", "-q", "-W", "-b", "html", str(folder), str(folder / "html")]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    # -W makes a warning an error; what else is written comes from the kernel, as it is closed
    assert done.returncode == 0, done.stdout + done.stderr
    return folder / "html"


@pytest.mark.slow
def test_pages_need_no_network(site):
    text = (site / "index.html").read_text()
    sources = SOURCES.findall(text)
    assert sources
    for source in sources:
        assert not re.match(r"(?:https?:)?//", source), source
        assert source == "#" or (site / source.split("?")[0]).is_file(), source
    for style in site.rglob("*.css"):
        assert not re.search(r"""(?:@import|url\()\s*["']?(?:https?:)?//""", style.read_text()), style


@pytest.mark.slow
def test_maths_is_rendered_by_a_file_of_the_site(site):
    text = (site / "index.html").read_text()
    (script,) = [source for source in SOURCES.findall(text) if "tex-svg" in source]
    assert (site / script.split("?")[0]).stat().st_size > 1_000_000
    assert text.count('class="math notranslate') == 2


@pytest.mark.slow
def test_cells_are_executed(site):
    assert ">42\n" in (site / "index.html").read_text()

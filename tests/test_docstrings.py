from __future__ import annotations

import importlib
import inspect
import pkgutil
import re
from typing import Any

import pytest

import eaip_prob

PACKAGES = [
    "eaip_prob",
    *sorted(f"eaip_prob.{part.name}" for part in pkgutil.iter_modules(eaip_prob.__path__) if part.ispkg),
]


def exported() -> dict[str, Any]:
    """Classes and functions in the `__all__` of the packages, under the name of their own module."""
    found = {}
    for package in map(importlib.import_module, PACKAGES):
        for name in getattr(package, "__all__", ()):
            part = getattr(package, name)
            if inspect.isclass(part) or inspect.isfunction(part):
                found[f"{part.__module__}.{part.__qualname__}"] = part
    return found


PARTS = exported()


def runs(part: Any) -> bool:
    """Whether an example of it can run: an error or an abstract class is there to be named."""
    return not (inspect.isclass(part) and (inspect.isabstract(part) or issubclass(part, BaseException)))


@pytest.mark.parametrize("name", PARTS)
def test_public_names_say_what_they_take(name):
    part, doc = PARTS[name], inspect.getdoc(PARTS[name]) or ""
    assert doc.splitlines()[0].rstrip().endswith((".", "::", ":")), f"{name}: the first line is a sentence"
    taken = {}
    if runs(part) or inspect.isabstract(part):
        taken = {key for key in inspect.signature(part).parameters if not key.startswith("_")}
    unsaid = sorted(key for key in taken if not re.search(rf"(?<!\w){key}\b", doc))
    assert not unsaid, f"{name}: its docstring says nothing of {unsaid}"


@pytest.mark.parametrize("name", [name for name, part in PARTS.items() if runs(part)])
def test_public_names_have_an_example_that_runs(name):
    part = PARTS[name]
    methods = vars(part).values() if inspect.isclass(part) else ()
    docs = [inspect.getdoc(part) or "", *(inspect.getdoc(getattr(it, "__func__", it)) or "" for it in methods)]
    assert any(">>> " in doc for doc in docs), f"{name}: no Example in its docstring or those of its methods"

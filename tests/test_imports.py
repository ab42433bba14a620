from __future__ import annotations

import importlib
import re
import subprocess
import sys
from pathlib import Path

import pytest

import eaip_prob

ROOT = Path(__file__).parents[1]
PACKAGE = ROOT / "eaip_prob"
HEAVY = {"torch", "open3d", "cv2", "rerun", "pyro", "matplotlib", "numba", "hydra"}
MODULES = sorted(
    ".".join(path.relative_to(ROOT).with_suffix("").parts).removesuffix(".__init__") for path in PACKAGE.rglob("*.py")
)
SCRIPTS = sorted((ROOT / "experiments").rglob("*.py"))
FACTORISATIONS = re.compile(r"\.(inverse|pinverse|pinv|det|logdet|slogdet|lstsq|lu_factor|lu_solve|inv|inv_ex)\(")


def loaded(code: str) -> set[str]:
    program = f"import sys\nknown = set(sys.modules)\n{code}\nprint(*(set(sys.modules) - known))"
    answer = subprocess.run([sys.executable, "-c", program], cwd=ROOT, capture_output=True, text=True, timeout=60)
    assert answer.returncode == 0, answer.stderr
    return set(answer.stdout.split())


def test_importing_the_package_loads_nothing_heavy():
    assert loaded("import eaip_prob, eaip_prob.runs, eaip_prob.config") & HEAVY == set()


@pytest.mark.parametrize("script", SCRIPTS, ids=lambda path: str(path.relative_to(ROOT)))
def test_importing_an_experiment_loads_nothing_heavy(script):
    assert loaded(f"import runpy; runpy.run_path({str(script)!r}, run_name='imported')") & HEAVY == set()


def test_public_names_are_few_sorted_and_there():
    names = eaip_prob.__all__
    assert names == sorted(names)
    assert len(names) <= 15
    assert set(names) <= set(dir(eaip_prob))
    for name in names:
        assert getattr(eaip_prob, name) is not None
    with pytest.raises(AttributeError, match="'nothing'"):
        _ = eaip_prob.nothing


@pytest.mark.slow
def test_every_module_imports_alone():
    # A fork per module, after the packages of others: each sees none of ours, and torch is loaded once.
    program = f"""
import os
import numpy, scipy.special, torch, jaxtyping
for name in {MODULES!r}:
    if os.fork() == 0:
        __import__(name)
        os._exit(0)
    if os.wait()[1]:
        print(name)
"""
    answer = subprocess.run([sys.executable, "-c", program], cwd=ROOT, capture_output=True, text=True, timeout=900)
    assert (answer.returncode, answer.stdout) == (0, ""), answer.stderr


def test_packages_export_what_they_say():
    for name in (module for module in MODULES if (ROOT / module.replace(".", "/")).is_dir()):
        package = importlib.import_module(name)
        for public in getattr(package, "__all__", []):
            assert hasattr(package, public), f"{name}.{public}"


@pytest.mark.parametrize("path", [PACKAGE, ROOT / "experiments"], ids=lambda path: path.name)
def test_only_linalg_factorises(path):
    found = [
        f"{file.relative_to(ROOT)}: {match[0]}"
        for file in sorted(path.rglob("*.py"))
        if file != PACKAGE / "linalg.py"
        for match in FACTORISATIONS.finditer(file.read_text(encoding="utf-8"))
    ]
    assert found == []

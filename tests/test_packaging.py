from __future__ import annotations

import re
import shutil
import subprocess
import sys
import tomllib
import zipfile
from pathlib import Path

import pytest

import eaip_prob

ROOT = Path(__file__).parents[1]
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))


def test_one_version():
    assert PROJECT["project"]["version"] == eaip_prob.__version__


def canonical(requirement: str) -> str:
    return re.split(r"[<>=\[]", requirement)[0].lower().replace("_", "-")


def test_constraints_are_names_and_versions_that_cover_the_dependencies():
    lines = (ROOT / "constraints.txt").read_text(encoding="utf-8").split()
    assert all(re.fullmatch(r"[A-Za-z0-9_.-]+==[0-9][0-9a-z.]*", line) for line in lines), lines
    pinned = {canonical(line) for line in lines}
    extras = PROJECT["project"]["optional-dependencies"].values()
    needed = [*PROJECT["project"]["dependencies"], *(name for extra in extras for name in extra)]
    assert {canonical(name) for name in needed} - {"eaip-prob"} <= pinned


@pytest.mark.slow
def test_a_wheel_holds_the_configuration_and_works(tmp_path):
    source, site = tmp_path / "source", tmp_path / "site"
    source.mkdir()
    for name in ("eaip_prob", "conf"):
        shutil.copytree(ROOT / name, source / name, ignore=shutil.ignore_patterns("__pycache__"))
    for name in ("pyproject.toml", "setup.py", "README.md", "LICENSE"):
        shutil.copy(ROOT / name, source)
    pip = [sys.executable, "-m", "pip", "wheel", "--quiet", "--no-deps", "--no-build-isolation"]
    subprocess.run([*pip, "--wheel-dir", str(tmp_path), str(source)], check=True, capture_output=True, timeout=120)
    (wheel,) = tmp_path.glob("*.whl")
    with zipfile.ZipFile(wheel) as archive:
        archive.extractall(site)
    modules = {path.relative_to(ROOT) for path in (ROOT / "eaip_prob").rglob("*.py")}
    assert {path.relative_to(site) for path in site.rglob("*.py")} == modules
    ours = {path.relative_to(ROOT / "conf") for path in (ROOT / "conf").rglob("*.yaml")}
    assert {path.relative_to(site / "eaip_prob" / "conf") for path in (site / "eaip_prob").rglob("*.yaml")} == ours
    assert (site / "eaip_prob" / "py.typed").exists()
    program = f"import sys; sys.path.insert(0, {str(site)!r}); from eaip_prob import conf_dir; print(conf_dir())"
    answer = subprocess.run([sys.executable, "-c", program], cwd=tmp_path, check=True, capture_output=True, text=True)
    assert answer.stdout.strip() == str(site / "eaip_prob" / "conf")

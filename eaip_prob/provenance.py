"""What a result depends on beside its configuration: versions, revision and machine, without names or paths."""

from __future__ import annotations

import os
import platform
import subprocess
from importlib.metadata import PackageNotFoundError, version
from typing import Any

from eaip_prob.config import repository_path

PACKAGES = (
    "eaip_prob",
    "hydra-core",
    "numba",
    "numpy",
    "open3d",
    "opencv-python-headless",
    "pyro-ppl",
    "rerun-sdk",
    "scipy",
    "torch",
)


def description(seed: int | None = None) -> dict[str, Any]:
    """Seed, versions of Python and packages, git revision and kind of machine, ready for JSON.

    Versions are read from the installed packages' metadata; nothing is imported.

    Example:
        >>> sorted(description(seed=3))
        ['git', 'machine', 'packages', 'python', 'seed']
    """
    return {
        "seed": seed,
        "python": platform.python_version(),
        "packages": {name: _version(name) for name in PACKAGES},
        "git": git_revision(),
        "machine": {"system": platform.system(), "processor": platform.machine(), "num_cpus": os.cpu_count()},
    }


def git_revision() -> str | None:
    """The commit of the checkout, with "+changes" where tracked files differ from it; None outside a checkout."""
    root = repository_path(".")
    if not (root / ".git").exists():
        return None
    commit = _git("rev-parse", "HEAD")
    return commit and commit + ("+changes" if _git("status", "--porcelain", "--untracked-files=no") else "")


def _git(*arguments: str) -> str | None:
    command = ["git", "-C", str(repository_path(".")), *arguments]
    try:
        return subprocess.run(command, capture_output=True, text=True, check=True, timeout=10).stdout.strip()
    except (OSError, subprocess.SubprocessError):
        return None


def _version(name: str) -> str | None:
    try:
        return version(name)
    except PackageNotFoundError:
        return None

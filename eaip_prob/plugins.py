"""Configuration folders of other installed packages: `model=theirs` without a line changed here.

A package names the folder of its configuration under the entry-point group `eaip_prob.configs`::

    [project.entry-points."eaip_prob.configs"]
    robust = "eaip_prob_robust.conf"

The folder joins Hydra's search path behind this package's own, so that its `model/robust.yaml` is the option
`model=robust` and no file of it can replace one of ours. Folders are found without running a line of the other
package: one that is broken fails when an option of it is built, and disturbs nobody before.
"""

from __future__ import annotations

import importlib.util
from collections.abc import Iterator
from dataclasses import dataclass
from importlib.metadata import EntryPoint, entry_points
from pathlib import Path

from hydra.core.config_search_path import ConfigSearchPath
from hydra.core.plugins import Plugins
from hydra.plugins.search_path_plugin import SearchPathPlugin

GROUP = "eaip_prob.configs"


@dataclass(frozen=True)
class ConfigFolder:
    """What an entry point names.

    Args:
        name: of the entry point.
        package: the distribution that is installed.
        value: dotted path of the folder.
        path: the folder, or None where there is none.
    """

    name: str
    package: str
    value: str
    path: Path | None


def config_folders() -> tuple[ConfigFolder, ...]:
    """The configuration folders of all installed packages, sorted by name.

    Example:
        >>> all(folder.path is None or folder.path.is_dir() for folder in config_folders())
        True
    """
    found = {(entry.name, entry.value): entry for entry in entry_points(group=GROUP)}
    return tuple(
        ConfigFolder(name, _package(entry), value, _folder(value)) for (name, value), entry in sorted(found.items())
    )


def missing_folders() -> str:
    """Which installed packages name a folder that is not there, as a sentence; empty where none does."""
    missing = [folder for folder in config_folders() if folder.path is None]
    named = [f"package {it.package!r}, which names {it.value!r} under {GROUP}" for it in missing]
    return f"The configuration of {', and of '.join(named)}, was not found: install it again." if named else ""


class ConfigFolders(SearchPathPlugin):
    """Appends the folders to Hydra's search path."""

    def manipulate_search_path(self, search_path: ConfigSearchPath) -> None:
        """Called by Hydra whenever it builds a search path."""
        for folder in config_folders():
            if folder.path is not None:
                search_path.append(f"{folder.package}:{folder.name}", f"file://{folder.path}")


def register() -> None:
    """Makes Hydra ask `ConfigFolders`; again and again does no harm."""
    Plugins.instance().register(ConfigFolders)


def _package(entry: EntryPoint) -> str:
    return entry.dist.name if entry.dist is not None else entry.name


def _folder(value: str) -> Path | None:
    top, *below = value.split(".")
    return next((place for root in _roots(top) if (place := root.joinpath(*below)).is_dir()), None)


def _roots(name: str) -> Iterator[Path]:
    # Only of the outermost package: to look for an inner one would import those around it.
    spec = importlib.util.find_spec(name) if name.isidentifier() else None
    yield from map(Path, (spec and spec.submodule_search_locations) or ())

"""Environment-adaptive interaction primitives: a robot's motion, with its uncertainty, from partial observations.

The public names below are imported when they are first used, so that `import eaip_prob` costs nothing.
"""

from __future__ import annotations

import importlib
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from eaip_prob import data, evidence, models, phase, primitives, tasks
    from eaip_prob.config import build, conf_dir
    from eaip_prob.data.demonstrations import Demonstration, DemonstrationSet
    from eaip_prob.data.environment import EnvironmentFeatures
    from eaip_prob.data.trajectory import Trajectory
    from eaip_prob.prediction import InteractionPredictor
    from eaip_prob.readiness import Readiness

__version__ = "0.1.0"

__all__ = [
    "Demonstration",
    "DemonstrationSet",
    "EnvironmentFeatures",
    "InteractionPredictor",
    "Readiness",
    "Trajectory",
    "build",
    "conf_dir",
    "data",
    "evidence",
    "models",
    "phase",
    "primitives",
    "tasks",
]

_HOMES = {
    "Demonstration": "eaip_prob.data.demonstrations",
    "DemonstrationSet": "eaip_prob.data.demonstrations",
    "EnvironmentFeatures": "eaip_prob.data.environment",
    "InteractionPredictor": "eaip_prob.prediction",
    "Readiness": "eaip_prob.readiness",
    "Trajectory": "eaip_prob.data.trajectory",
    "build": "eaip_prob.config",
    "conf_dir": "eaip_prob.config",
}


def __getattr__(name: str) -> Any:
    if name not in __all__:
        raise AttributeError(f"Expected one of {__all__} in eaip_prob, got {name!r}.")
    home = _HOMES.get(name)
    if home is None:
        return importlib.import_module(f"eaip_prob.{name}")
    return getattr(importlib.import_module(home), name)


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__})

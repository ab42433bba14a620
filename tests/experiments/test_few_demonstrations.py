from __future__ import annotations

import importlib.util
import json
import math
from pathlib import Path
from types import ModuleType

import pytest
from omegaconf import OmegaConf

from eaip_prob.config import build
from eaip_prob.tasks.sweeps import few_demonstrations

ROOT = Path(__file__).parents[2]
VARIANTS = ["empirical", "shrinkage", "low_rank", "kernel", "raw", "quadratic", "elapsed", "marginal", "expected"]
KEPT = ["eaip", "eaip_empirical"]
TINY = [
    *(f"~variants.eaip_{name}" for name in VARIANTS if f"eaip_{name}" not in KEPT),
    "num_demonstrations=[5]",
    "repetitions=2",
    "num_test=3",
    "percent_seen=[20,80]",
    "phase=elapsed",
    "+predictor.noise=2.0",
    "+predictor.environment_noise=5.0",
]


@pytest.fixture
def module() -> ModuleType:
    name = "few_demonstrations"
    spec = importlib.util.spec_from_file_location(f"experiment_{name}", ROOT / "experiments" / f"{name}.py")
    assert spec is not None and spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


@pytest.mark.slow
def test_a_tiny_run(module, tmp_path, capsys):
    cfg = module.run.compose(TINY)
    metrics = module.run.execute(cfg, tmp_path)
    assert metrics is not None and metrics == json.loads((tmp_path / "metrics.json").read_text())
    for method in ("mean", "environment", "ip", *KEPT):
        for score in ("rmse", "nll", "coverage90"):
            key = f"{score}/{method}/5"
            assert metrics[f"{key}/low"] <= metrics[key] <= metrics[f"{key}/high"]
            assert math.isfinite(metrics[key]) and (score == "nll" or metrics[key] >= 0)
    assert len(metrics) == 5 * 3 * 3 + 1
    assert metrics["rmse/eaip/5"] < 1.1 * metrics["rmse/mean/5"]
    assert len(list((tmp_path / "parts").iterdir())) == 2 * 2
    assert {path.stem for path in (tmp_path / "figures").iterdir()} == {"rmse", "nll", "coverage90"}
    assert (tmp_path / "recording.rrd").stat().st_size > 1000
    assert "| eaip_empirical |" in capsys.readouterr().out


def test_the_study_as_configured(module):
    cfg = module.run.compose()
    settings = OmegaConf.to_container(cfg, resolve=True)
    assert list(settings["variants"]) == ["eaip", *(f"eaip_{name}" for name in VARIANTS)]
    assert {name for shown in settings["panels"].values() for name in shown} == set(
        few_demonstrations.methods(settings)
    )
    parts = few_demonstrations.parts(settings)
    assert len(parts) == 5 * 3 * 10
    for part in parts[:10]:
        assert build(part.config["predictor"]).target == "human"

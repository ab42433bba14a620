from __future__ import annotations

import importlib.util
import json
import math
from pathlib import Path
from types import ModuleType

import pytest
from omegaconf import OmegaConf

from eaip_prob.config import build
from eaip_prob.phase import AbstractPhaseEstimator
from eaip_prob.tasks.sweeps import timing

ROOT = Path(__file__).parents[2]
TINY = [
    "log_sd=[0.2]",
    "~clocks.expected",
    "~clocks.absolute",
    "~clocks.marginal",
    "~clocks.expected_marginal",
    "~tempo.mostly",
    "phase=elapsed",
    "num_train=2",
    "num_test=1",
    "percent_seen=[50]",
    "+predictor.noise=2.0",
    "+predictor.environment_noise=5.0",
]
NAMES = [f"{tempo}-{clock}-0.2" for tempo in ("dependent", "independent") for clock in ("constant", "default")]


@pytest.fixture
def module() -> ModuleType:
    spec = importlib.util.spec_from_file_location("experiment_timing", ROOT / "experiments" / "timing.py")
    assert spec is not None and spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


@pytest.mark.slow
def test_an_interrupted_run_goes_on_and_does_nothing_twice(module, tmp_path, monkeypatch, capsys):
    measured = []
    measure = timing.measure

    def interrupted(part):
        if len(measured) == 3:
            raise KeyboardInterrupt
        measured.append(part.name)
        return measure(part)

    def counted(part):
        measured.append(part.name)
        return measure(part)

    cfg = module.run.compose(TINY)
    monkeypatch.setattr(timing, "measure", interrupted)
    with pytest.raises(KeyboardInterrupt):
        module.run.execute(cfg, tmp_path)
    assert measured == NAMES[:3] and not (tmp_path / "metrics.json").exists()
    assert {path.stem for path in (tmp_path / "parts").iterdir()} == set(NAMES[:3])

    monkeypatch.setattr(timing, "measure", counted)
    metrics = module.run.execute(cfg, tmp_path)
    assert measured == NAMES
    assert metrics == json.loads((tmp_path / "metrics.json").read_text())
    for tempo in ("dependent", "independent"):
        for clock in ("constant", "default"):
            for end in ("", "/environment", "/ip", "/mean"):
                key = f"{tempo}/{clock}/0.2/50{end}"
                assert metrics[f"rmse/{key}"] > 0 and math.isfinite(metrics[f"nll/{key}"])
                assert 0 <= metrics[f"coverage90/{key}"] <= 1
            # The predictor's own clock is the constant one here.
            assert metrics[f"rmse/{tempo}/default/0.2/50"] == metrics[f"rmse/{tempo}/constant/0.2/50"]
    assert metrics["rmse/dependent/constant/0.2/50"] != metrics["rmse/independent/constant/0.2/50"]
    assert {path.stem for path in (tmp_path / "figures").iterdir()} == {"rmse", "nll", "coverage90", "ratio"}
    assert (tmp_path / "recording.rrd").stat().st_size > 1000
    assert "| dependent   | constant |" in capsys.readouterr().out
    assert module.run.execute(cfg, tmp_path) is None and measured == NAMES


def test_the_study_as_configured(module):
    cfg = module.run.compose()
    parts = timing.parts(OmegaConf.to_container(cfg, resolve=True))
    assert len(parts) == 3 * 5 * 6
    assert cfg.tempo == {"dependent": 1.0, "mostly": 0.9, "independent": 0.0} and "paper" not in cfg
    assert set(cfg.clocks) == {"expected", "constant", "marginal", "expected_marginal", "absolute", "default"}
    for clock in filter(None, cfg.clocks.values()):
        assert isinstance(build(clock), AbstractPhaseEstimator)
    for part in parts:
        task = build(part.config["task"])
        assert task.person.tempo_sd == pytest.approx(float(part.name.rsplit("-", 1)[1]))
        assert build(part.config["predictor"]).target == "human"

"""Every file in conf/ is composed and its object built."""

from __future__ import annotations

import inspect
from typing import Any

import numpy as np
import pytest
import yaml
from detection_world import SAID, tiny_network
from omegaconf import OmegaConf

from eaip_prob.config import build, conf_dir
from eaip_prob.runs import experiment

FILES = sorted(str(path.relative_to(conf_dir()).with_suffix("")) for path in conf_dir().rglob("*.yaml"))
PRIMARY = [name for name in FILES if "/" not in name] + ["benchmarks/core", "benchmarks/perception"]
OPTIONS = [
    name for name in FILES if name not in PRIMARY and not name.startswith(("hydra/", "experiment/", "covering/"))
]
# Where an option of a group goes, and in which experiment, if not under its own name in a study.
PLACES = {
    "covariance": ("handover", "covariance@predictor.model.covariance", "predictor.model.covariance"),
    "predictor": ("handover", "predictor@paper", "paper"),
    "recording": ("handover", "recording", "recording"),
    "task": ("passing_over", "task", "task"),
    "object": ("kinects", "object@workspace.thing", "workspace.thing"),
    "perception": ("bag_covering", "perception", "perception"),
    "objects": ("kinects", "+objects", "objects"),
    **{group: ("detection", group, group) for group in ("detector", "encoder")},
    **{group: ("kinects", group, group) for group in ("camera", "kinect_noise", "rig", "tracker", "workspace")},
}
OPEN = {"features/distance": ["predictor.features.offsets=[x,y]"]}
FURTHER = {"recording/rerun": {"application_id": "a", "recording_id": "b"}}


def compose(primary: str, *overrides: str) -> Any:
    @experiment(primary)
    def run(cfg, folder):
        return {}

    return run.compose(list(overrides))


@pytest.mark.parametrize("name", PRIMARY)
def test_an_experiments_configuration_is_complete(name):
    cfg = compose(name, *(["runs=somewhere"] if name == "report" else []))
    resolved = OmegaConf.to_container(cfg, resolve=True, throw_on_missing=False)
    still_open = OmegaConf.missing_keys(cfg)
    assert still_open <= {"run_dir"} and isinstance(resolved, dict)
    for key, part in resolved.items() if name not in ("base", "study") else ():
        if isinstance(part, dict) and "_target_" in part and key != "recording":
            assert build(cfg[key]) is not None


@pytest.mark.parametrize("name", OPTIONS)
def test_an_option_is_built(name, tmp_path):
    group, option = name.rsplit("/", 1)
    primary, override, key = PLACES.get(group, ("handover", group, f"predictor.{group}"))
    part = OmegaConf.select(compose(primary, f"{override}={option}", *OPEN.get(name, ())), key)
    if part is None or "_target_" not in part:  # several
        several = part.values() if OmegaConf.is_dict(part) else part or ()
        assert [build(candidate) for candidate in several] or option == "chosen"
        return
    further = {"path": tmp_path / "a.rrd", **FURTHER[name]} if name in FURTHER else {}
    if name == "detector/onnx":
        part.path = str(tiny_network(tmp_path / "net.onnx", np.zeros((1, 24, 1, 2)), said=SAID))
    target = build(part, **further)
    written = yaml.safe_load((conf_dir() / f"{name}.yaml").read_text())
    assert f"{type(target).__module__}.{type(target).__qualname__}".startswith(
        written.get("_target_", part._target_).rsplit(".", 1)[0]
    )
    unknown = {argument for argument in written if argument not in ("_target_", "_partial_", "defaults")} - set(
        inspect.signature(type(target)).parameters
    )
    assert not unknown


@pytest.mark.parametrize("name", [name for name in FILES if name.startswith("experiment/")])
def test_an_experiments_settings_only_override(name):
    plain = compose("passing_over")
    cfg = compose("passing_over", name.replace("/", "="))
    written = yaml.safe_load((conf_dir() / f"{name}.yaml").read_text())
    written.pop("defaults")
    assert set(cfg) == set(plain) and written == {key: cfg[key] for key in written}
    assert cfg.recording._target_ == "eaip_prob.recording.NullLogger"


@pytest.mark.parametrize("name", [name for name in FILES if name.startswith("hydra/")])
def test_a_launchers_file_is_composed(name):
    from hydra import compose as hydra_compose
    from hydra import initialize_config_dir

    group, option = name.rsplit("/", 1)
    with initialize_config_dir(str(conf_dir()), version_base="1.3"):
        cfg = hydra_compose("handover", [f"{group}={option}"], return_hydra_config=True)
    launcher = OmegaConf.select(cfg, group.replace("/", "."))
    assert launcher._target_.startswith("hydra_plugins.")
    written = yaml.safe_load((conf_dir() / f"{name}.yaml").read_text())
    assert launcher.timeout_min == written["timeout_min"] and launcher.cpus_per_task == cfg.threads

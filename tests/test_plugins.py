from __future__ import annotations

import shutil
import subprocess
import sys
from pathlib import Path

import pytest
from omegaconf import OmegaConf

from eaip_prob import build, plugins
from eaip_prob.config import conf_dir, refusal
from eaip_prob.errors import InputError
from eaip_prob.runs import experiment

MODEL = """class Theirs:
    def __init__(self, number):
        self.number = number
"""


def install(folder: Path, name: str, code: str = MODEL, value: str | None = None) -> None:
    """What pip leaves of a package that brings one option of the group `model`."""
    package = folder / name
    (package / "conf" / "model").mkdir(parents=True)
    (package / "__init__.py").write_text("")
    (package / "models.py").write_text(code)
    option = f"# @package predictor.model\n_target_: {name}.models.Theirs\nnumber: 3\n"
    (package / "conf" / "model" / f"{name}.yaml").write_text(option)
    metadata = folder / f"{name}-1.0.dist-info"
    metadata.mkdir()
    (metadata / "METADATA").write_text(f"Metadata-Version: 2.1\nName: {name}-dist\nVersion: 1.0\n")
    points = f"[{plugins.GROUP}]\nmine = {value or f'{name}.conf'}\n"
    (metadata / "entry_points.txt").write_text(points)


@pytest.fixture
def site(tmp_path, monkeypatch):
    monkeypatch.syspath_prepend(str(tmp_path))
    return tmp_path


def compose(*overrides: str):
    @experiment("handover")
    def run(cfg, folder):
        return {}

    return run.compose(list(overrides))


def test_an_option_of_another_package_is_found_and_built(site):
    install(site, "plug_found")
    model = build(compose("model=plug_found").predictor.model)
    assert (type(model).__module__, model.number) == ("plug_found.models", 3)
    assert "plug_found.conf" in {folder.value for folder in plugins.config_folders()}


def test_finding_it_runs_none_of_its_code(site):
    install(site, "plug_silent", "raise RuntimeError('executed')")
    (site / "plug_silent" / "__init__.py").write_text("raise RuntimeError('executed')")
    assert "_target_" in compose("model=plug_silent").predictor.model
    assert "plug_silent" not in sys.modules


def test_no_file_of_theirs_replaces_one_of_ours(site):
    install(site, "plug_greedy")
    shutil.copy(site / "plug_greedy/conf/model/plug_greedy.yaml", site / "plug_greedy/conf/model/gaussian.yaml")
    assert compose("model=gaussian").predictor.model._target_ == "eaip_prob.models.GaussianJointModel"


@pytest.mark.parametrize("inside", ["predictor", "predictor.model"])
@pytest.mark.parametrize(
    ("code", "message"),
    [
        ("import no_such_thing", "'predictor.model' .*'plug_bad.models.Theirs'.* No module named 'no_such_thing'"),
        ("1 / 0", "'predictor.model' .*'plug_bad.models.Theirs'.* division by zero"),
        ("other = 3", "'predictor.model' .*'plug_bad.models.Theirs'"),
        ("class Theirs: pass", "'predictor.model' .*(fit plug_bad.models.Theirs.., got ..number|takes no arguments)"),
        (
            "from eaip_prob.models import AbstractJointModel\nclass Theirs(AbstractJointModel):\n"
            "    number: int = 1\n    def __init__(self, number): pass\n    def fit(self, weights): return self",
            "'predictor.model' .*Theirs.* (lacks|without|with) .*posterior",
        ),
    ],
)
def test_a_broken_one_fails_when_it_is_built_with_its_own_error(site, code, message, inside):
    install(site, "plug_bad", code)
    try:
        build(compose("model=gaussian").predictor.model)
        with pytest.raises(InputError, match=message) as caught:
            build(OmegaConf.select(compose("model=plug_bad"), inside))
        assert "\n" not in str(caught.value)
    finally:
        for module in [name for name in sys.modules if name.startswith("plug_bad")]:
            del sys.modules[module]


@pytest.mark.parametrize("value", ["plug_lost.nowhere", "no_such_package.conf", "not a name"])
def test_a_folder_that_is_missing_is_told_when_an_option_is(site, value):
    install(site, "plug_lost", value=value)
    compose("model=gaussian")
    said = str(refusal(Exception("Could not find 'model/theirs'")))
    assert f"package 'plug_lost-dist', which names '{value}' under eaip_prob.configs, was not found" in said


def test_nothing_is_said_where_nothing_is_missing():
    assert plugins.missing_folders() == ""
    assert str(refusal(Exception("Could not find it."))) == (
        "Expected keys and options that exist, got: Could not find it. See --help."
    )


@pytest.mark.slow
def test_a_command_line_finds_it(site):
    install(site, "plug_shown")
    command = [
        sys.executable,
        str(conf_dir().parent / "experiments" / "handover.py"),
        "model=plug_shown",
        "--cfg",
        "job",
    ]
    done = subprocess.run(command, env={"PYTHONPATH": str(site)}, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    assert "_target_: plug_shown.models.Theirs" in done.stdout

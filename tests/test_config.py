from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pytest
import torch
from omegaconf import OmegaConf

from eaip_prob.config import build, conf_dir, repository_path
from eaip_prob.errors import InputError, MissingExtraError, ShapeError

FRACTION = "fractions.Fraction"


@dataclass(frozen=True)
class Holder:
    value: Any = None
    inner: Any = None


@dataclass(frozen=True)
class Refusing:
    kind: str

    def __post_init__(self) -> None:
        raise {"own": ShapeError, "bug": TypeError}[self.kind]("from the inside")


@pytest.fixture
def here(monkeypatch: pytest.MonkeyPatch) -> str:
    import sys

    monkeypatch.setitem(sys.modules, "classes_of_this_test", sys.modules[__name__])
    return "classes_of_this_test"


def test_conf_dir_is_the_checkouts():
    assert conf_dir() == Path(__file__).parents[1] / "conf"


def test_repository_path():
    assert repository_path("../shared/x") == (Path(__file__).parents[2] / "shared" / "x").resolve()
    assert repository_path("/some/where") == Path("/some/where")


def test_a_repository_path_from_a_wheel_is_relative_to_the_working_directory(tmp_path, monkeypatch):
    package = tmp_path / "site" / "eaip_prob"
    (package / "conf").mkdir(parents=True)
    (package / "conf" / "base.yaml").touch()
    monkeypatch.setattr("eaip_prob.config._PACKAGE", package)
    monkeypatch.chdir(tmp_path)
    assert conf_dir() == package / "conf"
    assert repository_path("data") == tmp_path.resolve() / "data"


def test_a_missing_conf_dir_is_refused(tmp_path, monkeypatch):
    monkeypatch.setattr("eaip_prob.config._PACKAGE", tmp_path / "eaip_prob")
    with pytest.raises(InputError, match="Install the package again"):
        conf_dir()


def test_arguments_reach_the_target_untouched(here):
    tensor, inner = torch.ones(2, dtype=torch.float64), Holder(3)
    built = build({"_target_": f"{here}.Holder"}, value=tensor, inner=inner)
    assert built.value is tensor
    assert built.inner is inner


def test_arguments_win_and_the_configuration_is_unchanged(here):
    cfg = OmegaConf.create({"_target_": f"{here}.Holder", "value": 1})
    before = OmegaConf.to_yaml(cfg)
    assert build(cfg, value=2).value == 2
    assert OmegaConf.to_yaml(cfg) == before


def test_nested_targets_interpolations_and_plain_containers(here):
    root = OmegaConf.create(
        {"scale": 3, "part": {"_target_": f"{here}.Holder", "value": [1, {"a": "${scale}"}]}, "outer": None}
    )
    root.outer = {"_target_": f"{here}.Holder", "inner": "${part}"}
    built = build(root.outer)
    assert type(built.inner.value) is list
    assert type(built.inner.value[1]) is dict
    assert built.inner.value == [1, {"a": 3}]


def test_partial_waits_for_its_call(here):
    make = build({"_target_": f"{here}.Holder", "_partial_": True}, value=1)
    assert make(inner=2) == Holder(1, 2)


@pytest.mark.parametrize(
    ("part", "message"),
    [
        ({"_target_": "eaip_prob.nowhere.Model"}, r"'part'.*eaip_prob\.nowhere\.Model.*Mend"),
        ({"_target_": FRACTION, "parsecs": 1}, r"'part' to fit fractions\.Fraction.*'parsecs'"),
        ({"_target_": "builtins.dict", "x": {"_target_": "fractions.Fraction", "no": 1}}, r"'part\.x'.*no"),
        ({"_target_": FRACTION, "numerator": "???"}, r"'part.*numerator"),
        ({"_target_": FRACTION, "numerator": "${nothing}"}, r"'part\.numerator'.*nothing"),
        ({"numerator": 1}, r"'part' with a _target_, got the keys \['numerator'\]"),
        (None, "got None. Choose an option of its group"),
        ("dmp", "got 'dmp'. Choose an option of its group"),
    ],
)
def test_refusals_name_the_key(part, message):
    root = OmegaConf.create({"part": part})
    with pytest.raises(InputError, match=message):
        build(root.part)


def test_a_missing_argument_is_refused(here):
    with pytest.raises(InputError, match="kind"):
        build({"_target_": f"{here}.Refusing"})


@pytest.mark.parametrize(("kind", "error"), [("own", ShapeError), ("bug", TypeError)])
@pytest.mark.parametrize("nested", [False, True])
def test_what_a_target_raises_comes_through(here, kind, error, nested):
    cfg: dict[str, Any] = {"_target_": f"{here}.Refusing", "kind": kind}
    if nested:
        cfg = {"_target_": f"{here}.Holder", "inner": cfg}
    with pytest.raises(error, match="from the inside"):
        build(cfg)


def test_a_module_that_needs_an_extra_says_so_itself(tmp_path, monkeypatch):
    (tmp_path / "needs_an_extra.py").write_text(
        "from eaip_prob.errors import MissingExtraError\nraise MissingExtraError('pip install it')\n"
    )
    monkeypatch.syspath_prepend(tmp_path)
    with pytest.raises(MissingExtraError, match="pip install it"):
        build({"_target_": "needs_an_extra.Model"})

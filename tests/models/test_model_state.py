from __future__ import annotations

import copy
import json
import subprocess
import sys
from collections.abc import Mapping
from fractions import Fraction
from pathlib import Path
from typing import Any

import pytest
import torch
from torch import Tensor

from eaip_prob.errors import InputError, NotFittedError, ShapeError
from eaip_prob.gaussian import BlockGaussian, BlockLayout
from eaip_prob.models import (
    AbstractJointModel,
    EmpiricalCovariance,
    GaussianJointModel,
    KernelJointModel,
    LowRankCovariance,
    Posterior,
    ShrinkageCovariance,
)
from eaip_prob.models.state import encode
from eaip_prob.observation import LinearObservation

MODELS = {
    "shrinkage": GaussianJointModel(),
    "regression": GaussianJointModel(ShrinkageCovariance(0.2), "regression"),
    "low_rank": GaussianJointModel(LowRankCovariance(2, least_share=0.01)),
    "kernel": KernelJointModel(ShrinkageCovariance(), 0.9, 0.01),
    "kernel_empirical": KernelJointModel(EmpiricalCovariance(), float("inf")),
}


def fitted(name: str) -> AbstractJointModel:
    draw = torch.Generator().manual_seed(3)
    hidden = torch.randn(14, 3, generator=draw, dtype=torch.float64)
    sizes = {"robot": 3, "human": 4, "environment": 2}
    rows = {
        block: 5.0 + hidden @ torch.randn(3, size, generator=draw, dtype=torch.float64) for block, size in sizes.items()
    }
    gram = torch.tensor([[2.0, 0.5, 0.0], [0.5, 1.0, 0.1], [0.0, 0.1, 3.0]], dtype=torch.float64)
    return MODELS[name].fit(rows, groups=[i // 2 for i in range(14)], grams={"robot": gram})


def seen() -> list[LinearObservation]:
    human = torch.tensor([[0.3, 1.0, 0.0, -1.0], [2.0, 0.1, 0.7, 0.2]], dtype=torch.float64)
    value, noise = torch.tensor([[4.0, 15.0]]), torch.tensor([0.3, 0.1])
    scene = torch.tensor([[5.5, 4.0]])
    return [
        LinearObservation({"human": human}, torch.zeros(2), value, noise),
        LinearObservation({"environment": torch.eye(2)}, torch.zeros(2), scene, noise),
    ]


def answer(model: AbstractJointModel) -> dict[str, Tensor]:
    posterior, prior = model.posterior(seen()), model.prior
    return {
        "mean": posterior.components.mean,
        "covariance": posterior.components.covariance,
        "evidence": posterior.log_evidence,
        "prior_mean": prior.mean,
        "prior_covariance": prior.covariance,
    }


def assert_equal(one: Mapping[str, Tensor], other: Mapping[str, Tensor]) -> None:
    assert one.keys() == other.keys()
    assert [name for name, part in one.items() if not torch.equal(part, other[name])] == []


_IN_ANOTHER_PROCESS = """
import sys, torch
sys.path.insert(0, sys.argv[1])
import test_model_state as here
kept = torch.load(sys.argv[2], weights_only=True)
for name, state in kept["states"].items():
    model = type(here.MODELS[name]).from_state(state)
    assert model.prior.layout.names == ("robot", "human", "environment"), name
    here.assert_equal(here.answer(model), kept["answers"][name])
"""


def test_a_file_read_in_another_process_answers_the_same(tmp_path: Path) -> None:
    models = {name: fitted(name) for name in MODELS}
    kept = {name: model.state() for name, model in models.items()}
    torch.save({"states": kept, "answers": {n: answer(m) for n, m in models.items()}}, tmp_path / "models.pt")
    command = [sys.executable, "-c", _IN_ANOTHER_PROCESS, str(Path(__file__).parent), str(tmp_path / "models.pt")]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr


@pytest.mark.parametrize("name", MODELS)
def test_saving_leaves_the_model_alone_and_shares_no_memory(name: str) -> None:
    model = fitted(name)
    before = answer(model)
    state = model.state()
    restored = type(model).from_state(state)
    for leaf in leaves(state):
        if isinstance(leaf, Tensor):
            leaf.fill_(-1.0)
    assert_equal(answer(model), before)
    assert isinstance(restored, type(model))
    assert {type(leaf) for leaf in leaves(state)} <= {Tensor, float, int, str, bool, type(None)}


@pytest.mark.parametrize("name", MODELS)
def test_what_was_set_and_chosen_comes_back(name: str) -> None:
    model = fitted(name)
    again = type(model).from_state(model.state())
    assert encode(again, "again").keys() == {"class", "fields"}
    plain = {key: part for key, part in vars(model).items() if key not in ("joint", "fitted")}
    assert {key: getattr(again, key) for key in plain} == plain
    json.dumps(model.state(), default=lambda tensor: tensor.tolist())


def leaves(state: Any) -> list[Any]:
    if isinstance(state, Mapping):
        return [leaf for part in state.values() for leaf in leaves(part)]
    if isinstance(state, list):
        return [leaf for part in state for leaf in leaves(part)]
    return [state]


@pytest.mark.parametrize("model", [GaussianJointModel(), KernelJointModel()])
def test_an_unfitted_model_is_not_saved(model: AbstractJointModel) -> None:
    with pytest.raises(NotFittedError, match="use what it returns"):
        model.state()


def damaged(*path: str, value: Any = ...) -> dict[str, Any]:
    state = copy.deepcopy(fitted("shrinkage").state())
    part = state
    for key in path[:-1]:
        part = part[key]
    if value is ...:
        del part[path[-1]]
    else:
        part[path[-1]] = value
    return state


JOINT = ("fields", "joint")
DAMAGES = {
    "a field is missing": (damaged("fields", "environment"), "with the fields .* got \\['environment'\\] missing"),
    "a field too many": (damaged("fields", "rank", value=3), "\\['rank'\\] unknown"),
    "deep inside": (damaged(*JOINT, "fields", "mean"), "Expected GaussianJointModel.joint with .*'mean'"),
    "no class": (damaged("class"), "something that state\\(\\) wrote, got a mapping with the keys \\['fields'\\]"),
    "unknown module": (damaged("class", value="no_such_package:Model"), "importable, got no_such_package:Model"),
    "unknown class": (damaged("class", value="eaip_prob.models:Model"), "importable, got eaip_prob.models:Model"),
    "a function": (damaged("class", value="os:system"), "of a dataclass, got os:system"),
    "no name": (damaged("class", value=3), "as 'module:Class', got 3"),
    "a name without a module": (damaged("class", value=":x"), "importable, got :x"),
    "other sizes": (
        damaged(*JOINT, "fields", "layout", "fields", "sizes", "mapping", "human", value=9),
        "Expected mean with shape",
    ),
    "NaN": (damaged(*JOINT, "fields", "mean", value=torch.full((9,), torch.nan)), "finite numbers in mean"),
    "a text for a mapping": (
        damaged(*JOINT, "fields", "layout", "fields", "sizes", value="human"),
        "joint.layout as a BlockLayout",
    ),
    "numbers as keys": (
        damaged(*JOINT, "fields", "layout", "fields", "sizes", "mapping", value={3: 1}),
        "layout.sizes as text, got 3",
    ),
    "an object": (damaged("fields", "environment", value=Fraction(1, 2)), "state\\(\\) wrote, got Fraction"),
    "no state": ({}, "got dict"),
    "another model": (fitted("kernel").state(), "Expected the state of a GaussianJointModel, got that of a Kernel"),
}


@pytest.mark.parametrize("case", DAMAGES)
def test_a_damaged_state_is_refused_in_a_sentence(case: str) -> None:
    state, message = DAMAGES[case]
    with pytest.raises(InputError, match=message):
        GaussianJointModel.from_state(state)


class Plain(AbstractJointModel):
    def fit(self, *_: Any, **__: Any) -> Plain:
        return self

    def posterior(self, *_: Any, **__: Any) -> Posterior:
        covariance = torch.tensor([[[1.0, 0.5], [0.5, 2.0]], [[3.0, 0.0], [0.0, 1.0]]], dtype=torch.float64)
        mean = torch.tensor([[0.0, 4.0], [10.0, 4.0]], dtype=torch.float64)
        parts = BlockGaussian(mean, covariance, BlockLayout({"human": 1, "robot": 1}))
        return Posterior(parts, torch.tensor([0.25, 0.75], dtype=torch.float64).log(), torch.tensor(0.0))


def test_a_model_that_is_no_dataclass_says_so() -> None:
    with pytest.raises(InputError, match="Expected Plain as a tensor, .* or dataclass, got Plain"):
        Plain().state()


def test_the_prior_given_is_the_mixture_in_one_gaussian() -> None:
    prior = Plain().prior
    torch.testing.assert_close(prior.mean, torch.tensor([7.5, 4.0], dtype=torch.float64), rtol=1e-14, atol=0)
    # within 0.25 * 1 + 0.75 * 3, between 0.25 * 0.75 * 10^2
    expected = torch.tensor([[2.5 + 18.75, 0.125], [0.125, 1.25]], dtype=torch.float64)
    torch.testing.assert_close(prior.covariance, expected, rtol=1e-14, atol=0)
    assert prior.layout.names == ("human", "robot")


@pytest.mark.parametrize("name", MODELS)
def test_the_prior_given_is_that_of_one_gaussian_to_the_digit(name: str) -> None:
    model = fitted(name)
    given = model.posterior(()).moment_matched()
    assert torch.equal(given.mean, model.prior.mean)
    torch.testing.assert_close(given.covariance, model.prior.covariance, rtol=0, atol=0)


def test_shapes_are_checked_by_the_class_itself() -> None:
    state = damaged(*JOINT, "fields", "covariance", value=torch.eye(3))
    with pytest.raises(ShapeError, match="covariance with shape"):
        GaussianJointModel.from_state(state)

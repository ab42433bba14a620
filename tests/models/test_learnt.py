from __future__ import annotations

from dataclasses import replace
from typing import Any

import pytest
import torch
from mutants_of_answering import OtherAnswer
from sound_model import Sound, changed
from stream_world import motions, quick
from torch import Tensor

from eaip_prob.errors import EaipError, InputError, NotPositiveDefiniteError
from eaip_prob.models import (
    AbstractJointModel,
    EmpiricalCovariance,
    GaussianJointModel,
    KernelJointModel,
    LowRankCovariance,
    Posterior,
)
from eaip_prob.models.learnt import check_learnt

SIZES = {"human": 3, "robot": 2, "environment": 2}


def weights(num: int = 4, units: float = 1.0) -> dict[str, Tensor]:
    draw = torch.Generator().manual_seed(1)
    return {
        block: units * torch.randn(num, size, generator=draw, dtype=torch.float64) + 3.0
        for block, size in SIZES.items()
    }


class NaNLearnt(Sound):
    def fit(self, *args: Any, **kwargs: Any) -> Any:
        return changed(super().fit(*args, **kwargs), lambda covariance: covariance * torch.nan)


class Indefinite(Sound):
    def fit(self, *args: Any, **kwargs: Any) -> Any:
        return changed(super().fit(*args, **kwargs), lambda part: part - 0.9 * torch.diag(part.diagonal()))


class TooCorrelated(Sound):
    def fit(self, *args: Any, **kwargs: Any) -> Any:
        def across(covariance: Tensor) -> Tensor:
            covariance[0, -1] = covariance[-1, 0] = 2.0 * (covariance[0, 0] * covariance[-1, -1]).sqrt()
            return covariance

        return changed(super().fit(*args, **kwargs), across)


class Nothing(Sound):
    def fit(self, *args: Any, **kwargs: Any) -> Any:
        super().fit(*args, **kwargs)


class WithoutRobot(Sound):
    def fit(self, weights: Any, *args: Any, **kwargs: Any) -> Any:
        model = super().fit(weights, *args, **kwargs)
        return replace(model, joint=model.prior.marginal(["human", "environment"]))


class NaNAnswer(Sound):
    def posterior(self, observations: Any, *args: Any, **kwargs: Any) -> Posterior:
        found = super().posterior(observations, *args, **kwargs)
        mean = found.components.mean * (torch.nan if observations else 1.0)
        return replace(found, components=replace(found.components, mean=mean))


class NegativeAnswer(OtherAnswer):
    def covariance_of(self, covariance: Tensor) -> Tensor:
        return -covariance


BROKEN: dict[type[Sound], tuple[type[EaipError], str]] = {
    NaNLearnt: (InputError, r"In NaNLearnt.fit: Expected finite numbers in covariance, got nan.*division by zero"),
    Indefinite: (NotPositiveDefiniteError, r"the prior of Indefinite with .* an eigenvalue of -.* in block 'human'"),
    TooCorrelated: (
        NotPositiveDefiniteError,
        r"prior of TooCorrelated with .* an eigenvalue of -.* between its blocks",
    ),
    Nothing: (InputError, "what fit returned as AbstractJointModel, got NoneType. Let fit return the fitted model"),
    WithoutRobot: (InputError, r"of WithoutRobot.fit a model of the blocks {'human'.*got {'human'"),
    NaNAnswer: (InputError, "In NaNAnswer.posterior: Expected finite numbers in mean, got nan"),
    NegativeAnswer: (
        NotPositiveDefiniteError,
        "posterior of NegativeAnswer after .* a variance of -.* in block 'robot'",
    ),
}


@pytest.mark.parametrize("model", BROKEN, ids=lambda model: model.__name__)
def test_a_predictor_names_a_broken_model_when_it_is_fitted(model: type[Sound]) -> None:
    error, message = BROKEN[model]
    with pytest.raises(error, match=message) as caught:
        quick(model=model()).fit(motions(9))
    assert type(caught.value) is error


@pytest.mark.parametrize(
    "model",
    [
        GaussianJointModel(EmpiricalCovariance()),
        GaussianJointModel(EmpiricalCovariance(), "regression"),
        GaussianJointModel(LowRankCovariance()),
        KernelJointModel(),
    ],
)
@pytest.mark.parametrize("units", [1e-4, 1e4])
def test_singular_covariances_and_any_units_pass(model: AbstractJointModel, units: float) -> None:
    check_learnt(model.fit(weights(4, units)), SIZES, "robot")


def test_a_block_that_never_varied_passes() -> None:
    rows = weights()
    rows["environment"][:] = 2.0
    check_learnt(GaussianJointModel().fit(rows), SIZES, "robot")


def test_the_target_alone() -> None:
    check_learnt(GaussianJointModel().fit({"human": weights()["human"]}, target="human"), {"human": 3}, "human")

from __future__ import annotations

import dataclasses

import pytest
import torch

from eaip_prob.errors import InputError
from eaip_prob.methods import METHODS, FittedMethods
from eaip_prob.models import EmpiricalCovariance, GaussianJointModel, ShrinkageCovariance
from eaip_prob.phase import ElapsedClock
from eaip_prob.prediction import InteractionPredictor
from eaip_prob.tasks.passing_over import PassingOver

PREDICTOR = InteractionPredictor(
    target="human",
    phase=ElapsedClock(),
    model=GaussianJointModel(ShrinkageCovariance(0.3)),
    noise=2.0,
    environment_noise=5.0,
    gate=False,
    trust=False,
    recalibrate=False,
)


@pytest.fixture(scope="module")
def demonstrations():
    return PassingOver().demonstrations(2, seed=0)


def fit(demonstrations, models):
    generator = torch.Generator().manual_seed(0)
    return FittedMethods.fit(PREDICTOR, PREDICTOR, demonstrations, generator, models)


def test_a_further_model_is_a_predictor_of_its_own_on_the_chosen_clock(demonstrations):
    model = GaussianJointModel(EmpiricalCovariance())
    methods = fit(demonstrations, {"eaip_plain": model})
    assert methods.names == (*METHODS, "eaip_plain")
    observed, scene = demonstrations[0].human.first(20), demonstrations[0].environment
    asked = (observed, scene, demonstrations[0].human.time, torch.as_tensor(demonstrations[0].human.end))
    came = methods.predict("eaip_plain", *asked)
    expected = dataclasses.replace(PREDICTOR, model=model).fit(demonstrations).predict(*asked[:3])
    torch.testing.assert_close(came.mean, expected.mean)
    assert not torch.allclose(came.mean, methods.predict("eaip", *asked).mean)


@pytest.mark.parametrize("name", ["eaip", "paper_ip"])
def test_a_name_that_is_taken_is_refused(demonstrations, name):
    with pytest.raises(InputError, match=f"got .'{name}'.. Choose other names"):
        fit(demonstrations, {name: GaussianJointModel()})

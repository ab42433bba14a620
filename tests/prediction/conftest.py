from __future__ import annotations

import dataclasses

import pytest
from prediction_world import demonstrations, paper, predictor

from eaip_prob.prediction import InteractionPredictor
from eaip_prob.primitives import DMP


@pytest.fixture(scope="session")
def fitted() -> InteractionPredictor:
    return predictor().fit(demonstrations(24))


@pytest.fixture(scope="session")
def ragged() -> InteractionPredictor:
    return predictor(DMP(num_basis=5)).fit(demonstrations(18, ragged=True, groups=2))


@pytest.fixture(scope="session")
def papers() -> dict[str, InteractionPredictor]:
    motions = demonstrations(18, ragged=True, groups=2)
    chosen = paper("robot").fit(motions)
    assert chosen.fitted is not None
    noise = {name: getattr(chosen.fitted, name).tolist() for name in ("noise", "environment_noise")}
    return {"robot": chosen, "human": dataclasses.replace(paper("human"), **noise).fit(motions)}

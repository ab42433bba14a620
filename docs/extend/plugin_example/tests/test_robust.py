# ruff: noqa: D100, D103
from __future__ import annotations

import math

import pytest
import torch
from eaip_prob_robust import RobustJointModel

from eaip_prob.errors import InputError, NotFittedError
from eaip_prob.linalg import orthonormal_coordinates
from eaip_prob.models import AbstractJointModel, EmpiricalCovariance, GaussianJointModel, ShrinkageCovariance
from eaip_prob.observation import LinearObservation


def motions(num: int, unusual: float = 0.0) -> dict[str, torch.Tensor]:
    draw = torch.Generator().manual_seed(0)
    scene = torch.randn(num, 1, generator=draw, dtype=torch.float64)
    scene[0] += unusual
    mixing = torch.randn(1, 30, generator=draw, dtype=torch.float64)
    noise = torch.randn(num, 30, generator=draw, dtype=torch.float64)
    return {"human": 5.0 + scene @ mixing + noise, "environment": scene}


def fitted(rows: dict[str, torch.Tensor], **arguments: object) -> RobustJointModel:
    return RobustJointModel(**arguments).fit(rows, target="human")


def test_bad_demonstrations_weigh_little_and_leave_the_mean_alone():
    rows = motions(40)
    clean = fitted(rows).prior
    rows["human"][:4] += 20.0
    robust, plain = fitted(rows), GaussianJointModel().fit(rows, target="human")
    assert float(robust.share[:4].max()) < 0.1 * float(robust.share[4:].min())
    moved, plain_moved = (model.prior.mean - clean.mean for model in (robust, plain))
    assert float(moved.norm()) < 0.1 * float(plain_moved.norm())
    assert float(robust.prior.covariance.trace()) < 2.0 * float(clean.covariance.trace())


def squared_error(model: AbstractJointModel, test: dict[str, torch.Tensor]) -> float:
    """Of the human's last weights predicted from its first ten and the scene, averaged."""
    first = torch.eye(30, dtype=torch.float64)[:10].expand(len(test["human"]), 1, 10, 30)
    noise, offset = torch.full_like(first[..., 0], 0.01), torch.zeros_like(first[..., 0])
    human = LinearObservation({"human": first}, offset, test["human"][:, None, :10], noise)
    scene = test["environment"][:, None]
    scene = LinearObservation({"environment": torch.eye(1)}, torch.zeros_like(scene), scene, 0.01 * torch.ones(1))
    mean = model.posterior([human, scene]).mean("human")
    return float((mean - test["human"])[:, 10:].square().mean())


def test_it_predicts_better_where_some_are_bad_and_no_worse_where_none_is():
    rows = motions(140)
    train, test = ({name: block[part] for name, block in rows.items()} for part in (slice(40), slice(40, None)))
    plain = GaussianJointModel(ShrinkageCovariance(0.3))
    robust = RobustJointModel(ShrinkageCovariance(0.3))
    errors = [squared_error(model.fit(train, target="human"), test) for model in (plain, robust)]
    assert errors[1] < 1.05 * errors[0]
    train["human"][:4, 10:] += 20.0  # they end elsewhere
    errors = [squared_error(model.fit(train, target="human"), test) for model in (plain, robust)]
    assert errors[1] < 0.7 * errors[0]


def test_an_unusual_scene_is_no_bad_demonstration():
    share = fitted(motions(40, unusual=20.0)).share
    assert float(share[0]) > 0.5 * float(share.median())


def test_without_tails_it_is_the_plain_gaussian():
    rows = motions(12)
    robust = fitted(rows, tail=math.inf, covariance=ShrinkageCovariance(0.3)).prior
    plain = GaussianJointModel(ShrinkageCovariance(0.3)).fit(rows, target="human").prior
    torch.testing.assert_close(robust.mean, plain.mean)
    torch.testing.assert_close(robust.covariance, plain.covariance)


def test_weights_are_at_their_fixed_point():
    rows = motions(40)
    rows["human"][:4] += 20.0
    model = fitted(rows, covariance=EmpiricalCovariance())
    centred = torch.cat(list(rows.values()), -1) - model.prior.mean
    cov = model.prior.covariance
    rest = centred[:, :30] - centred[:, 30:] * cov[30, :30] / cov[30, 30]
    variance = model.share @ rest.square()
    weight = 2.0 / (1.0 + (rest.square() / variance).mean(-1))
    torch.testing.assert_close(model.share, weight / weight.sum(), rtol=1e-6, atol=0.0)


def test_what_is_unusual_is_measured_in_the_coordinates_of_the_motion():
    rows = motions(20)
    root = torch.randn(30, 30, generator=torch.Generator().manual_seed(1), dtype=torch.float64)
    gram = root.mT @ root + torch.eye(30, dtype=torch.float64)
    forward, _ = orthonormal_coordinates(gram)
    model = RobustJointModel().fit(rows, target="human", grams={"human": gram})
    torch.testing.assert_close(model.share, fitted({**rows, "human": rows["human"] @ forward.mT}).share)


def test_weights_that_never_vary_have_no_say():
    rows = motions(20)
    rows["human"][:, 3] = 7.0
    without = {**rows, "human": torch.cat([rows["human"][:, :3], rows["human"][:, 4:]], -1)}
    torch.testing.assert_close(fitted(rows).share, fitted(without).share)
    still = {"human": torch.ones(5, 2, dtype=torch.float64)}
    torch.testing.assert_close(fitted(still).share, torch.full((5,), 0.2, dtype=torch.float64))


@pytest.mark.parametrize("tail", [0.0, -1.0, math.nan])
def test_a_tail_that_cannot_be_is_refused(tail):
    with pytest.raises(InputError, match="tail above 0"):
        RobustJointModel(tail=tail)


def test_an_unfitted_model_says_so():
    with pytest.raises(NotFittedError, match="Call fit"):
        RobustJointModel().posterior(())

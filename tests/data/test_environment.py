from __future__ import annotations

import math

import pytest
import torch

from eaip_prob.data import EnvironmentFeatures, stack_environments
from eaip_prob.errors import InputError, ShapeError

NAMES = ("width", "height", "depth")


def make(batch=(), seed=0):
    generator = torch.Generator().manual_seed(seed)
    value = torch.randn(*batch, 3, generator=generator, dtype=torch.float64) * 9 + 120
    root = torch.randn(*batch, 3, 3, generator=generator, dtype=torch.float64)
    observed = torch.rand(*batch, 3, generator=generator) > 0.4
    return EnvironmentFeatures(NAMES, value, root @ root.mT, observed)


@pytest.mark.parametrize(
    ("arguments", "error", "message"),
    [
        ({"names": ["a"], "value": 3.0}, ShapeError, "got a single number"),
        ({"names": ["a"], "value": [1.0, 2.0]}, InputError, "2 different names"),
        ({"names": ["a", "a"], "value": [1.0, 2.0]}, InputError, "2 different names"),
        ({"names": ["a"], "value": [math.inf]}, InputError, "finite numbers in value"),
        ({"names": ["a"], "value": [1.0], "covariance": [1.0]}, ShapeError, r"covariance with shape \(\*batch, 1, 1\)"),
        ({"names": ["a"], "value": [1.0], "covariance": [[math.nan]]}, InputError, "finite numbers in covariance"),
        ({"names": ["a"], "value": [1.0], "covariance": [[-1.0]]}, InputError, "negative variance"),
        ({"names": ["a"], "value": [[1.0]] * 3, "covariance": [[[1.0]]] * 2}, ShapeError, r"shape \(3, 1, 1\), or"),
        ({"names": ["a"], "value": [1.0], "observed": [1.0]}, InputError, "observed as booleans"),
        ({"names": ["a"], "value": [1.0], "observed": [True, True]}, ShapeError, "observed with the shape of value"),
    ],
)
def test_bad_input(arguments, error, message):
    with pytest.raises(error, match=message):
        EnvironmentFeatures(**arguments)


def test_defaults_are_exact_and_observed():
    features = EnvironmentFeatures(NAMES, torch.ones(2, 3))
    assert features.observed.all()
    assert features.covariance.shape == (2, 3, 3)
    assert not features.covariance.any()


def test_covariance_shared_by_a_batch_is_indexable():
    shared = torch.diag(torch.tensor([1.0, 4.0, 9.0], dtype=torch.float64))
    features = EnvironmentFeatures(NAMES, torch.ones(2, 3), shared)
    assert torch.equal(features[1].covariance, shared)


def test_unobserved_value_is_never_kept():
    features = EnvironmentFeatures(("a", "b"), [math.nan, 2.0], observed=[False, True])
    assert features.value.tolist() == [0.0, 2.0]
    assert not EnvironmentFeatures.unseen(NAMES).observed.any()


@pytest.mark.parametrize("batch", [(), (2, 3)])
def test_ordered_as(batch):
    features = make(batch)
    ordered = features.ordered_as(("depth", "width", "height"))
    order = [2, 0, 1]
    assert ordered.names == ("depth", "width", "height")
    assert torch.equal(ordered.value, features.value[..., order])
    assert torch.equal(ordered.observed, features.observed[..., order])
    for i, j in ((0, 1), (2, 2), (1, 2)):
        assert torch.equal(ordered.covariance[..., i, j], features.covariance[..., order[i], order[j]])
    back = ordered.ordered_as(NAMES)
    assert torch.equal(back.covariance, features.covariance)
    assert features.ordered_as(NAMES) is features


def test_ordered_as_refuses_other_names():
    with pytest.raises(InputError, match=r"features \('width',\), got \('width', 'height', 'depth'\)"):
        make().ordered_as(("width",))


def test_index():
    features = make((2, 3))
    assert torch.equal(features[1].value, features.value[1])
    with pytest.raises(InputError, match="this one is single"):
        make()[0]


def test_stack_orders_members():
    first, second = make(), make(seed=1)
    batch = stack_environments([first, second.ordered_as(("height", "depth", "width"))])
    assert batch.names == NAMES
    assert torch.equal(batch.value, torch.stack([first.value, second.value]))
    assert torch.equal(batch.covariance[1], second.covariance)
    assert torch.equal(batch.observed[1], second.observed)


def test_stack_refuses():
    with pytest.raises(InputError, match="at least one set"):
        stack_environments([])
    with pytest.raises(InputError, match="Expected environment features"):
        stack_environments([make(), EnvironmentFeatures(("other",), [1.0])])

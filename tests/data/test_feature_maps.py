from __future__ import annotations

import numpy as np
import pytest
import torch

from eaip_prob.data import (
    DistanceFeatures,
    EnvironmentFeatures,
    QuadraticFeatures,
    RawFeatures,
    stack_environments,
)
from eaip_prob.data.independence import independent_columns
from eaip_prob.errors import InputError, NotFittedError, ShapeError

NAMES = ("x", "y", "size")
MAPS = [RawFeatures(), QuadraticFeatures(), DistanceFeatures(["y", "x"])]
UNITS = torch.tensor([0.4, 0.4, 30.0], dtype=torch.float64)


def scenes(*batch, seed=0, sensor=0.0, hidden=0.0):
    generator = torch.Generator().manual_seed(seed)
    value = UNITS * (torch.randn(*batch, 3, generator=generator, dtype=torch.float64) + torch.tensor([2.0, -1.0, 4.0]))
    root = UNITS[:, None] * torch.randn(*batch, 3, 3, generator=generator, dtype=torch.float64) * sensor
    observed = torch.rand(*batch, 3, generator=generator) >= hidden
    return EnvironmentFeatures(NAMES, value, root @ root.mT, observed)


@pytest.fixture(params=MAPS, ids=lambda each: type(each).__name__)
def fitted(request):
    return request.param.fit(scenes(40))


def test_values_of_squares_and_products():
    data = scenes(40)
    quadratic = QuadraticFeatures().fit(data)
    assert quadratic.names == (*NAMES, "x^2", "x*y", "x*size", "y^2", "y*size", "size^2")
    z = (data.value.numpy() - data.value.numpy().mean(0)) / data.value.numpy().std(0)
    expected = np.column_stack([z, *[z[:, i] * z[:, j] for i in range(3) for j in range(i, 3)]])
    np.testing.assert_allclose(quadratic(data).value, expected, rtol=1e-12, atol=1e-12)
    assert not quadratic(data).covariance.any()


def test_values_of_distances():
    other = EnvironmentFeatures(NAMES, [[3.0, -4.0, 7.0], [0.0, 0.0, 7.0]])
    data = EnvironmentFeatures(NAMES, [[6.0, 8.0, 1.0], [0.3, 0.4, 1.0], [3.0, 4.0, 1.0]])
    mapped = DistanceFeatures(["x", "y"]).fit(data)(other)
    assert mapped.names == (*NAMES, "distance", "log_distance")
    np.testing.assert_allclose(mapped.value[:, 3:], [[5.0, np.log(5.0)], [0.0, np.log(0.005)]])


def test_fitting_leaves_the_map_and_its_argument_as_they_were(fitted):
    for each in MAPS:
        assert each.input_names is None
    data, extra = scenes(40, sensor=0.1), scenes(5, seed=1)
    before = data.value.clone(), data.covariance.clone()
    fitted.fit(data)(extra)
    assert torch.equal(data.value, before[0]) and torch.equal(data.covariance, before[1])


@pytest.mark.parametrize("sensor", [0.0, 0.2])
def test_a_batch_is_its_members(fitted, sensor):
    batch = scenes(2, 3, seed=2, sensor=sensor, hidden=0.3)
    mapped = fitted(batch)
    for i in range(2):
        for j in range(3):
            single = fitted(batch[i][j])
            torch.testing.assert_close(mapped.value[i, j], single.value)
            torch.testing.assert_close(mapped.covariance[i, j], single.covariance)
            assert torch.equal(mapped.observed[i, j], single.observed)


def test_the_order_of_the_features_does_not_matter(fitted):
    scene = scenes(seed=3, sensor=0.2)
    turned = scene.ordered_as(("size", "x", "y"))
    assert fitted(turned).names == fitted(scene).names
    assert torch.equal(fitted(turned).value, fitted(scene).value)
    assert torch.equal(fitted(turned).covariance, fitted(scene).covariance)


@pytest.mark.parametrize("each", MAPS[1:])
def test_added_features_are_observed_where_all_of_their_parts_are(each):
    fitted = each.fit(scenes(40))
    mask = torch.tensor([[True, True, True], [True, False, True], [False, False, True], [False, False, False]])
    whole = scenes(4, seed=4, sensor=0.1)
    mapped = fitted(EnvironmentFeatures(NAMES, whole.value, whole.covariance, mask))
    for row, seen in enumerate(mask.tolist()):
        known = dict(zip(NAMES, seen, strict=True))
        for name, observed in zip(fitted.names, mapped.observed[row].tolist(), strict=True):
            parts = ["x", "y"] if "distance" in name else name.removesuffix("^2").split("*")
            assert observed == all(known[part] for part in parts), name
    shown = torch.where(mapped.observed, fitted(whole).value, 0.0)
    torch.testing.assert_close(mapped.value, shown)


@pytest.mark.parametrize("each", MAPS[1:])
def test_to_first_order_the_covariance_is_that_of_finite_differences(each):
    fitted, scene, tiny = each.fit(scenes(40)), scenes(seed=5, sensor=1e-5), 1e-6
    columns = []
    for i in range(3):
        step = torch.zeros(3, dtype=torch.float64)
        step[i] = tiny * UNITS[i]
        up, down = (fitted(EnvironmentFeatures(NAMES, scene.value + sign * step)).value for sign in (1, -1))
        columns.append((up - down) / (2 * step[i]))
    slopes = torch.stack(columns, -1)
    expected = slopes @ scene.covariance @ slopes.mT
    torch.testing.assert_close(fitted(scene).covariance, expected, rtol=1e-4, atol=1e-6 * float(expected.abs().max()))


def test_squares_have_the_moments_of_a_gaussian_sensor():
    quadratic, truth = QuadraticFeatures().fit(scenes(40)), scenes(seed=6, sensor=0.5)
    num = 30_000
    noise = torch.randn(num, 3, generator=torch.Generator().manual_seed(7), dtype=torch.float64)
    seen = truth.value + noise @ torch.linalg.cholesky(truth.covariance).mT
    exact = quadratic(EnvironmentFeatures(NAMES, truth.value)).value
    error = quadratic(EnvironmentFeatures(NAMES, seen, truth.covariance)).value - exact
    bias_error = error.std(0) / num**0.5
    assert bool((error.mean(0).abs() < 4.5 * bias_error).all())
    products = error[:, :, None] * error[:, None, :]
    standard_error = products.std(0) / num**0.5
    # The formula is exact at the truth; at a measurement it is an estimate.
    expected = quadratic(EnvironmentFeatures(NAMES, truth.value, truth.covariance)).covariance
    assert bool(((products.mean(0) - expected).abs() < 4.5 * standard_error).all())


def test_covariance_of_squares_is_isserlis_theorem():
    quadratic, scene = QuadraticFeatures().fit(scenes(40)), scenes(seed=8, sensor=0.7)
    deviation = scenes(40).value.numpy().std(0)
    z = quadratic(EnvironmentFeatures(NAMES, scene.value)).value.numpy()[:3]
    s = scene.covariance.numpy() / np.outer(deviation, deviation)
    pairs = [(i, j) for i in range(3) for j in range(i, 3)]
    expected = np.zeros((9, 9))
    expected[:3, :3] = s
    for a, (i, j) in enumerate(pairs):
        for k in range(3):
            expected[3 + a, k] = expected[k, 3 + a] = z[i] * s[j, k] + z[j] * s[i, k]
        for b, (k, m) in enumerate(pairs):
            first = z[i] * z[k] * s[j, m] + z[i] * z[m] * s[j, k] + z[j] * z[k] * s[i, m] + z[j] * z[m] * s[i, k]
            expected[3 + a, 3 + b] = first + s[i, k] * s[j, m] + s[i, m] * s[j, k]
    mapped = quadratic(scene)
    np.testing.assert_allclose(mapped.covariance, expected, rtol=1e-9, atol=1e-12)
    np.testing.assert_allclose(mapped.value[3:], [z[i] * z[j] - s[i, j] for i, j in pairs], rtol=1e-9, atol=1e-12)


def test_distance_is_right_for_small_errors_by_monte_carlo():
    distance, num = DistanceFeatures(["x", "y"]).fit(scenes(40)), 100_000
    truth = EnvironmentFeatures(NAMES, [0.8, -0.5, 3.0], torch.diag(torch.tensor([4e-4, 1e-4, 0.0])).double())
    noise = torch.randn(num, 3, generator=torch.Generator().manual_seed(1), dtype=torch.float64)
    seen = truth.value + noise * truth.covariance.diagonal().sqrt()
    error = distance(EnvironmentFeatures(NAMES, seen)).value - distance(truth).value
    products = error[:, 3:, None] * error[:, None, 3:]
    difference = (products.mean(0) - distance(truth).covariance[3:, 3:]).abs()
    assert bool((difference < 4.5 * products.std(0) / num**0.5 + 2e-3 * products.mean(0)).all())


def test_units_do_not_matter():
    factor = torch.tensor([1000.0, 1000.0, 0.01], dtype=torch.float64)

    def scaled(scene):
        return EnvironmentFeatures(NAMES, scene.value * factor, scene.covariance * factor[:, None] * factor)

    data, scene = scenes(40), scenes(5, seed=9, sensor=0.3)
    one, other = QuadraticFeatures().fit(data)(scene), QuadraticFeatures().fit(scaled(data))(scaled(scene))
    torch.testing.assert_close(one.value, other.value)
    torch.testing.assert_close(one.covariance, other.covariance)
    one = DistanceFeatures(["x", "y"]).fit(data)(scene)
    other = DistanceFeatures(["x", "y"]).fit(scaled(data))(scaled(scene))
    torch.testing.assert_close(one.value[:, 3] * 1000.0, other.value[:, 3])
    torch.testing.assert_close(one.value[:, 4] + float(np.log(1000.0)), other.value[:, 4])


def test_products_that_add_nothing_are_left_out():
    generator = torch.Generator().manual_seed(0)
    size = 0.3 * torch.randn(30, generator=generator, dtype=torch.float64) + 7.0
    chair = (torch.rand(30, generator=generator) > 0.5).double()
    value = torch.stack([size, chair, 1.0 - chair, torch.full_like(size, 0.1)], -1)
    data = EnvironmentFeatures(("size", "chair", "ladder", "legs"), value)
    fitted = QuadraticFeatures().fit(data)
    assert fitted.names[4:] == ("size^2", "size*chair")
    covariance = np.cov(fitted(data).value[:, [0, 1, 4, 5]].numpy().T)
    assert np.linalg.eigvalsh(covariance)[0] > 1e-3


def test_few_demonstrations_keep_fewer_products_than_demonstrations():
    fitted = QuadraticFeatures().fit(scenes(6))
    assert len(fitted.names) == 5
    centred = fitted(scenes(6)).value - fitted(scenes(6)).value.mean(0)
    assert torch.linalg.matrix_rank(centred) == 5
    only = QuadraticFeatures().fit(scenes(1))
    assert only.names == NAMES
    assert only(scenes(2, seed=1, sensor=0.1)).value.shape == (2, 3)


def test_missing_features_do_not_bias_the_fit():
    data = scenes(60, hidden=0.3)
    fitted = QuadraticFeatures().fit(data)
    for column in range(3):
        seen = data.value[data.observed[:, column], column].numpy()
        assert float(fitted.mean[column]) == pytest.approx(seen.mean())
        assert float(fitted.deviation[column]) == pytest.approx(seen.std())
    assert len(fitted.names) == 9


def test_what_was_never_seen_together_has_no_product():
    data = scenes(40)
    alternate = torch.arange(40)[:, None] % 2 == torch.tensor([0, 1, 0])
    fitted = QuadraticFeatures().fit(EnvironmentFeatures(NAMES, data.value, observed=alternate))
    assert fitted.names[3:] == ("x^2", "x*size", "y^2", "size^2")


def test_independent_columns_compare_rows_that_are_observed():
    generator = torch.Generator().manual_seed(0)
    base = torch.randn(12, 2, generator=generator, dtype=torch.float64)
    table = torch.cat([base, 3.0 - base.sum(1, keepdim=True), base[:, :1] ** 2], -1)
    observed = torch.ones_like(table, dtype=torch.bool)
    assert independent_columns(table, observed).tolist() == [0, 1, 3]
    assert independent_columns(table, observed, 3).tolist() == [0, 1, 2, 3]
    table[5, 2] = 99.0
    assert independent_columns(table, observed).tolist() == [0, 1, 2, 3]
    observed[5, 2] = False
    assert independent_columns(table, observed).tolist() == [0, 1, 3]


def test_a_column_that_is_nearly_another_is_kept():
    base, other = torch.randn(2, 12, 1, generator=torch.Generator().manual_seed(0), dtype=torch.float64)
    table = torch.cat([base, base + 1e-4 * other, 2.0 * base + 1e-9 * other], -1)
    assert independent_columns(table, torch.ones_like(table, dtype=torch.bool)).tolist() == [0, 1]


def test_what_was_not_observed_is_not_compared():
    stored = torch.randn(12, generator=torch.Generator().manual_seed(0), dtype=torch.float64)
    stored[6:] = 0.0
    observed = torch.ones(12, 2, dtype=torch.bool)
    observed[6:, 0] = False
    assert independent_columns(stored[:, None].expand(12, 2), observed).tolist() == [0, 1]


@pytest.mark.parametrize("each", MAPS, ids=lambda each: type(each).__name__)
def test_a_map_must_be_fitted(each):
    with pytest.raises(NotFittedError, match=f"fitted {type(each).__name__}"):
        each(scenes(2))
    with pytest.raises(NotFittedError, match=f"fitted {type(each).__name__}"):
        _ = each.names


def test_refusals(fitted):
    with pytest.raises(ShapeError, match="at least one demonstration"):
        fitted.fit(scenes())
    with pytest.raises(InputError, match="environment features"):
        fitted(EnvironmentFeatures(("x",), [1.0]))
    with pytest.raises(InputError, match="EnvironmentFeatures, got list"):
        fitted([1.0, 2.0, 3.0])


@pytest.mark.parametrize("offsets", [["x", "z"], ["width"]])
def test_offsets_must_be_features(offsets):
    with pytest.raises(InputError, match="offsets among the environment features"):
        DistanceFeatures(offsets).fit(scenes(4))
    with pytest.raises(InputError, match="none named distance"):
        DistanceFeatures(["x"]).fit(EnvironmentFeatures(("x", "distance"), [[1.0, 2.0]]))


def test_offsets_are_named_once():
    assert DistanceFeatures("x").offsets == ("x",)
    with pytest.raises(InputError, match="none. Use RawFeatures"):
        DistanceFeatures([])
    with pytest.raises(InputError, match="different names"):
        DistanceFeatures(["x", "x"])


def test_unseen_environments_stay_unseen(fitted):
    mapped = fitted(stack_environments([EnvironmentFeatures.unseen(NAMES), scenes()]))
    assert not mapped.observed[0].any() and mapped.observed[1].all()

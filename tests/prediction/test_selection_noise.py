from __future__ import annotations

import dataclasses

import numpy as np
import pytest
import torch
from scipy.stats import chi2, norm
from selection_world import SAMPLES, demonstrations, deviation, fit

from eaip_prob.data.demonstrations import Demonstration, DemonstrationSet
from eaip_prob.data.environment import EnvironmentFeatures
from eaip_prob.data.trajectory import Trajectory
from eaip_prob.errors import HeldOutWarning, InputError
from eaip_prob.models import EmpiricalCovariance, GaussianJointModel
from eaip_prob.selection import (
    DEFAULT_ENVIRONMENT_NOISE,
    DEFAULT_NOISE,
    ENVIRONMENT_MULTIPLES,
    _calibration,
    _calibration_of_groups,
)


@pytest.mark.parametrize("num", [1, 9, 10, 11, 999])
def test_calibration_is_the_quantile_over_that_of_chi_square(num: int) -> None:
    squares = torch.randn(num, generator=torch.Generator().manual_seed(0), dtype=torch.float64).square() * 7.0
    expected = np.quantile(squares.numpy(), 0.9, method="inverted_cdf") / chi2.ppf(0.9, 1)
    assert _calibration(squares) == pytest.approx(expected, rel=1e-9)


def test_calibrated_intervals_hold_nine_of_ten_held_out_samples() -> None:
    squares = torch.arange(1.0, 101.0, dtype=torch.float64)
    half = norm.ppf(0.95) ** 2 * _calibration(squares)
    assert int((squares <= half * (1 + 1e-9)).sum()) == 90


def test_calibration_of_nothing_of_no_error_and_of_a_motion_far_off() -> None:
    assert _calibration(torch.zeros(0, dtype=torch.float64)) == 1.0
    assert _calibration(torch.zeros(30, dtype=torch.float64)) == 1e-3
    squares = torch.linspace(0.1, 3.0, 100, dtype=torch.float64)
    far = torch.where(torch.arange(100) < 95, squares, 1e6)
    assert _calibration(far) == _calibration(squares)


@pytest.mark.parametrize(("num", "rank"), [(1, 1), (5, 5), (10, 10), (19, 18), (99, 90)])
def test_calibration_of_groups_is_that_of_the_one_which_nine_of_ten_new_ones_do_not_exceed(num: int, rank: int) -> None:
    groups = [torch.full((7,), float(scale)) for scale in np.random.default_rng(0).permutation(num) + 1]
    assert _calibration_of_groups([*groups, torch.zeros(0)]) == pytest.approx(rank / chi2.ppf(0.9, 1), rel=1e-6)
    assert _calibration_of_groups([torch.zeros(0)]) == _calibration_of_groups([]) == 1.0


def test_a_new_group_is_held_as_often_as_promised() -> None:
    generator = np.random.default_rng(1)
    held = []
    for _ in range(300):
        scales = generator.gamma(3.0, 1.0, 11)
        groups = [torch.from_numpy(scale * generator.standard_normal(400) ** 2) for scale in scales]
        half = chi2.ppf(0.9, 1) * _calibration_of_groups(groups[:10])
        held.append(float((groups[10] <= half).double().mean()) >= 0.9)
    assert np.mean(held) == pytest.approx(10 / 11, abs=0.07)  # 4 standard errors


def test_calibration_by_groups_is_wider_and_its_name_is_checked() -> None:
    motions = demonstrations(16)
    wide, usual = (fit(motions, noise=0.01, recalibrate=how).inflation for how in ("groups", True))
    assert wide > usual > 0.0
    with pytest.raises(InputError, match="'groups', got 'people'"):
        fit(motions, recalibrate="people")


def test_noise_follows_the_sensor() -> None:
    loud, quiet = (
        fit(demonstrations(16, sensor=sensor), criterion="evidence", environment_noise=5.0) for sensor in (1.0, 0.05)
    )
    assert float(loud.noise) > 3 * float(quiet.noise)


def test_given_noise_is_kept() -> None:
    fitted = fit(demonstrations(8), noise=0.123, environment_noise=[4.5])
    assert fitted.noise.tolist() == [0.123]
    assert fitted.environment_noise.tolist() == [4.5]
    assert fitted.inflation != 1.0
    one = fit(demonstrations(8), noise=0.123)
    assert one.noise.tolist() == [0.123] and float(one.environment_noise) in [
        pytest.approx(multiple * deviation(demonstrations(8))[1]) for multiple in ENVIRONMENT_MULTIPLES
    ]


def test_one_group_takes_the_defaults() -> None:
    motions = demonstrations(8, groups=1)
    with pytest.warns(HeldOutWarning, match="variances are not calibrated"):
        fitted = fit(motions)
    scale, spread = deviation(motions)
    np.testing.assert_allclose(fitted.noise, [DEFAULT_NOISE * scale], rtol=1e-9)
    np.testing.assert_allclose(fitted.environment_noise, [DEFAULT_ENVIRONMENT_NOISE * spread], rtol=1e-9)
    assert fitted.inflation == 1.0 and fitted.num_folds == 0


def test_units_do_not_matter() -> None:
    motions = demonstrations(8)
    other = []
    for one in motions:
        assert one.human is not None and one.robot is not None and one.environment is not None
        human = dataclasses.replace(one.human, values=one.human.values * 1000.0)
        robot = dataclasses.replace(one.robot, values=one.robot.values * 1e-3)
        other.append(Demonstration(human, robot, EnvironmentFeatures(("width",), one.environment.value * 50.0)))
    before, after = fit(motions), fit(DemonstrationSet(other, motions.groups))
    torch.testing.assert_close(after.noise, before.noise * 1000.0, rtol=1e-9, atol=0)
    torch.testing.assert_close(after.environment_noise, before.environment_noise * 50.0, rtol=1e-9, atol=0)
    np.testing.assert_allclose(after.inflation, before.inflation, rtol=1e-6)


def test_inflation_is_one_where_the_model_is_right() -> None:
    model = GaussianJointModel(EmpiricalCovariance())
    fitted = fit(demonstrations(160, sensor=0.01, feature_noise=0.0), noise=0.01, environment_noise=0.0, model=model)
    # 160 motions with 8 degrees of freedom each leave sqrt(2 / 1280) = 4 %; half of them train: 13 / 80 = 16 % more.
    assert 0.9 < fitted.inflation < 1.35


def test_inflation_grows_with_over_confidence() -> None:
    model = GaussianJointModel(EmpiricalCovariance())
    fitted = fit(demonstrations(16, sensor=0.01), noise=0.01, environment_noise=0.5, model=model)
    assert fitted.inflation > 2.0
    assert fit(demonstrations(16), noise=0.01, recalibrate=False).inflation == 1.0


def test_features_that_were_missed_do_not_widen_the_spread() -> None:
    motions = demonstrations(9, groups=1)
    part = []
    for i, one in enumerate(motions):
        assert one.environment is not None
        seen = torch.tensor([i % 3 != 0])
        part.append(dataclasses.replace(one, environment=dataclasses.replace(one.environment, observed=seen)))
    values = [float(one.environment.value) for i, one in enumerate(motions) if i % 3 and one.environment]
    with pytest.warns(HeldOutWarning):
        fitted = fit(DemonstrationSet(part, motions.groups))
    np.testing.assert_allclose(fitted.environment_noise, [DEFAULT_ENVIRONMENT_NOISE * np.std(values)], rtol=1e-9)


def test_what_does_not_vary_still_has_noise() -> None:
    given, motions = demonstrations(6), []
    for one in given:
        assert one.human is not None
        still = dataclasses.replace(one.human, values=torch.full_like(one.human.values, 0.7))
        motions.append(dataclasses.replace(one, human=still, environment=EnvironmentFeatures(("width",), [0.0])))
    fitted = fit(DemonstrationSet(motions, given.groups))
    assert float(fitted.noise) > 1e-6 and float(fitted.environment_noise) > 1e-6
    assert np.isfinite(fitted.inflation)


def test_constant_signal_of_the_robot_leaves_the_calibration_alone() -> None:
    motions, still = demonstrations(10), []
    for one in motions:
        assert one.robot is not None
        values = torch.cat([one.robot.values, torch.zeros(SAMPLES, 1, dtype=torch.float64)], -1)
        still.append(dataclasses.replace(one, robot=Trajectory(one.robot.time, values, ("u", "v", "w"))))
    given = {"noise": 0.3, "environment_noise": 5.0}
    before, after = fit(motions, **given), fit(DemonstrationSet(still, motions.groups), **given)
    np.testing.assert_allclose(after.inflation, before.inflation, rtol=1e-6)

from __future__ import annotations

import warnings
from collections.abc import Callable
from functools import cache
from typing import Any

import pytest
import torch
from joint_model_mutants import MUTANTS
from mutants_of_learning import IgnoresMasks
from sound_model import Sound

from eaip_prob.errors import InputError, NumericalWarning
from eaip_prob.models import (
    AbstractJointModel,
    EmpiricalCovariance,
    GaussianJointModel,
    KernelJointModel,
    LowRankCovariance,
    Posterior,
)
from eaip_prob.testing import Check, joint_model_checks
from eaip_prob.testing.world import World

SINGULAR = "the sample covariance of N demonstrations has rank N - 1"
MODELS: dict[str, tuple[Callable[[], AbstractJointModel], dict[str, str]]] = {
    "shrinkage": (GaussianJointModel, {}),
    "empirical": (lambda: GaussianJointModel(EmpiricalCovariance()), {"check_few_demonstrations": SINGULAR}),
    "low_rank": (lambda: GaussianJointModel(LowRankCovariance()), {}),
    "regression": (
        lambda: GaussianJointModel(environment="regression"),
        {
            "check_definite": "features are a linear function of the weights; their residual is in the noise (Eq. 19)",
            "check_few_demonstrations": "features are a linear function of the weights",
            "check_units": "of fewer demonstrations than weights the minimum-norm solution depends on units (Eq. 16)",
        },
    ),
    "kernel": (KernelJointModel, {}),
}
# Nothing fails these alone; they take some milliseconds, and name a mistake that others only notice.
CHEAP = {"check_one_after_the_other", "check_variance_never_grows"}
REAL = [check for make, known in MODELS.values() for check in joint_model_checks(make, known)]
IDS = [f"{name}-{check.__name__}" for name, (make, _) in MODELS.items() for check in joint_model_checks(make)]


@pytest.mark.parametrize("check", REAL, ids=IDS)
def test_our_models(check: Check) -> None:
    check()


@cache
def failures(model: type[Sound]) -> dict[str, str]:
    found, state = {}, torch.get_rng_state()
    for check in joint_model_checks(model):
        try:
            check()
        except AssertionError as error:
            found[check.__name__] = str(error)
    torch.set_rng_state(state)
    return found


def test_without_a_bug_nothing_fails() -> None:
    assert failures(Sound) == {}


@pytest.mark.parametrize("mutant", MUTANTS, ids=lambda mutant: mutant.__name__)
def test_every_planted_bug_is_found_and_named(mutant: type[Sound]) -> None:
    found = failures(mutant)
    assert found, mutant.__doc__
    promises = {check.__name__: check.promise.rstrip(".") for check in joint_model_checks(mutant)}
    for name, message in found.items():
        start = f"Expected of {mutant.__name__} ({name}): {promises[name]}; got "
        assert message.startswith(start), message
        rest = message.removeprefix(start)
        assert rest.endswith(".") and "\n" not in rest and "; " in rest, message


def test_every_check_finds_a_bug_that_no_other_finds() -> None:
    matrix = {mutant: set(failures(mutant)) for mutant in MUTANTS}
    alone = {name for found in matrix.values() if len(found) == 1 for name in found}
    names = {check.__name__ for model in (*MUTANTS, Sound) for check in joint_model_checks(model)}
    assert names - alone == CHEAP
    assert {name for found in matrix.values() for name in found} >= CHEAP
    assert len({mutant.__doc__ for mutant in MUTANTS}) == len(MUTANTS) >= 20


def test_what_a_model_declares_selects_its_checks() -> None:
    def names(make: Callable[[], AbstractJointModel]) -> set[str]:
        return {check.__name__ for check in joint_model_checks(make)}

    gaussian, kernel, whole = names(GaussianJointModel), names(KernelJointModel), names(IgnoresMasks)
    only = {"check_dense_formula", "check_one_after_the_other", "check_variance_never_grows"}
    assert gaussian - kernel == only and not kernel - gaussian
    assert whole - kernel == {"check_missing_refused"} and kernel - whole == {"check_missing"}


def chosen(name: str, make: Callable[[], AbstractJointModel], **known: str) -> Check:
    return next(check for check in joint_model_checks(make, known) if check.__name__ == name)


def test_a_known_failure_must_fail() -> None:
    chosen("check_state", type("Forgetful", (MUTANTS[-1],), {}), check_state="it keeps no covariance")()
    message = "Expected check_state to fail for Sound, because it was never mended, but it passed. Remove it"
    with pytest.raises(AssertionError, match=message):
        chosen("check_state", Sound, check_state="it was never mended.")()


def test_a_known_failure_of_no_check_is_refused() -> None:
    with pytest.raises(InputError, match=r"among the checks of KernelJointModel.*got \['check_dense_formula'\]"):
        joint_model_checks(KernelJointModel, {"check_dense_formula": "not asked"})


def test_only_joint_models_are_checked() -> None:
    with pytest.raises(InputError, match=r"Expected make\(\) as AbstractJointModel, got dict"):
        joint_model_checks(dict)  # pyright: ignore[reportArgumentType]


def test_checks_run_alone_and_in_any_order() -> None:
    for check in reversed(joint_model_checks(Sound)):
        check()
    for name in ("check_units", "check_missing", "check_batch_is_loop"):
        chosen(name, Sound)()


def test_fits_are_shared() -> None:
    fits: list[int] = []

    class Counted(Sound):
        def fit(self, weights: Any, *args: Any, **kwargs: Any) -> Any:
            fits.append(len(next(iter(weights.values()), [])))
            return super().fit(weights, *args, **kwargs)

    for check in joint_model_checks(Counted):
        if "state" not in check.__name__:
            check()
    assert fits.count(600) <= 3 and len(fits) <= 45


class Jittered(Sound):
    def posterior(self, *args: Any, **kwargs: Any) -> Posterior:
        warnings.warn("Added 1e-07 of its diagonal to covariance.", NumericalWarning, stacklevel=2)
        return super().posterior(*args, **kwargs)


def test_corrections_of_round_off_fail_whatever_filter_is_set() -> None:
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        with pytest.raises(
            AssertionError, match=r"got NumericalWarning: Added 1e-07 .*; call the model as check_prior"
        ):
            chosen("check_prior", Jittered)()


class NoPosterior(AbstractJointModel):
    def fit(self, *args: Any, **kwargs: Any) -> Any:
        return self


def test_a_class_that_lacks_a_method_names_it() -> None:
    with pytest.raises(TypeError, match="abstract class NoPosterior .*abstract method '?posterior"):
        joint_model_checks(NoPosterior)  # pyright: ignore[reportArgumentType]


def test_the_world_is_what_it_says() -> None:
    world = World.default()
    rows = world.rows(40000, seed=3)
    off = (rows.mean(0) - world.truth.mean) / world.scale
    assert float(off.abs().max()) < 4.5 / 40000**0.5
    scales = world.scale[:, None] * world.scale
    assert float(((rows.mT.cov() - world.truth.covariance) / scales).abs().max()) < 0.03
    assert float((world.truth.mean / world.scale).abs().min()) > 0.1
    assert float(world.scale.max() / world.scale.min()) > 300
    assert torch.equal(World.default().truth.mean, world.truth.mean)

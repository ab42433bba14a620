"""What `fit` takes, what it refuses, and what calling a model leaves as it was."""

from __future__ import annotations

import random
from collections.abc import Callable

import numpy as np
import torch

from eaip_prob.errors import InputError, NotFittedError
from eaip_prob.observation import LinearObservation
from eaip_prob.testing.subject import NUM_FEW, NUM_SOME, Subject, refused, require_close

_MOST_ROUNDS = 20
_SEED_OF_NOBODY = 730241


def check_fit_is_pure(subject: Subject) -> None:
    """`fit` returns a fitted model of the same class, and changes neither the model it is called on nor its arguments.

    The model it is called on is fitted again, to other demonstrations, as if it never had been.
    """
    model, weights, groups = subject.make(), subject.weights(NUM_SOME), subject.groups(NUM_SOME)
    grams = {"human": torch.eye(5, dtype=torch.float64)}
    masks = {"environment": torch.ones(NUM_SOME, 2, dtype=torch.bool)}
    before = [{name: part.clone() for name, part in given.items()} for given in (weights, grams, masks)]
    fitted = model.fit(weights, masks, groups, grams=grams)
    if type(fitted) is not type(model) or fitted is model:
        came = "the model itself" if fitted is model else type(fitted).__name__
        raise AssertionError(f"{came} from fit; return dataclasses.replace(self, ...)")
    for given, kept in zip((weights, grams, masks), before, strict=True):
        if given.keys() != kept.keys() or not all(torch.equal(given[name], kept[name]) for name in kept):
            raise AssertionError("changed arguments; clone before writing")
    if groups != subject.groups(NUM_SOME):
        raise AssertionError("changed groups; copy them before writing")
    if (came := refused(lambda: model.posterior(()), NotFittedError)) is not None:
        raise AssertionError(f"{came} from the model that fit was called on; keep what was learnt in a new model only")
    again = model.fit(subject.weights(NUM_FEW), groups=subject.groups(NUM_FEW))
    subject.require_same(
        again.posterior(()), subject.fitted_to_few.posterior(()), "a second fit", "start every fit anew"
    )


def check_posterior_is_pure(subject: Subject) -> None:
    """`posterior` changes neither the model nor the observations: the same question has the same answer."""
    seen = [subject.world.seen(["human"], (2, 3)), subject.world.seen(["environment"], (3,), 2)]
    given = [part for one in seen for part in (*one.matrices.values(), one.offset, one.value, one.noise)]
    before = [part.clone() for part in given]
    first = subject.fitted.posterior(seen)
    subject.fitted.posterior([subject.world.seen(["robot"], (1,), seed=7)])
    if not all(torch.equal(one, other) for one, other in zip(given, before, strict=True)):
        raise AssertionError("changed observations; clone before writing")
    subject.require_same(
        subject.fitted.posterior(seen), first, "a second answer", "keep nothing of an observation in the model"
    )


def check_not_fitted(subject: Subject) -> None:
    """Before `fit`, `posterior`, `prior` and `state` raise NotFittedError."""
    model = subject.make()
    calls = {"posterior": lambda: model.posterior(()), "prior": lambda: model.prior, "state": model.state}
    for name, call in calls.items():
        if (came := refused(call, NotFittedError)) is not None:
            raise AssertionError(f"{came} from {name}; raise NotFittedError while nothing was learnt")


def check_bad_demonstrations(subject: Subject) -> None:
    """`fit` refuses with an InputError what it cannot learn from."""
    weights, model = subject.weights(NUM_SOME), subject.make()
    human = weights["human"]
    nan, infinite = human.clone(), human.clone()
    nan[3, 1], infinite[2, 0] = torch.nan, torch.inf
    wrong_gram = {"human": torch.eye(3, dtype=torch.float64)}
    cases: dict[str, Callable[[], object]] = {
        "blocks of different length": lambda: model.fit({**weights, "human": human[:-1]}),
        "NaN": lambda: model.fit({**weights, "human": nan}),
        "infinity": lambda: model.fit({**weights, "human": infinite}),
        "no block": lambda: model.fit({}),
        "no demonstration": lambda: model.fit({name: part[:0] for name, part in weights.items()}),
        "one demonstration": lambda: model.fit({name: part[:1] for name, part in weights.items()}),
        "weights without a row axis": lambda: model.fit({name: part[0] for name, part in weights.items()}),
        "an unknown target": lambda: model.fit(weights, target="nobody"),
        "too few groups": lambda: model.fit(weights, groups=["a", "b"]),
        "a Gram matrix of another size": lambda: model.fit(weights, grams=wrong_gram),
        "a mask of an unknown block": lambda: model.fit(weights, {"nobody": human > -torch.inf}),
        "a mask of another shape": lambda: model.fit(weights, {"human": human[:, :2] > -torch.inf}),
    }
    _require_refused(cases, "let eaip_prob.models.WeightTable.of(...) check what fit is given")


def check_bad_observations(subject: Subject) -> None:
    """`posterior` refuses with an InputError an observation that does not fit the blocks, and an unknown block."""
    one = torch.ones(1, dtype=torch.float64)
    unknown = LinearObservation({"nobody": torch.ones(1, 5)}, one, one, one)
    wide = LinearObservation({"human": torch.ones(1, 6)}, one, one, one)
    cases: dict[str, Callable[[], object]] = {
        "an observation of an unknown block": lambda: subject.fitted.posterior([unknown]),
        "an observation with 6 columns for 5 weights": lambda: subject.fitted.posterior([wide]),
        "an unknown block to keep": lambda: subject.fitted.posterior((), keep=("nobody",)),
    }
    _require_refused(cases, "let BlockGaussian.update, or eaip_prob.models.conditioned, check what it is given")


def _require_refused(cases: dict[str, Callable[[], object]], advice: str) -> None:
    for case, call in cases.items():
        if (came := refused(call, InputError)) is not None:
            raise AssertionError(f"{came} for {case}; {advice}")


def check_float32(subject: Subject) -> None:
    """Weights in float32 are taken as float64, or refused with an InputError."""
    single = {name: part.float() for name, part in subject.weights(NUM_SOME).items()}
    try:
        came = subject.make().fit(single, groups=subject.groups(NUM_SOME)).prior
    except InputError:
        return
    if came.mean.dtype != torch.float64:
        raise AssertionError(f"a prior in {came.mean.dtype}; convert the weights first")
    expected, scale = subject.fitted.prior, subject.scale_of(came)
    require_close(came.mean / scale, expected.mean / scale, "another mean", "convert the weights first", 1e-4)
    scale = scale[:, None] * scale
    advice = "convert the weights before anything is computed with them"
    require_close(came.covariance / scale, expected.covariance / scale, "another covariance", advice, 1e-3)


def check_globals(subject: Subject) -> None:
    """Fitting and asking leave the global random states, the default dtype and the number of threads alone."""
    rng, dtype = torch.get_rng_state(), torch.get_default_dtype()
    try:
        torch.manual_seed(_SEED_OF_NOBODY)  # or a model that sets its own seed would leave it as the last fit did
        before = _globals()
        subject.fit(NUM_SOME).posterior([subject.world.seen(["human"])])
        changed = [name for name, value in _globals().items() if value != before[name]]
    finally:
        torch.set_rng_state(rng)
        torch.set_default_dtype(dtype)
    if changed:
        raise AssertionError(f"a change of {' and '.join(changed)}; draw from a torch.Generator that fit makes")


def _globals() -> dict[str, object]:
    return {
        "torch's random state": torch.get_rng_state().numpy().tobytes(),
        "numpy's random state": str(np.random.get_state()),
        "Python's random state": random.getstate(),
        "torch's default dtype": torch.get_default_dtype(),
        "torch's number of threads": torch.get_num_threads(),
    }


def check_candidates(subject: Subject) -> None:
    """`candidates` are unfitted models of the same class, and come to an end when one is chosen again and again."""
    model = subject.make()
    for _ in range(_MOST_ROUNDS):
        among = model.candidates()
        if not isinstance(among, tuple) or not among:
            raise AssertionError(f"{among!r} from candidates; return (self,) where nothing is open")
        for one in among:
            if type(one) is not type(model):
                raise AssertionError(f"a {type(one).__name__} among the candidates; return models of the same class")
            if refused(lambda one=one: one.posterior(()), NotFittedError) is not None:
                raise AssertionError("a fitted candidate; return models that are still to be fitted")
        model = among[len(among) // 2]
        if len(among) == 1:
            model.fit(subject.weights(NUM_FEW), groups=subject.groups(NUM_FEW)).posterior(())
            return
    raise AssertionError(f"candidates still open after {_MOST_ROUNDS} rounds; close what a candidate has chosen")

"""Units, order, definiteness, and what a file keeps of a model."""

from __future__ import annotations

import dataclasses
import io

import torch

from eaip_prob.errors import InputError
from eaip_prob.gaussian import BlockGaussian
from eaip_prob.models import AbstractJointModel
from eaip_prob.observation import LinearObservation
from eaip_prob.testing.subject import NUM_FEW, NUM_SOME, Subject, refused
from eaip_prob.testing.world import draws

_LEAST_EIGENVALUE = 1e-9  # of a covariance in the world's standard deviations; round-off is 1e-15
_UNITS = (1e3, 1.0, 1e-3, 10.0, 0.1, 1.0, 1e3, 1e-3, 1e-2, 1e2)


def _covariances(subject: Subject, model: AbstractJointModel) -> dict[str, torch.Tensor]:
    """Those of the prior and of a batch of posteriors, in the world's standard deviations."""
    seen = subject.world.seen(["human"], (2, 3), 4, 6)
    scene = subject.world.seen(["environment"], (3,), 2, 3)
    beliefs = {"prior": model.prior, "posterior": model.posterior([seen, scene]).components}
    scales = {what: subject.scale_of(belief) for what, belief in beliefs.items()}
    return {what: beliefs[what].covariance / (scale[:, None] * scale) for what, scale in scales.items()}


def _require_definite(covariances: dict[str, torch.Tensor]) -> None:
    for what, covariance in covariances.items():
        least = float(torch.linalg.eigvalsh(covariance).min())
        if not least > _LEAST_EIGENVALUE:
            raise AssertionError(
                f"a covariance of the {what} with the eigenvalue {least:.2g} in standard deviations; regularise what "
                "is learnt and never subtract without a solve"
            )


def check_definite(subject: Subject) -> None:
    """Covariances are symmetric and positive definite."""
    covariances = _covariances(subject, subject.fitted)
    for what, covariance in covariances.items():
        if not bool(((covariance - covariance.mT).abs() <= 1e-12 * covariance.abs().amax()).all()):
            raise AssertionError(f"an asymmetric covariance of the {what}; return eaip_prob.linalg.symmetrised of it")
    _require_definite(covariances)


def check_few_demonstrations(subject: Subject) -> None:
    """Covariances are positive definite with fewer demonstrations than weights, too."""
    _require_definite(_covariances(subject, subject.fitted_to_few))


def check_units(subject: Subject) -> None:
    """Other units and another origin of any weight give the same answer in those units, with few demonstrations, too.

    A weight in millimetres instead of metres is the same weight: shrink to the diagonal, not to the identity.
    """
    layout = subject.world.truth.layout
    factor, shift = torch.tensor(_UNITS, dtype=torch.float64), 3.0 * subject.world.scale * draws(12, layout.total)
    factors, shifts = (subject.world.blocks(part) for part in (factor, shift))
    seen = [subject.world.seen(["human"], (4,)), subject.world.seen(["environment"], (1,), 2)]
    for num, model in ((NUM_SOME, subject.fitted), (NUM_FEW, subject.fitted_to_few)):
        weights = {name: (part + shifts[name]) * factors[name] for name, part in subject.weights(num).items()}
        other = subject.make().fit(weights, groups=subject.groups(num))
        came = other.posterior([_in_units(one, factors, shifts) for one in seen]).moment_matched()
        back = 1.0 / factor
        came = BlockGaussian(came.mean * back - shift, came.covariance * (back[:, None] * back), came.layout)
        expected = model.posterior(seen).moment_matched()
        subject.require_same(came, expected, f"with {num} demonstrations a belief", "regularise by shares of variances")


def _in_units(
    seen: LinearObservation, factors: dict[str, torch.Tensor], shifts: dict[str, torch.Tensor]
) -> LinearObservation:
    """The observation of w that reads u = (w + shift) factor."""
    matrices = {block: matrix / factors[block] for block, matrix in seen.matrices.items()}
    moved = sum((matrix @ shifts[block] for block, matrix in seen.matrices.items()), torch.zeros_like(seen.offset))
    return dataclasses.replace(seen, matrices=matrices, offset=seen.offset - moved)


def check_order_of_demonstrations(subject: Subject) -> None:
    """The order of the demonstrations does not matter."""
    for num, model in ((NUM_SOME, subject.fitted), (NUM_FEW, subject.fitted_to_few)):
        order, groups = draws(13, num).argsort(), subject.groups(num)
        weights = {name: part[order] for name, part in subject.weights(num).items()}
        came = subject.make().fit(weights, groups=[groups[place] for place in order.tolist()])
        what, advice = f"with {num} demonstrations a belief", "use every demonstration alike"
        subject.require_same(came.posterior(()), model.posterior(()), what, advice)


def check_order_of_blocks(subject: Subject) -> None:
    """The order of the blocks does not matter."""
    weights = dict(reversed(subject.weights(NUM_SOME).items()))
    other = subject.make().fit(weights, groups=subject.groups(NUM_SOME))
    seen = [subject.world.seen(["human"], (4,)), subject.world.seen(["environment"], (1,), 2)]
    came, expected = (model.posterior(seen, keep=("robot",)) for model in (other, subject.fitted))
    subject.require_same(came, expected, "a belief", "ask the layout where a block lies")


def check_absent_blocks(subject: Subject) -> None:
    """The environment, or an agent, may be absent; the target may be any block."""
    for blocks, target in ((("human", "robot"), "robot"), (("human", "environment"), "human"), (("human",), "human")):
        weights = {name: part for name, part in subject.weights(NUM_SOME).items() if name in blocks}
        model = subject.make().fit(weights, groups=subject.groups(NUM_SOME), target=target)
        came = model.posterior([subject.world.seen(["human"])]).moment_matched()
        if set(came.layout.names) != set(blocks):
            raise AssertionError(f"the blocks {came.layout.names} of {blocks}; learn the blocks that are given")
        if not bool(torch.isfinite(came.mean).all() and torch.isfinite(came.covariance).all()):
            raise AssertionError(f"NaN or infinity with the blocks {blocks}; learn the blocks that are given")


def check_identity_grams(subject: Subject) -> None:
    """Gram matrices of the identity are what is taken where none are given."""
    sizes = subject.world.truth.layout.sizes
    grams = {name: torch.eye(size, dtype=torch.float64) for name, size in sizes.items()}
    came = subject.make().fit(subject.weights(NUM_SOME), groups=subject.groups(NUM_SOME), grams=grams)
    advice = "regularise in WeightTable.coordinates and transform back"
    subject.require_same(came.posterior(()), subject.fitted.posterior(()), "a belief", advice)


def check_deterministic(subject: Subject) -> None:
    """Two fits to the same demonstrations are equal to the last digit."""
    came, expected = subject.fit(NUM_SOME).posterior(()), subject.fitted.posterior(())
    one, other = came.components, expected.components
    if not (torch.equal(one.mean, other.mean) and torch.equal(one.covariance, other.covariance)):
        raise AssertionError("different ones; draw from a torch.Generator with a seed that is a field of the model")


def check_state(subject: Subject) -> None:
    """A model that was saved and read again, without pickle, gives the same answers to the last digit."""
    seen = [subject.world.seen(["human"], (2, 3)), subject.world.seen(["environment"], (3,), 2)]
    before = subject.fitted.posterior(seen)
    file = io.BytesIO()
    torch.save(subject.fitted.state(), file)
    file.seek(0)
    model = type(subject.fitted).from_state(torch.load(file, weights_only=True))
    if type(model) is not type(subject.fitted):
        raise AssertionError(f"a {type(model).__name__}; leave state and from_state to the base class")
    for came, what in ((model.posterior(seen), "the restored model"), (subject.fitted.posterior(seen), "saving")):
        for name in ("mean", "covariance"):
            if not torch.equal(getattr(came.components, name), getattr(before.components, name)):
                raise AssertionError(f"another {name} after {what}; make everything that is fitted a field")
    if (came := refused(lambda: type(subject.fitted).from_state({}), InputError)) is not None:
        raise AssertionError(f"{came} for an empty state; leave from_state to the base class")

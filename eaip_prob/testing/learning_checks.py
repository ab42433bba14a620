"""Whether a model learns: against the truth of the world, with tolerances that the number of draws justifies.

With N = 600 demonstrations the mean of three target weights given eight others is learnt up to sqrt(11 / 600) = 0.14 of
its standard deviation.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import torch
from torch import Tensor

from eaip_prob.errors import InputError
from eaip_prob.linalg import safe_cholesky, whitened
from eaip_prob.models import AbstractJointModel
from eaip_prob.observation import LinearObservation
from eaip_prob.testing.subject import NUM_MANY, NUM_SOME, Subject, refused

_NUM_HELD_OUT = 400
_MOST_ERROR = 0.2
_QUANTILE = 1.6448536269514722  # of a standard normal, at 95 %
_NOISE = 0.3  # of what is observed, in standard deviations of each weight
_HIDDEN_SHARE = 0.3


def _held_out(subject: Subject) -> Tensor:
    return subject.world.rows(_NUM_HELD_OUT, seed=999)


def _observed(subject: Subject, rows: Tensor, blocks: Sequence[str]) -> list[LinearObservation]:
    """Each block of the rows with noise, one member of the batch (num, 1) a row."""
    layout, seen = subject.world.truth.layout, []
    for seed, block in enumerate(blocks):
        columns = layout.slice(block)
        noise = _NOISE * subject.world.scale[columns] * _draws_like(rows[:, columns], 31 + seed)
        seen.append(subject.world.whole(block, (rows[:, columns] + noise)[:, None], _NOISE))
    return seen


def _draws_like(rows: Tensor, seed: int) -> Tensor:
    return torch.randn(rows.shape, generator=torch.Generator().manual_seed(seed), dtype=torch.float64)


def _distance(subject: Subject, model: AbstractJointModel, other: AbstractJointModel | None, *blocks: str) -> float:
    """Root mean square distance of two predictive means of the robot, in the truth's predictive deviations.

    Args:
        subject: whose world it is.
        model: predicts.
        other: predicts; None stands for the truth.
        blocks: are observed.
    """
    seen = _observed(subject, _held_out(subject), blocks)
    truth = subject.world.truth.condition(seen, keep=["robot"])
    expected = truth.mean[..., 0, :] if other is None else other.posterior(seen).mean("robot")
    off = model.posterior(seen).mean("robot") - expected
    factor = safe_cholesky(truth.covariance.reshape(-1, *truth.covariance.shape[-2:])[0])  # the same for every motion
    return float(whitened(factor, off).square().mean().sqrt())


def check_learns_the_mean(subject: Subject) -> None:
    """With plenty of demonstrations the target's mean given the human approaches the truth."""
    error = _distance(subject, subject.fitted_to_many, None, "human")
    if not error < _MOST_ERROR:
        raise AssertionError(
            f"an error of {error:.2g} standard deviations, at most {_MOST_ERROR}; compare with GaussianJointModel"
        )


def check_coverage(subject: Subject) -> None:
    """Intervals of 90 % hold 90 % of held-out values, with plenty of demonstrations."""
    held_out = _held_out(subject)
    posterior = subject.fitted_to_many.posterior(_observed(subject, held_out, ["human"]))
    deviation = posterior.covariance("robot").diagonal(dim1=-2, dim2=-1).sqrt()
    truth = held_out[:, subject.world.truth.layout.slice("robot")]
    inside = ((truth - posterior.mean("robot")).abs() <= _QUANTILE * deviation).to(torch.float64).mean(0)
    # Four standard errors of a share of 400 draws, and 2 % for what 600 demonstrations leave open.
    tolerance = 4.0 * math.sqrt(0.9 * 0.1 / _NUM_HELD_OUT) + 0.02
    worst = float(inside[(inside - 0.9).abs().argmax()])
    if not abs(worst - 0.9) <= tolerance:
        kind = "over-confident" if worst < 0.9 else "under-confident"
        raise AssertionError(f"{worst:.3f}, {tolerance:.3f} allowed; mend the covariance, which is {kind}")


def check_scene_helps(subject: Subject) -> None:
    """A scene that tells of the robot makes held-out motions of the robot more likely."""
    held_out = _held_out(subject)
    value = held_out[:, subject.world.truth.layout.slice("robot")]
    human, scene = _observed(subject, held_out, ["human", "environment"])
    model = subject.fitted_to_many
    without, with_scene = (model.posterior(seen, keep=("robot",)).log_prob(value) for seen in ([human], [human, scene]))
    gain = with_scene - without
    error = float(gain.std()) / math.sqrt(_NUM_HELD_OUT)
    if not float(gain.mean()) > 4.0 * error:
        raise AssertionError(
            f"{float(gain.mean()):.2g} nats more with the scene, {error:.2g} a standard error; condition on the block "
            "environment as on any other"
        )


def check_evidence(subject: Subject) -> None:
    """The log evidence prefers the hypothesis that is true."""
    held_out = _held_out(subject)
    (right,) = _observed(subject, held_out, ["human"])
    wrong = right.value.flip(-1) * (subject.world.scale[:5] / subject.world.scale[:5].flip(0))
    both = subject.world.whole("human", torch.cat([right.value, wrong], -2), _NOISE)
    posterior = subject.fitted_to_many.posterior([both], torch.zeros(2, dtype=torch.float64))
    share = float((posterior.weight[:, 0] > 0.5).to(torch.float64).mean())
    if not share > 0.9:
        raise AssertionError(
            f"it in {share:.2f} of the motions, 0.9 expected; return the log density of what was observed"
        )


def check_missing(subject: Subject) -> None:
    """Weights that were not observed are never read, and 30 % of the scene's missing change little.

    Asked only of models that declare `supports_missing`. A masked entry may hold anything, NaN included.
    """
    weights, groups = subject.weights(NUM_MANY), subject.groups(NUM_MANY)
    mask = torch.rand(NUM_MANY, 2, generator=torch.Generator().manual_seed(41)) > _HIDDEN_SHARE
    fits = []
    for filler in (torch.nan, 1e6):
        hidden = {**weights, "environment": torch.where(mask, weights["environment"], filler)}
        fits.append(subject.make().fit(hidden, {"environment": mask}, groups))
    one, other = (model.posterior(()) for model in fits)
    subject.require_same(one, other, "with other masked values another belief", "never read a masked entry")
    away = _distance(subject, fits[0], subject.fitted_to_many, "human", "environment")
    if not away < _MOST_ERROR:
        raise AssertionError(f"means {away:.2g} standard deviations away, {_MOST_ERROR} allowed; do not fill zeros")


def check_missing_refused(subject: Subject) -> None:
    """A mask that hides anything is refused with an InputError; one that hides nothing is taken.

    Asked only of models that do not declare `supports_missing`.
    """
    weights = subject.weights(NUM_SOME)
    mask = torch.ones_like(weights["environment"], dtype=torch.bool)
    subject.make().fit(weights, {"environment": mask})
    hidden = mask.clone()
    hidden[3, 1] = False
    if (came := refused(lambda: subject.make().fit(weights, {"environment": hidden}), InputError)) is not None:
        raise AssertionError(f"{came}; raise an InputError that says to leave the demonstration out")

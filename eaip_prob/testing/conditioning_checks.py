"""What observations do to the belief of a fitted model."""

from __future__ import annotations

import dataclasses

import numpy as np
import torch
from torch import Tensor

from eaip_prob.observation import LinearObservation
from eaip_prob.testing.subject import Subject, require_close
from eaip_prob.testing.world import dense_posterior, draws, member

_BLOCKS = ("human", "robot", "environment")


def check_prior(subject: Subject) -> None:
    """Without observations the posterior is the prior, and its log evidence is zero."""
    posterior = subject.fitted.posterior(())
    subject.require_same(posterior, subject.fitted.prior, "a posterior of nothing", "leave prior to the base class")
    zero = torch.zeros((), dtype=torch.float64)
    require_close(posterior.log_evidence, zero, "a log evidence of nothing", "return log 1 = 0 for no observations")


def _weighted(*batch: int) -> Tensor:
    return torch.log_softmax(draws(9, *batch), -1)


def check_shapes(subject: Subject) -> None:
    """The answer has the batch axes of the observations, and the blocks of `keep` in that order."""
    for batch in ((), (2, 3)):
        for keep in (None, ("robot",), ("robot", "human")):
            seen = [subject.world.seen(["human"], (*batch, 4)), subject.world.seen(["environment"], (*batch, 1), 2)]
            came = subject.fitted.posterior(seen, _weighted(*batch, 4), keep)
            blocks = came.components.layout.names
            if set(blocks) != set(keep or _BLOCKS) or (keep and blocks != keep):
                raise AssertionError(f"the blocks {blocks} for keep={keep}; answer for the blocks asked for")
            total = came.components.layout.total
            found = came.log_evidence.shape, came.log_weight.shape[:-1], came.components.mean.shape
            if found != (batch, batch, (*came.log_weight.shape, total)):
                raise AssertionError(
                    f"shapes {[tuple(part) for part in found]} of evidence, weights and mean for the batch {batch}; "
                    "keep the leading axes, then that of the components"
                )
            if keep is not None:
                whole = subject.fitted.posterior(seen, _weighted(*batch, 4)).moment_matched().marginal(keep)
                subject.require_same(came.moment_matched(), whole, f"for keep={keep} beliefs", "marginalise only")


def check_batch_is_loop(subject: Subject) -> None:
    """A batch of observations is answered as each of its members alone."""
    human, scene = subject.world.seen(["human"], (2, 3, 1)), subject.world.seen(["environment"], (2, 1, 1), 2, 3)
    together = subject.fitted.posterior([human, scene])
    for i, j in np.ndindex(2, 3):
        one = subject.fitted.posterior([member(human, (i, j)), member(scene, (i, 0))])
        whole = together.moment_matched()
        part = dataclasses.replace(whole, mean=whole.mean[i, j], covariance=whole.covariance[i, j])
        advice = "keep leading axes apart"
        subject.require_same(part, one.moment_matched(), f"for member {(i, j)} a belief", advice)
        require_close(together.log_evidence[i, j], one.log_evidence, f"for member {(i, j)} an evidence", advice)


def check_order_of_observations(subject: Subject) -> None:
    """The order of the observations does not matter."""
    world = subject.world
    seen = [world.seen(["human"]), world.seen(["environment"], (), 2, 3), world.seen(["robot", "human"], (), 1, 5)]
    expected = subject.fitted.posterior(seen)
    for order in ((2, 0, 1), (1, 2, 0)):
        came = subject.fitted.posterior([seen[place] for place in order])
        subject.require_same(came, expected, f"for the order {order} a belief", "use every observation alike")


def check_hypotheses(subject: Subject) -> None:
    """Hypotheses are weighed by their prior weight times their evidence, and answered as each alone."""
    human, scene = subject.world.seen(["human"], (4,)), subject.world.seen(["environment"], (1,), 2)
    log_weight = 0.3 + _weighted(4)  # weights that do not add up to 1 move the evidence
    came = subject.fitted.posterior([human, scene], log_weight)
    each = [subject.fitted.posterior([member(human, (j,)), member(scene, (0,))]) for j in range(4)]
    log_joint = log_weight + torch.stack([one.log_evidence for one in each])
    total = torch.logsumexp(log_joint, -1)
    advice = "add log_weight once to the evidence of each hypothesis and normalise"
    require_close(came.log_evidence, total, "a log evidence that is not the logarithm of their sum", advice)
    require_close(came.weight.sum(), torch.ones_like(total), "weights of another sum than 1", advice)
    weight = (log_joint - total).exp()
    means = torch.stack([one.mean("robot") for one in each])
    scale = subject.scale_of(came.components.marginal(["robot"]))
    mean = (weight[:, None] * means).sum(0)
    require_close(came.mean("robot") / scale, mean / scale, "another mean over the hypotheses", advice)
    within = torch.stack([one.covariance("robot") for one in each])
    between = (means - mean)[..., :, None] * (means - mean)[..., None, :]
    covariance, scales = (weight[:, None, None] * (within + between)).sum(0), scale[:, None] * scale
    require_close(came.covariance("robot") / scales, covariance / scales, "another covariance over them", advice)


def check_masked_rows(subject: Subject) -> None:
    """A row that was not observed changes nothing, whatever stands in it."""
    for block in ("human", "environment"):
        seen = subject.world.seen([block], (), 3, 2)
        mask = torch.tensor([True, False, True])
        offset, value, noise = (torch.where(mask, part, torch.nan) for part in (seen.offset, seen.value, seen.noise))
        kept = torch.tensor([0, 2])
        rest = LinearObservation(
            {block: seen.matrices[block][kept]}, seen.offset[kept], seen.value[kept], seen.noise[kept]
        )
        masked = LinearObservation(seen.matrices, offset, value, noise, mask)
        advice = "read observations through information() or rows(), which leave masked rows out"
        expected = subject.fitted.posterior([rest])
        subject.require_same(subject.fitted.posterior([masked]), expected, f"a changed belief ({block})", advice)
        nothing = LinearObservation(seen.matrices, offset, value, noise, mask & False)
        subject.require_same(
            subject.fitted.posterior([nothing]).moment_matched(), subject.fitted.prior, f"no prior ({block})", advice
        )


def check_vague_observation(subject: Subject) -> None:
    """An observation whose noise grows without bound leaves the prior."""
    human = subject.world.whole("human", subject.world.rows(1, 8)[0, :5], noise=1e6)
    scene = subject.world.whole("environment", subject.world.rows(1, 8)[0, 8:], noise=1e6)
    came = subject.fitted.posterior([human, scene]).moment_matched()
    subject.require_same(came, subject.fitted.prior, "another belief", "weigh an observation by its noise")


def check_exact_observation(subject: Subject) -> None:
    """What is observed without noise is believed as observed, with no variance left."""
    value = subject.world.rows(1, 8)[0, :5]
    came = subject.fitted.posterior([subject.world.whole("human", value, noise=0.0)])
    scale = subject.world.scale[:5]
    advice = "condition on rows without noise as BlockGaussian.update does"
    require_close(came.mean("human") / scale, value / scale, "another mean of what was observed", advice)
    left = came.covariance("human").diagonal() / scale.square()
    require_close(left, torch.zeros_like(left), "some variance of what was observed", advice)


def check_dense_formula(subject: Subject) -> None:
    """The posterior is the prior conditioned as the dense formula says: mean, covariance and log evidence.

    Asked only of models that declare `conditions_prior`.
    """
    world, prior = subject.world, subject.fitted.prior
    sets = (
        [world.seen(["human"]), world.seen(["environment"], (), 2, 3)],
        [world.seen(["environment"], (), 4, 5, correlated=True)],
        [world.seen(["robot", "human"], (), 2, 7), world.seen(["human"], (), 9, 9, noise=0.05)],
    )
    advice = "return eaip_prob.models.conditioned(self.prior, observations, log_weight, keep)"
    for seen in sets:
        mean, covariance, log_evidence = dense_posterior(prior, seen)
        came = subject.fitted.posterior(seen)
        belief = dataclasses.replace(prior, mean=torch.from_numpy(mean), covariance=torch.from_numpy(covariance))
        subject.require_same(came.moment_matched(), belief, "a belief", advice)
        expected = torch.tensor(log_evidence, dtype=torch.float64)
        require_close(came.log_evidence, expected, "another log evidence than the formula's", advice)


def check_one_after_the_other(subject: Subject) -> None:
    """Two observations at once say what one says after the other.

    Asked only of models that declare `conditions_prior`.
    """
    first, second = subject.world.seen(["environment"], (1,), 2), subject.world.seen(["human"], (4,), 3, 5)
    together = subject.fitted.posterior([first, second], _weighted(4))
    later = subject.fitted.posterior([first]).condition([second], _weighted(4))
    subject.require_same(together, later, "at once a belief", "give every observation its part")


def check_variance_never_grows(subject: Subject) -> None:
    """No observation makes any combination of weights more uncertain, however often it is repeated.

    Asked only of models that declare `conditions_prior`.
    """
    prior = subject.fitted.prior
    scale = subject.scale_of(prior)
    scales = scale[:, None] * scale
    seen = subject.world.seen(["human", "environment"], (), 3, 11, noise=0.01)
    exact = subject.world.whole("human", subject.world.rows(1, 8)[0, :5], noise=0.0)
    masked = dataclasses.replace(seen, mask=torch.tensor([True, False, True]))
    for observations in ([seen], [seen, seen], [exact], [masked]):
        less = prior.covariance - subject.fitted.posterior(observations).moment_matched().covariance
        least = float(torch.linalg.eigvalsh(less / scales).min())
        if not least > -1e-7:
            raise AssertionError(f"a growth of the variance by {-least:.2g}; select the observed rows before the gain")

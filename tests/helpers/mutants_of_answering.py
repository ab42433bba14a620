"""Planted bugs in the evidence, the shape and the covariance of an answer."""

from __future__ import annotations

import dataclasses
from dataclasses import replace
from typing import Any, ClassVar

import torch
from sound_model import Sound
from torch import Tensor

from eaip_prob.models import Posterior, conditioned


class IgnoresLogWeight(Sound):
    """Forgets the prior weight of the hypotheses."""

    def posterior(self, observations: Any, log_weight: Any = None, keep: Any = None) -> Posterior:
        return super().posterior(observations, None if log_weight is None else 0.0 * log_weight, keep)


class LogWeightTwice(Sound):
    """Adds the prior weight of the hypotheses twice."""

    def posterior(self, observations: Any, log_weight: Any = None, keep: Any = None) -> Posterior:
        return super().posterior(observations, None if log_weight is None else 2.0 * log_weight, keep)


class OtherEvidence(Sound):
    """Helper: the same with another evidence of each hypothesis."""

    def evidence(self, log_evidence: Tensor, observations: Any) -> Tensor:
        return log_evidence

    def posterior(self, observations: Any, log_weight: Any = None, keep: Any = None) -> Posterior:
        found = super().posterior(observations, log_weight, keep)
        weight = torch.zeros(1, dtype=torch.float64) if log_weight is None else log_weight
        log_joint = weight + self.evidence(self.prior.log_evidence(observations), observations)
        log_joint = log_joint.expand(found.log_weight.shape)
        total = torch.logsumexp(log_joint, -1)
        return Posterior(found.components, log_joint - total[..., None], total)


class UphillEvidence(OtherEvidence):
    """Drops the minus of the evidence."""

    def evidence(self, log_evidence: Tensor, observations: Any) -> Tensor:
        return -log_evidence


class ForgotLogDeterminant(OtherEvidence):
    """Leaves the log-determinant out of the evidence."""

    conditions_prior: ClassVar[bool] = True

    def evidence(self, log_evidence: Tensor, observations: Any) -> Tensor:
        for seen in observations:
            mean = {block: self.prior.block_mean(block) for block in seen.blocks}
            design, _, noise = seen.dense().rows(mean)
            covariance = self.prior.marginal(seen.blocks).covariance
            innovation = design @ covariance @ design.mT + (noise if seen.dense().correlated else noise.diag_embed())
            log_evidence = log_evidence + 0.5 * torch.logdet(innovation)
        return log_evidence


class OtherAnswer(Sound):
    """Helper: the same with another covariance of the answer."""

    def covariance_of(self, covariance: Tensor) -> Tensor:
        return covariance

    def posterior(self, observations: Any, log_weight: Any = None, keep: Any = None) -> Posterior:
        found = super().posterior(observations, log_weight, keep)
        if not observations:
            return found
        components = replace(found.components, covariance=self.covariance_of(found.components.covariance.clone()))
        return dataclasses.replace(found, components=components)


class Asymmetric(OtherAnswer):
    """Does not symmetrise what round-off made asymmetric."""

    def covariance_of(self, covariance: Tensor) -> Tensor:
        return covariance * (1.0 + 1e-8 * torch.ones_like(covariance).triu(1))


class SubtractsTooMuch(OtherAnswer):
    """Subtracts the variance of the noise once more from every weight."""

    def covariance_of(self, covariance: Tensor) -> Tensor:
        return (
            covariance - torch.diag_embed(1.2 * covariance.diagonal(dim1=-2, dim2=-1).amin(-1)[..., None])[..., :1, :1]
        )


class ZeroedGain(Sound):
    """Zeroes the gain of rows that were not observed after it was computed with them."""

    conditions_prior: ClassVar[bool] = True

    def posterior(self, observations: Any, log_weight: Any = None, keep: Any = None) -> Posterior:
        prior = self.prior
        if len(observations) != 1 or (mask := observations[0].dense().mask) is None:
            return super().posterior(observations, log_weight, keep)
        seen = observations[0].dense()
        design = torch.zeros(len(mask), prior.layout.total, dtype=torch.float64)
        for block, matrix in seen.matrices.items():
            design[:, prior.layout.slice(block)] = matrix
        noise = torch.diag(seen.noise.nan_to_num(1.0))
        gain = torch.linalg.solve(design @ prior.covariance @ design.mT + noise, design @ prior.covariance).mT
        gain = gain * mask
        mean = prior.mean + gain @ torch.where(mask, seen.value - seen.offset - design @ prior.mean, 0.0)
        belief = replace(prior, mean=mean, covariance=prior.covariance - gain @ design @ prior.covariance)
        found = super().posterior(observations, log_weight, None)
        return conditioned(belief, (), found.log_weight, keep)


class IgnoresKeep(Sound):
    """Answers for all blocks."""

    def posterior(self, observations: Any, log_weight: Any = None, keep: Any = None) -> Posterior:
        return super().posterior(observations, log_weight, None)


class KeepsLayoutOrder(Sound):
    """Answers for the right blocks in the wrong order."""

    def posterior(self, observations: Any, log_weight: Any = None, keep: Any = None) -> Posterior:
        _ = keep and self.prior.layout.select(keep)
        kept = None if keep is None else [name for name in self.prior.layout.names if name in keep]
        return super().posterior(observations, log_weight, kept)


class RemembersTheLast(Sound):
    """Keeps the last observation for the next question."""

    def posterior(self, observations: Any, log_weight: Any = None, keep: Any = None) -> Posterior:
        last = self.__dict__.get("last", ())
        object.__setattr__(self, "last", [seen for seen in observations if seen.blocks == ("robot",)])
        return super().posterior([*observations, *last], log_weight, keep)

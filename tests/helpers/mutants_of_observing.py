"""Planted bugs in how a joint model reads observations; the first line of a docstring is the mistake."""

from __future__ import annotations

from dataclasses import replace
from typing import Any, ClassVar

import torch
from sound_model import Sound, seen_as

from eaip_prob.gaussian import BlockGaussian
from eaip_prob.models import Posterior, conditioned
from eaip_prob.observation import LinearObservation


class OfNothing(Sound):
    """Answers for a model that was never fitted."""

    def posterior(self, *args: Any, **kwargs: Any) -> Posterior:
        if self.joint is None:
            raise AttributeError("'NoneType' object has no attribute 'mean'")
        return super().posterior(*args, **kwargs)


class SavesUnfitted(Sound):
    """Saves a model that was never fitted."""

    def state(self) -> dict[str, Any]:
        return {} if self.joint is None else super().state()


class EvidenceOfNothing(Sound):
    """Counts a constant of the evidence where nothing was observed."""

    def posterior(self, observations: Any, log_weight: Any = None, keep: Any = None) -> Posterior:
        found = super().posterior(observations, log_weight, keep)
        return found if observations else replace(found, log_evidence=found.log_evidence - 0.9189)


class OtherPrior(Sound):
    """Leaves the regularisation out of the prior."""

    @property
    def prior(self) -> BlockGaussian:
        prior = super().prior
        return replace(prior, covariance=0.999 * prior.covariance)

    def posterior(self, observations: Any, log_weight: Any = None, keep: Any = None) -> Posterior:
        return conditioned(super().prior, observations, log_weight, keep)


class OtherObservations(Sound):
    """Helper: the same with other observations."""

    def altered(self, observations: Any) -> Any:
        return observations

    def posterior(self, observations: Any, log_weight: Any = None, keep: Any = None) -> Posterior:
        return super().posterior(self.altered(observations), log_weight, keep)


class IgnoresNoise(OtherObservations):
    """Takes every observation for exact."""

    def altered(self, observations: Any) -> Any:
        return seen_as(observations, lambda seen: replace(seen, noise=1e-4 * seen.noise))


class NoiseFloor(OtherObservations):
    """Adds a little to every noise, so that nothing is ever singular."""

    def altered(self, observations: Any) -> Any:
        def floored(seen: LinearObservation) -> LinearObservation:
            variance = seen.noise.diagonal(dim1=-2, dim2=-1) if seen.correlated else seen.noise
            more = 1e-4 + 0.0 * variance
            return replace(seen, noise=seen.noise + (torch.diag_embed(more) if seen.correlated else more))

        return seen_as(observations, floored)


class NoiseCap(OtherObservations):
    """Caps the noise."""

    def altered(self, observations: Any) -> Any:
        return seen_as(observations, lambda seen: replace(seen, noise=seen.noise.clamp_max(1e4)))


class DropsOffset(OtherObservations):
    """Forgets the offset of an observation."""

    conditions_prior: ClassVar[bool] = True

    def altered(self, observations: Any) -> Any:
        return seen_as(observations, lambda seen: replace(seen, offset=0.0 * seen.offset.nan_to_num()))


class MaskedAsZero(OtherObservations):
    """Takes a row that was not observed for zero."""

    def altered(self, observations: Any) -> Any:
        def unmasked(seen: LinearObservation) -> LinearObservation:
            if seen.mask is None:
                return seen
            noise = seen.noise.nan_to_num(1.0)
            return LinearObservation(seen.matrices, seen.offset.nan_to_num(), seen.value.nan_to_num(), noise)

        return seen_as(observations, unmasked)


class OnlyTheFirst(OtherObservations):
    """Uses the first observation alone."""

    def altered(self, observations: Any) -> Any:
        return observations[:1]


class LaterCountLess(OtherObservations):
    """Discounts every observation after the first."""

    def altered(self, observations: Any) -> Any:
        return [
            replace(seen.dense(), noise=(1.0 + 0.5 * place) * seen.dense().noise)
            for place, seen in enumerate(observations)
        ]


class IgnoresScene(OtherObservations):
    """Leaves the scene out."""

    def altered(self, observations: Any) -> Any:
        return [seen for seen in observations if "environment" not in seen.blocks]


class WritesIntoObservations(OtherObservations):
    """Subtracts the offset in place."""

    def altered(self, observations: Any) -> Any:
        for seen in observations:
            seen.value.sub_(seen.offset)
            seen.offset.zero_()
        return observations


class FirstMember(OtherObservations):
    """Answers every member of a batch as the first."""

    def altered(self, observations: Any) -> Any:
        def first(seen: LinearObservation) -> LinearObservation:
            if seen.value.ndim < 3:
                return seen
            value = seen.value[:1].expand(seen.value.shape)
            return replace(seen, value=value)

        return seen_as(observations, first)


class FlattensWrongly(OtherObservations):
    """Unflattens two batch axes in the wrong order."""

    def altered(self, observations: Any) -> Any:
        def mixed(seen: LinearObservation) -> LinearObservation:
            if seen.value.ndim < 4:
                return seen
            return replace(seen, value=seen.value.mT.reshape(seen.value.shape).roll(1, 0))

        return seen_as(observations, mixed)


class IgnoresCorrelation(OtherObservations):
    """Reads the diagonal of correlated noise alone."""

    conditions_prior: ClassVar[bool] = True

    def altered(self, observations: Any) -> Any:
        def white(seen: LinearObservation) -> LinearObservation:
            if not seen.correlated:
                return seen
            return replace(seen, noise=seen.noise.diagonal(dim1=-2, dim2=-1), correlated=False)

        return seen_as(observations, white)


class UntypedErrors(Sound):
    """Multiplies first and checks later."""

    def posterior(self, observations: Any, *args: Any, **kwargs: Any) -> Posterior:
        for seen in observations:
            for block, matrix in seen.dense().matrices.items():
                if block in self.prior.layout.names:
                    _ = matrix @ self.prior.block_mean(block)
        return super().posterior(observations, *args, **kwargs)

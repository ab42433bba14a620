"""A predicted motion with its uncertainty."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from typing import Self

import torch
from jaxtyping import Float
from torch import Tensor

from eaip_prob.checks import as_float64, check_count, check_finite
from eaip_prob.errors import ShapeError
from eaip_prob.evaluation.uncertainty import mixture_quantile
from eaip_prob.linalg import flat_members, symmetrised
from eaip_prob.models.base import Posterior
from eaip_prob.phase.base import PhaseEstimate
from eaip_prob.primitives.base import AbstractPrimitive, Boundary


def checked_times(time: Float[Tensor, "*#batch times"]) -> Float[Tensor, "*#batch times"]:
    """Times to predict at, of which there must be at least one, all finite."""
    time = as_float64("time", time)
    if time.ndim == 0 or time.shape[-1] == 0:
        raise ShapeError(f"Expected time with shape (*batch, S), S at least 1, got {tuple(time.shape)}.")
    check_finite("time", time, advice="Ask for times in seconds on the clock of what was observed.")
    return time


@dataclass(frozen=True, eq=False)
class Prediction:
    """The target's motion as a mixture of Gaussians over its weights, read at any times.

    Variances hold the uncertainty of the weights and what the primitive cannot represent.

    Args:
        time: (*#batch, S), seconds.
        posterior: over the target's block, J components.
        phase: hypotheses about the phase.
        primitive: of the target.
        block: name of the target.
        names: D signals.
        residual: (D,), variance of what the primitive cannot represent, units squared.
        inflation: (*#batch,), factor on all variances that makes intervals right on held-out groups, and for scenes
            far from those demonstrated.
        boundary: start of the motion, where the primitive needs it.
    """

    time: Float[Tensor, "*#batch times"]
    posterior: Posterior
    phase: PhaseEstimate
    primitive: AbstractPrimitive
    block: str
    names: tuple[str, ...]
    residual: Float[Tensor, "signals"]
    inflation: Float[Tensor, "*#batch"] | float = 1.0
    boundary: Boundary | None = None

    def at(self, time: Float[Tensor, "*#batch times"]) -> Self:
        """The same prediction read at other times, seconds."""
        return replace(self, time=checked_times(time))

    def in_step(self) -> Self:
        """The same motion with all hypotheses on one clock, as a robot takes it that has to be somewhere at each time.

        The phase at a time is the expected one, and each hypothesis is read there. Averaged over time instead, as
        `mean` is, motions that differ in tempo lose height where they turn: the mean of two arches at different times
        is lower than either.

        Example:
            >>> from eaip_prob import InteractionPredictor
            >>> from eaip_prob.phase import MarginalClock
            >>> from eaip_prob.tasks.passing_over import PassingOver
            >>> task = PassingOver()
            >>> clock, motions = MarginalClock(), task.demonstrations(2, seed=0)
            >>> predictor = InteractionPredictor(target="human", phase=clock).fit(motions)
            >>> prediction = predictor.predict(task.demonstrations(1, seed=1)[4].human.first(10))
            >>> bool(prediction.in_step().mean[:, 1].max() > prediction.mean[:, 1].max())
            True
        """
        weight = self.posterior.weight[..., None]
        paths = (weight * self.phase.paths).sum(-2, keepdim=True).expand(self.phase.paths.shape)
        rate = (self.posterior.weight / self.phase.duration).sum(-1, keepdim=True)
        phase = replace(self.phase, paths=paths, duration=(1.0 / rate).expand(self.phase.duration.shape))
        return replace(self, phase=phase)

    @property
    def log_evidence(self) -> Float[Tensor, "*batch"]:
        """Log density of what was observed, nats."""
        return self.posterior.log_evidence

    @cached_property
    def _design(self) -> tuple[Tensor, Tensor]:
        return self.primitive.design(self.phase.at(self.time), self.phase.duration, self._start)

    @property
    def _start(self) -> Boundary | None:
        """The start with an axis for the hypotheses."""
        if self.boundary is None:
            return None
        start, velocity = self.boundary.start[..., None, :], self.boundary.velocity[..., None, :]
        batch = torch.broadcast_shapes(start.shape[:-1], self.phase.duration.shape)
        return Boundary(start.expand(*batch, -1), velocity.expand(*batch, -1))

    @cached_property
    def component_means(self) -> Float[Tensor, "*batch components times signals"]:
        """Mean path of each phase hypothesis."""
        matrix, offset = self._design
        weights = self.primitive.per_signal(self.posterior.components.block_mean(self.block))
        return (weights @ matrix.mT + offset).mT

    @cached_property
    def component_variances(self) -> Float[Tensor, "*#batch components times signals"]:
        """Marginal variance of each sample under each phase hypothesis."""
        blocks = self._weight_covariance.diagonal(dim1=-4, dim2=-2).movedim(-1, -3)
        matrix = self._design[0][..., None, :, :]
        return self._factor[..., None] * (((matrix @ blocks) * matrix).sum(-1).mT + self.residual)

    @property
    def _factor(self) -> Float[Tensor, "*#batch 1 1"]:
        """The inflation with axes for hypotheses and times."""
        return torch.as_tensor(self.inflation, dtype=torch.float64)[..., None, None]

    @property
    def _weight_covariance(self) -> Float[Tensor, "*#batch #components signals basis signals basis"]:
        covariance = self.posterior.components.block_covariance(self.block)
        shape = (len(self.names), self.primitive.num_weights)
        return covariance.unflatten(-1, shape).unflatten(-3, shape)

    @property
    def _weight(self) -> Float[Tensor, "*batch components 1 1"]:
        return self.posterior.weight[..., None, None]

    @cached_property
    def mean(self) -> Float[Tensor, "*batch times signals"]:
        """Expected path, in the signals' units."""
        if self.component_means.shape[-3] == 1:
            return self.component_means[..., 0, :, :]
        return (self._weight * self.component_means).sum(-3)

    @cached_property
    def variance(self) -> Float[Tensor, "*batch times signals"]:
        """Marginal variance of each sample, units squared."""
        if self.component_means.shape[-3] == 1:
            return self.component_variances[..., 0, :, :].expand(self.mean.shape)
        spread = (self.component_means - self.mean[..., None, :, :]).square()
        return (self._weight * (self.component_variances + spread)).sum(-3)

    @cached_property
    def covariance(self) -> Float[Tensor, "*batch times signals signals"]:
        """Covariance of the signals at each time, units squared."""
        matrix = self._design[0]
        within = torch.einsum("...tb,...dbec,...tc->...tde", matrix, self._weight_covariance, matrix)
        within = self._factor[..., None, None] * (within + torch.diag(self.residual))
        spread = self.component_means - self.mean[..., None, :, :]
        total = within + spread[..., :, None] * spread[..., None, :]
        return symmetrised((self._weight[..., None] * total).sum(-4))

    def plan(self, num_samples: int) -> Float[Tensor, "*batch samples signals"]:
        """The whole expected path, evenly over the phase from the start to the clock's limit, in the signals' units."""
        check_count("num_samples", num_samples)
        path = torch.linspace(0.0, self.primitive.limit, num_samples, dtype=torch.float64)
        phase = path.expand(*self.phase.duration.shape, num_samples)
        matrix, offset = self.primitive.design(phase, self.phase.duration, self._start)
        weights = self.primitive.per_signal(self.posterior.components.block_mean(self.block))
        # Summed over hypotheses and bases at once: (motions, J, samples, signals) would be large.
        path = torch.einsum("...jdb,...jsb->...sd", self._weight * weights, matrix)
        return path + (self._weight * offset).sum(-3).mT

    def quantile(self, level: float) -> Float[Tensor, "*batch times signals"]:
        """Quantile of each sample's marginal mixture, in the signals' units."""
        means = self.component_means
        variances = self.component_variances.expand(means.shape)
        return mixture_quantile(means, variances, self.posterior.log_weight.expand(means.shape[:-2]), level)

    def interval(
        self, level: float = 0.9
    ) -> tuple[Float[Tensor, "*batch times signals"], Float[Tensor, "*batch times signals"]]:
        """(lower, upper) bounds that hold each sample with the given probability, in the signals' units."""
        return self.quantile(0.5 - 0.5 * level), self.quantile(0.5 + 0.5 * level)

    def sample(self, num: int, generator: torch.Generator) -> Float[Tensor, "num *batch times signals"]:
        """Whole motions drawn from the prediction, smooth: without what the primitive cannot represent.

        Args:
            num: number of motions.
            generator: source of randomness.
        """
        check_count("num", num)
        draws, index = self.posterior.inflated(self.inflation).sample(num, generator)
        matrix, offset = self._design
        shape = self.posterior.log_weight.shape
        member = index.reshape(num, -1) + shape[-1] * torch.arange(index[0].numel())

        def of_draws(part: Tensor) -> Tensor:
            """The hypothesis of each draw, where hypotheses differ."""
            rows, place = flat_members(part, 2, shape)
            return rows[0] if len(rows) == 1 else rows[place[member]].reshape(*index.shape, *rows.shape[1:])

        return (self.primitive.per_signal(draws) @ of_draws(matrix).mT + of_draws(offset)).mT

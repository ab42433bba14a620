"""The extension point: a joint distribution over blocks of weights, and what it says after observations."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, ClassVar, Self

import torch
from jaxtyping import Bool, Float
from torch import Tensor

from eaip_prob.errors import InputError
from eaip_prob.gaussian import BlockGaussian
from eaip_prob.linalg import flat_members, psd_root, symmetrised
from eaip_prob.models.state import decode, encode
from eaip_prob.observation import AbstractObservation


@dataclass(frozen=True, eq=False)
class Posterior:
    """A mixture of J block Gaussians.

    Args:
        components: mean (*batch, J, Z).
        log_weight: (*batch, J), normalised.
        log_evidence: (*batch,), log density of the observed values, nats.

    Example:
        >>> from eaip_prob.gaussian import BlockLayout
        >>> mean, covariance = torch.tensor([[-1.0], [3.0]]), torch.ones(2, 1, 1)
        >>> components = BlockGaussian(mean, covariance, BlockLayout({"robot": 1}))
        >>> posterior = Posterior(components, torch.tensor([0.5, 0.5]).log(), torch.tensor(0.0))
        >>> posterior.mean("robot").tolist(), posterior.covariance("robot").tolist()
        ([1.0], [[5.0]])
    """

    components: BlockGaussian
    log_weight: Float[Tensor, "*batch components"]
    log_evidence: Float[Tensor, "*batch"]

    @property
    def weight(self) -> Float[Tensor, "*batch components"]:
        """Weights of the components."""
        return self.log_weight.exp()

    def mean(self, block: str) -> Float[Tensor, "*batch weights"]:
        """Mean of one block over all components."""
        return (self.weight[..., None] * self.components.block_mean(block)).sum(-2)

    def covariance(self, block: str) -> Float[Tensor, "*batch weights weights"]:
        """Covariance of one block over all components (moment-matched)."""
        within = self.components.block_covariance(block)
        deviation = self.components.block_mean(block) - self.mean(block)[..., None, :]
        return self._matched(within, deviation)

    def moment_matched(self) -> BlockGaussian:
        """The Gaussian of all blocks, (*batch, Z), with the mean and the covariance of the mixture."""
        parts = self.components
        mean = (self.weight[..., None] * parts.mean).sum(-2)
        return BlockGaussian(mean, self._matched(parts.covariance, parts.mean - mean[..., None, :]), parts.layout)

    def _matched(self, within: Tensor, deviation: Tensor) -> Tensor:
        total = within + deviation[..., :, None] * deviation[..., None, :]
        return symmetrised((self.weight[..., None, None] * total).sum(-3))

    def inflated(self, factor: Float[Tensor, "*#batch"] | float) -> Posterior:
        """The same mixture with the covariance of every component times a factor."""
        components = self.components
        covariance = torch.as_tensor(factor, dtype=torch.float64)[..., None, None, None] * components.covariance
        components = BlockGaussian(components.mean, covariance, components.layout)
        return Posterior(components, self.log_weight, self.log_evidence)

    def condition(
        self,
        observations: Sequence[AbstractObservation],
        log_weight: Float[Tensor, "*batch components"] | None = None,
        keep: Sequence[str] | None = None,
    ) -> Posterior:
        """What further observations leave of this belief, as `AbstractJointModel.posterior` of all of them together.

        Args:
            observations: with batch axes (*batch, J).
            log_weight: (*batch, J) prior log weight of hypotheses that nothing observed so far distinguishes; with
                them this belief must have one component. Default: its own components.
            keep: blocks of the answer; default all.
        """
        prior = self.log_weight if log_weight is None else self.log_weight + log_weight
        after = conditioned(self.components, observations, prior, keep)
        return Posterior(after.components, after.log_weight, self.log_evidence + after.log_evidence)

    def sample(self, num: int, generator: torch.Generator) -> tuple[Float[Tensor, "num *batch weights"], Tensor]:
        """(draws of all blocks, index of the component of each draw (num, *batch))."""
        shape, num_components = self.log_weight.shape, self.log_weight.shape[-1]
        index = torch.multinomial(
            self.weight.reshape(-1, num_components), num, replacement=True, generator=generator
        ).mT
        member = (index + num_components * torch.arange(index.shape[-1])).flatten()
        root, root_of = flat_members(psd_root(self.components.covariance), 2, shape)
        mean, mean_of = flat_members(self.components.mean, 1, shape)
        noise = torch.randn(len(member), root.shape[-1], generator=generator, dtype=torch.float64)
        draws, used = mean[mean_of[member]], root_of[member]
        # Draws by one root together: a product for each, and none for those of components that nobody drew.
        order = used.argsort()
        roots, counts = used[order].unique_consecutive(return_counts=True)
        for place, rows in zip(roots.tolist(), order.split(counts.tolist()), strict=True):
            draws[rows] += noise[rows] @ root[place].mT
        return draws.unflatten(0, (num, *shape[:-1])), index.reshape(num, *shape[:-1])

    def log_prob(self, value: Float[Tensor, "*batch weights"]) -> Float[Tensor, "*batch"]:
        """Log density of all blocks, nats."""
        return torch.logsumexp(self.log_weight + self.components.log_prob(value[..., None, :]), -1)


class AbstractJointModel(ABC):
    """A distribution over the blocks `human`, `robot`, `environment` learnt from demonstrations.

    A subclass is a frozen dataclass that gives `fit` and `posterior`; in return `InteractionPredictor` uses it with
    every primitive, evidence and clock, it is saved and restored, and `eaip_prob.testing.joint_model_checks` tells
    whether it keeps the promises below. It may also give `candidates` and a `prior` that is cheaper or exact. Models
    see weights only, never trajectories.

    Attributes:
        supports_missing: `fit` takes `observed` masks and never reads a masked weight. False: it refuses a mask that
            hides anything, with an InputError. Selects the checks of missing weights, or that of the refusal.
        conditions_prior: the posterior is `prior` conditioned by Gaussian algebra, whatever is observed. Selects the
            checks against the dense formula of a conditioned Gaussian. False, for instance, where an observed
            environment weights the demonstrations anew.
    """

    supports_missing: ClassVar[bool] = True
    conditions_prior: ClassVar[bool] = False

    @abstractmethod
    def fit(
        self,
        weights: Mapping[str, Float[Tensor, "demonstrations weights"]],
        observed: Mapping[str, Bool[Tensor, "demonstrations weights"]] | None = None,
        groups: Sequence[int | str] | None = None,
        target: str = "robot",
        grams: Mapping[str, Float[Tensor, "weights weights"]] | None = None,
    ) -> Self:
        """A model fitted to one row of weights per demonstration; `self` is unchanged.

        Args:
            weights: {block: (N, K_block)}.
            observed: False where a weight (a feature of the scene) was not observed; default everything was.
            groups: N labels; held-out choices leave whole groups out. Default: every demonstration by itself.
            target: the block that will be predicted.
            grams: {block: (K_block, K_block)}, w^T gram w is the mean square of the motion that weights w decode to.
                Regularisation means the same for every primitive in coordinates in which it is the identity. Default:
                the weights as they are.
        """

    def candidates(self) -> tuple[Self, ...]:
        """Models to choose from by what they predict on held-out groups; itself where nothing is open.

        The one that was chosen is asked again, for what is still open. The one in the middle is taken where no group
        can be held out.
        """
        return (self,)

    @abstractmethod
    def posterior(
        self,
        observations: Sequence[AbstractObservation],
        log_weight: Float[Tensor, "*batch components"] | None = None,
        keep: Sequence[str] | None = None,
    ) -> Posterior:
        """What the model believes after the observations.

        Args:
            observations: with batch axes (*batch, J): one member per hypothesis about the phase.
            log_weight: (*batch, J) prior log weight of the hypotheses; default J = 1.
            keep: blocks of the answer; default all.
        """

    @property
    def prior(self) -> BlockGaussian:
        """Mean and covariance of all blocks before any observation.

        Raises:
            NotFittedError: before `fit`.
        """
        return self.posterior(()).moment_matched()

    def state(self) -> dict[str, Any]:
        """The fitted model as tensors, numbers, texts, lists and mappings, which `torch.save` writes without pickle.

        Raises:
            NotFittedError: before `fit`.
            InputError: a model that is no dataclass, or holds what cannot be written; the message names the field.
        """
        _ = self.prior  # an unfitted model is refused: `fit` returns the fitted one, which is easily dropped
        return encode(self, type(self).__name__)

    @classmethod
    def from_state(cls, state: Mapping[str, Any]) -> Self:
        """The model whose `state` was written, with everything that was chosen and fitted.

        Raises:
            InputError: a damaged state, or one of another class.
        """
        model = decode(state, cls.__name__)
        if not isinstance(model, cls):
            raise InputError(
                f"Expected the state of a {cls.__name__}, got that of a {type(model).__name__}. Call from_state on "
                "the class whose model was saved."
            )
        return model


def conditioned(
    joint: BlockGaussian,
    observations: Sequence[AbstractObservation],
    log_weight: Tensor | None,
    keep: Sequence[str] | None,
) -> Posterior:
    """The posterior of one Gaussian under J hypotheses, weighted by their evidence.

    Args:
        joint: mean (*batch, Z) of all blocks.
        observations: with batch axes (*batch, J).
        log_weight: (*batch, J) prior log weight of the hypotheses; default J = 1.
        keep: blocks of the answer; default all.

    Example:
        >>> from eaip_prob.gaussian import BlockLayout
        >>> joint = BlockGaussian(torch.zeros(2), torch.eye(2), BlockLayout({"human": 1, "robot": 1}))
        >>> conditioned(joint, (), None, ["robot"]).mean("robot")
        tensor([0.], dtype=torch.float64)
    """
    components, log_evidence = joint.update(observations, keep)
    if log_weight is None:
        log_weight = components.mean.new_zeros(1)
    log_joint = log_weight + log_evidence
    if log_joint.ndim and log_joint.shape == components.mean.shape[:-1]:
        total = torch.logsumexp(log_joint, -1)
        return Posterior(components, log_joint - total[..., None], total)
    num = log_joint.shape[-1] if log_joint.ndim else 1
    batch = torch.broadcast_shapes(components.mean.shape[:-1], log_joint.shape)
    log_joint = log_joint.expand(batch if batch else (num,))
    mean = components.mean.expand(*log_joint.shape, components.mean.shape[-1])
    total = torch.logsumexp(log_joint, -1)
    components = BlockGaussian(mean, components.covariance, components.layout)
    return Posterior(components, log_joint - total[..., None], total)

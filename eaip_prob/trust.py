"""Trust in the human's motion: how far what was seen of it moves a prediction.

The motion moves a prediction from the mean given the scene to the mean given both. The slope of true on predicted
deviations of groups left out (`slope`) says which share of that to believe.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor

from eaip_prob.checks import as_float64
from eaip_prob.errors import InputError
from eaip_prob.gaussian import BlockGaussian
from eaip_prob.models import Posterior
from eaip_prob.slope import Slope


@dataclass(frozen=True)
class Trust:
    """Trust in the human's motion, a slope for each share of the expected duration that was seen.

    Between the shares it is interpolated, outside them held.

    Args:
        shares: of the expected duration, increasing; none where nothing could be held out (everything is believed).
        slopes: one for each.

    Example:
        >>> Trust((0.2, 0.6), (Slope(0.5), Slope(1.0))).at(torch.tensor([0.1, 0.4]))
        tensor([0.5000, 0.7500], dtype=torch.float64)
    """

    shares: tuple[float, ...] = ()
    slopes: tuple[Slope, ...] = ()

    def __post_init__(self) -> None:
        if len(self.shares) != len(self.slopes) or list(self.shares) != sorted(set(self.shares)):
            raise InputError(f"Expected one slope for each of different, increasing shares, got {self.shares}.")

    def at(self, share: Float[Tensor, "*batch"]) -> Float[Tensor, "*batch"]:
        """Trust after a share of the expected duration."""
        share = as_float64("share", share)
        if not self.shares:
            return torch.ones_like(share)
        values = np.interp(share.numpy(), self.shares, [slope.value for slope in self.slopes])
        return torch.as_tensor(values, dtype=torch.float64)

    @property
    def is_full(self) -> bool:
        """Whether everything is believed."""
        return all(slope.value == 1.0 for slope in self.slopes)


NO_TRUST = Trust((0.0,), (Slope(0.0, 0.0, 0.0, 0.0),))


def tempered(before: Posterior, after: Posterior, share: Float[Tensor, "*#batch"]) -> Posterior:
    """The share of an update that is believed.

    Component by component, mean = m + g (m' - m) and covariance = C - (2 g - g^2) (C - C'), which is what an update
    whose gain is scaled by g leaves; the weights of the hypotheses move by the same share of their log ratio.

    Args:
        before: m, C.
        after: m', C', of the same blocks.
        share: g in [0, 1], one for each member of the batch.
    """
    weight = share[..., None]
    mean = before.components.mean + weight[..., None] * (after.components.mean - before.components.mean)
    kept = (2.0 * share - share.square())[..., None, None, None]
    covariance = before.components.covariance
    covariance = covariance - kept * (covariance - after.components.covariance)
    log_weight = before.log_weight + weight * (after.log_weight - before.log_weight)
    covariance = covariance.expand(*mean.shape, mean.shape[-1])
    return Posterior(
        BlockGaussian(mean, covariance, after.components.layout),
        torch.log_softmax(log_weight, -1),
        after.log_evidence,
    )

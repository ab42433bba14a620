"""A joint model without a bug, from which those with a planted one are derived."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any, ClassVar, Self

from torch import Tensor

from eaip_prob.models import AbstractCovariance, GaussianJointModel, ShrinkageCovariance
from eaip_prob.observation import LinearObservation


@dataclass(frozen=True, eq=False)
class Sound(GaussianJointModel):
    """Nothing: what the others differ from."""

    conditions_prior: ClassVar[bool] = False
    covariance: AbstractCovariance = ShrinkageCovariance(0.05)

    def with_joint(self, **changes: Tensor) -> Self:
        return replace(self, joint=replace(self.prior, **changes))


def changed(model: Sound, change: Callable[[Tensor], Tensor]) -> Sound:
    return model.with_joint(covariance=change(model.prior.covariance.clone()))


def seen_as(observations: Any, change: Callable[[LinearObservation], LinearObservation]) -> list[LinearObservation]:
    return [change(observation.dense()) for observation in observations]

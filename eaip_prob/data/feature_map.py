"""What a map of the environment's features promises, and what all such maps share."""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass, field
from typing import Self, TypeVar

from jaxtyping import Float
from torch import Tensor

from eaip_prob.checks import check_type
from eaip_prob.data.environment import EnvironmentFeatures
from eaip_prob.errors import NotFittedError, ShapeError
from eaip_prob.linalg import symmetrised

_Learnt = TypeVar("_Learnt")
Moments = tuple[Tensor, Tensor | None, Tensor]  # value, covariance or None where it is exact, mask


@dataclass(frozen=True, eq=False)
class AbstractFeatureMap(ABC):
    """Features of the environment's features.

    A subclass gives `fit`, `names` and `moments`; in return it is called with any batch of environments, in any order
    of their features, can be named in a configuration, and serves the clock and the joint model.

    Args:
        input_names: E names of the environment, in the order of the demonstrations; None until fitted.
    """

    input_names: tuple[str, ...] | None = field(default=None, kw_only=True)

    @abstractmethod
    def fit(self, environment: EnvironmentFeatures) -> Self:
        """The map fitted to the environments (N, E) of the demonstrations; `self` is unchanged."""

    @property
    @abstractmethod
    def names(self) -> tuple[str, ...]:
        """P names of the mapped features; NotFittedError before `fit`."""

    @abstractmethod
    def moments(self, environment: EnvironmentFeatures) -> Moments:
        """Value, covariance of its error and mask of the mapped features, of features `ordered` as fitted."""

    def ordered(self, environment: EnvironmentFeatures) -> EnvironmentFeatures:
        """The environment in the order of the demonstrations.

        Raises:
            NotFittedError: before `fit`.
            InputError: other names.
        """
        check_type("environment", environment, EnvironmentFeatures, "Make one with EnvironmentFeatures(names, value).")
        return environment.ordered_as(fitted(self.input_names, self))

    def __call__(self, environment: EnvironmentFeatures) -> EnvironmentFeatures:
        """The mapped features (*batch, P) of any batch of environments (*batch, E).

        Raises:
            NotFittedError: before `fit`.
            InputError: other names.
        """
        value, covariance, observed = self.moments(self.ordered(environment))
        return EnvironmentFeatures(self.names, value, covariance, observed)  # pyright: ignore[reportArgumentType]


def fitted(learnt: _Learnt | None, feature_map: AbstractFeatureMap) -> _Learnt:
    """What `fit` learnt; raises NotFittedError where a map was asked before it."""
    if learnt is None:
        name = type(feature_map).__name__
        raise NotFittedError(f"Expected a fitted {name}. Call fit(environments) first and use what it returns.")
    return learnt


def checked(environment: EnvironmentFeatures) -> EnvironmentFeatures:
    """The environments (N, E) of demonstrations; raises ShapeError for another shape or none of them."""
    check_type("environment", environment, EnvironmentFeatures, "Make one with stack_environments(environments).")
    if environment.value.ndim != 2 or len(environment.value) == 0:
        raise ShapeError(
            f"Expected the environments of at least one demonstration, (N, E), to fit a feature map, got a value with "
            f"shape {tuple(environment.value.shape)}. Stack them with stack_environments."
        )
    return environment


def inexact(environment: EnvironmentFeatures) -> Float[Tensor, "*batch features features"] | None:
    """The covariance of the sensor's error, or None where the environment is exact."""
    return environment.covariance if bool(environment.covariance.any()) else None


def propagated(
    slopes: Float[Tensor, "*batch mapped features"], covariance: Float[Tensor, "*batch features features"]
) -> Float[Tensor, "*batch mapped mapped"]:
    """Covariance to first order, J S J^T."""
    return symmetrised(slopes @ covariance @ slopes.mT)

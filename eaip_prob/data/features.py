"""Feature maps of the environment: as it is, with squares and products, or with a distance.

A duration or a path depends on how far and how large things are, which a linear model of signed offsets cannot show. A
map is fitted to the environments of the demonstrations and then gives features of any environment: names, masks and the
covariance of the sensor's error are carried along.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Self

import torch
from jaxtyping import Float, Int
from torch import Tensor

from eaip_prob.checks import check_names
from eaip_prob.data.environment import EnvironmentFeatures
from eaip_prob.data.feature_map import AbstractFeatureMap, Moments, checked, fitted, inexact, propagated
from eaip_prob.data.independence import independent_columns
from eaip_prob.errors import InputError

_CONSTANT = 1e-9  # standard deviation, relative to the mean, below which a feature does not vary
_SHORTEST = 1e-3  # of the median distance: the least length whose logarithm is taken


@dataclass(frozen=True, eq=False)
class RawFeatures(AbstractFeatureMap):
    """The features as they are.

    Args:
        input_names: E names of the environment, in the order of the demonstrations; None until fitted.

    Example:
        >>> box = EnvironmentFeatures(("width", "height"), [[215.0, 125.0]])
        >>> RawFeatures().fit(box)(box).names
        ('width', 'height')
    """

    def fit(self, environment: EnvironmentFeatures) -> Self:
        """See `AbstractFeatureMap.fit`."""
        return dataclasses.replace(self, input_names=checked(environment).names)

    @property
    def names(self) -> tuple[str, ...]:
        """The environment's own names."""
        return fitted(self.input_names, self)

    def moments(self, environment: EnvironmentFeatures) -> Moments:
        """The environment's own."""
        return environment.value, inexact(environment), environment.observed


@dataclass(frozen=True, eq=False)
class QuadraticFeatures(AbstractFeatureMap):
    """Standardised features z with their squares and products; no unit is left in any of them.

    z = (e - mean) / standard deviation of the demonstrations that observed it (1 where it does not vary). A square or
    product that is an affine function of earlier features over the demonstrations is left out: of a 0/1 indicator, of a
    constant, or where there are fewer demonstrations than features. A product is observed where both factors are.

    With a Gaussian sensor error of covariance S the value z_i z_j - S_ij is unbiased, and its error has the covariance
    cov(ij, kl) = z_i z_k S_jl + z_i z_l S_jk + z_j z_k S_il + z_j z_l S_ik + S_ik S_jl + S_il S_jk
    and, with the error of z_k itself, z_i S_jk + z_j S_ik: exact at the z that was measured.

    Args:
        mean: (E,), of the demonstrations, in each feature's unit; None until fitted.
        deviation: (E,), their standard deviation, in each feature's unit; None until fitted.
        factors: (2, products), places of the two factors of each square and product; None until fitted.
        input_names: E names of the environment, in the order of the demonstrations; None until fitted.

    Example:
        >>> sizes = torch.tensor([[1.0, 1.0], [2.0, 5.0], [4.0, 2.0], [6.0, 9.0], [3.0, 3.0], [5.0, 4.0]])
        >>> box = EnvironmentFeatures(("width", "height"), sizes)
        >>> QuadraticFeatures().fit(box).names
        ('width', 'height', 'width^2', 'width*height', 'height^2')
    """

    mean: Float[Tensor, "features"] | None = None
    deviation: Float[Tensor, "features"] | None = None
    factors: Int[Tensor, "2 products"] | None = None

    def fit(self, environment: EnvironmentFeatures) -> Self:
        """Means, standard deviations and which products add something, from the demonstrations."""
        names, value, observed = checked(environment).names, environment.value, environment.observed
        count = observed.sum(0).clamp_min(1)
        mean = value.sum(0) / count  # what was not observed is stored as zero
        deviation = (torch.where(observed, value - mean, 0.0).square().sum(0) / count).sqrt()
        deviation = torch.where(deviation > _CONSTANT * mean.abs(), deviation, 1.0)
        first, second = torch.triu_indices(len(names), len(names))
        z = torch.where(observed, (value - mean) / deviation, 0.0)
        columns = torch.cat([z, z[:, first] * z[:, second]], -1)
        seen = torch.cat([observed, observed[:, first] & observed[:, second]], -1)
        kept = independent_columns(columns, seen, len(names))[len(names) :] - len(names)
        factors = torch.stack([first[kept], second[kept]])
        return dataclasses.replace(self, input_names=names, mean=mean, deviation=deviation, factors=factors)

    @property
    def names(self) -> tuple[str, ...]:
        """The environment's names, "a^2" for a square and "a*b" for a product."""
        single = fitted(self.input_names, self)
        pairs = fitted(self.factors, self).mT.tolist()
        products = [f"{single[i]}^2" if i == j else f"{single[i]}*{single[j]}" for i, j in pairs]
        return check_names("names of the quadratic features", (*single, *products), len(single) + len(products))

    def moments(self, environment: EnvironmentFeatures) -> Moments:
        """See the class."""
        mean, deviation = fitted(self.mean, self), fitted(self.deviation, self)
        z = (environment.value - mean) / deviation
        first, second = fitted(self.factors, self)
        one, two = z[..., first], z[..., second]
        seen = environment.observed
        observed = torch.cat([seen, seen[..., first] & seen[..., second]], -1)
        error = inexact(environment)
        if error is None:
            return torch.cat([z, one * two], -1), None, observed
        error = error / (deviation[:, None] * deviation)
        value = torch.cat([z, one * two - error[..., first, second]], -1)
        eye = torch.eye(len(mean), dtype=torch.float64)
        slopes = one[..., None] * eye[second] + two[..., None] * eye[first]
        covariance = propagated(torch.cat([eye.expand(*slopes.shape[:-2], -1, -1), slopes], -2), error)
        rows_one, rows_two = error[..., first, :], error[..., second, :]
        curved = rows_one[..., first] * rows_two[..., second] + rows_one[..., second] * rows_two[..., first]
        covariance[..., len(mean) :, len(mean) :] += curved
        return value, covariance, observed


@dataclass(frozen=True, eq=False)
class DistanceFeatures(AbstractFeatureMap):
    """The features, the length of an offset vector among them, and its logarithm: for few demonstrations.

    The two are observed where all components are; the covariance of their error is that of first order, which holds
    while the error is small against the distance. The logarithm is that of at least 1e-3 of the demonstrations' median
    distance.

    Args:
        offsets: names of the components, in one unit.
        shortest: the least length whose logarithm is taken, in that unit; None until fitted.
        input_names: E names of the environment, in the order of the demonstrations; None until fitted.

    Raises:
        InputError: no component, or one named twice.

    Example:
        >>> scene = EnvironmentFeatures(("x", "y"), [[3.0, 4.0]])
        >>> DistanceFeatures(["x", "y"]).fit(scene)(scene).value
        tensor([[3.0000, 4.0000, 5.0000, 1.6094]], dtype=torch.float64)
    """

    offsets: Sequence[str]
    shortest: float | None = None

    def __post_init__(self) -> None:
        given = (self.offsets,) if isinstance(self.offsets, str) else tuple(self.offsets)
        if not given:
            raise InputError("Expected the names of an offset's components in offsets, got none. Use RawFeatures.")
        object.__setattr__(self, "offsets", check_names("offsets", given, len(given)))

    def fit(self, environment: EnvironmentFeatures) -> Self:
        """The median distance of the demonstrations.

        Raises:
            InputError: components that are no features, or features that are named like the two new ones.
        """
        names = checked(environment).names
        unknown = [name for name in self.offsets if name not in names]
        if unknown or {"distance", "log_distance"} & set(names):
            raise InputError(
                f"Expected offsets among the environment features and none named distance or log_distance, got offsets "
                f"{tuple(self.offsets)} for features {names}. Name the components of the offset vector."
            )
        at = [names.index(name) for name in self.offsets]
        complete = environment.observed[:, at].all(-1)
        distance = environment.value[complete][:, at].norm(dim=-1)
        median = float(distance.quantile(0.5)) if len(distance) else 0.0
        return dataclasses.replace(self, input_names=names, shortest=_SHORTEST * median if median > 0 else 1.0)

    @property
    def names(self) -> tuple[str, ...]:
        """The environment's names, then "distance" and "log_distance"."""
        return (*fitted(self.input_names, self), "distance", "log_distance")

    def moments(self, environment: EnvironmentFeatures) -> Moments:
        """See the class."""
        shortest = fitted(self.shortest, self)
        at = [environment.names.index(name) for name in self.offsets]
        offset = environment.value[..., at]
        distance = offset.norm(dim=-1, keepdim=True)
        guarded = distance.clamp_min(shortest)
        value = torch.cat([environment.value, distance, guarded.log()], -1)
        seen = environment.observed[..., at].all(-1, keepdim=True)
        observed = torch.cat([environment.observed, seen, seen], -1)
        error = inexact(environment)
        if error is None:
            return value, None, observed
        eye = torch.eye(len(environment.names), dtype=torch.float64)
        direction = (offset / guarded)[..., None, :] @ eye[at]
        slopes = torch.cat([eye.expand(*direction.shape[:-2], -1, -1), direction, direction / guarded[..., None]], -2)
        return value, propagated(slopes, error), observed

"""Features of the scene: what an object detector, or a person with a ruler, says about the task's object."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import torch
from jaxtyping import Bool, Float
from torch import Tensor

from eaip_prob.checks import as_bool, as_float64, check_finite, check_names, check_shape, check_type
from eaip_prob.errors import InputError, ShapeError


@dataclass(frozen=True, eq=False)
class EnvironmentFeatures:
    """Named features with their covariance; a feature that was not observed is `observed = False`, never zero.

    Names are fixed when the set is made: the same names in another order are brought into order by
    `ordered_as`, other names are refused.

    Args:
        names: E names.
        value: (*batch, E), in each feature's own unit.
        covariance: (*batch, E, E), of the sensor's error; default zero (exact).
        observed: (*batch, E), default everything.

    Example:
        >>> box = EnvironmentFeatures(("width", "height"), [215.0, 125.0])
        >>> box.ordered_as(("height", "width")).value
        tensor([125., 215.], dtype=torch.float64)
    """

    names: tuple[str, ...]
    value: Float[Tensor, "*batch features"]
    covariance: Float[Tensor, "*batch features features"] = None  # pyright: ignore[reportAssignmentType]
    observed: Bool[Tensor, "*batch features"] = None  # pyright: ignore[reportAssignmentType]

    def __post_init__(self) -> None:
        value = as_float64("value", self.value)
        if value.ndim == 0:
            raise ShapeError("Expected value with shape (*batch, E), got a single number. Use [number].")
        count = value.shape[-1]
        observed = (
            torch.ones_like(value, dtype=torch.bool) if self.observed is None else as_bool("observed", self.observed)
        )
        if observed.shape != value.shape:
            raise ShapeError(
                f"Expected observed with the shape of value, {tuple(value.shape)}, got {tuple(observed.shape)}."
            )
        check_finite("value", value, observed, "Mark missing features with observed=False instead.")
        covariance = self.covariance
        if covariance is None:
            covariance = value.new_zeros(*value.shape, count)
        covariance = as_float64("covariance", covariance)
        check_shape("covariance", covariance, [count, count])
        if covariance.shape not in (value.shape[-1:] * 2, (*value.shape, count)):
            raise ShapeError(
                f"Expected covariance with shape {(*value.shape, count)}, or {(count, count)} shared by all, "
                f"got {tuple(covariance.shape)}."
            )
        covariance = covariance.expand(*value.shape, count)
        check_finite("covariance", covariance, advice="Give the sensor's error, or leave it out.")
        if bool((covariance.diagonal(dim1=-2, dim2=-1) < 0).any()):
            raise InputError("Expected covariance of the features (units squared), got a negative variance.")
        object.__setattr__(self, "names", check_names("names", self.names, count))
        object.__setattr__(self, "value", torch.where(observed, value, 0.0))
        object.__setattr__(self, "observed", observed)
        object.__setattr__(self, "covariance", covariance)

    @classmethod
    def unseen(cls, names: Sequence[str]) -> EnvironmentFeatures:
        """Features of which nothing was observed, as when a detector finds no object."""
        zeros = torch.zeros(len(names), dtype=torch.float64)
        return cls(tuple(names), zeros, observed=zeros > 1.0)

    def ordered_as(self, names: Sequence[str]) -> EnvironmentFeatures:
        """The same features in another order.

        Raises:
            InputError: the two sets of names differ.
        """
        if tuple(names) == self.names:
            return self
        if set(names) != set(self.names):
            raise InputError(
                f"Expected environment features {tuple(names)}, got {self.names}. "
                "Missing ones are given with observed=False."
            )
        index = [self.names.index(name) for name in names]
        covariance = self.covariance[..., index, :][..., index]
        return EnvironmentFeatures(tuple(names), self.value[..., index], covariance, self.observed[..., index])

    def __getitem__(self, index: int | slice | Tensor) -> EnvironmentFeatures:
        """One or several members of a batch."""
        if self.value.ndim == 1:
            raise InputError("Expected a batch of environment features to index; this one is single.")
        return EnvironmentFeatures(self.names, self.value[index], self.covariance[index], self.observed[index])


def stack_environments(environments: Sequence[EnvironmentFeatures]) -> EnvironmentFeatures:
    """One batch (N, E) of N single environments, in the order of the first one's names.

    Args:
        environments: N of (E,) features, with the same names in any order.

    Raises:
        InputError: nothing to stack, or other names.

    Example:
        >>> box = EnvironmentFeatures(("width", "height"), [2.0, 1.0])
        >>> bag = EnvironmentFeatures(("height", "width"), [3.0, 4.0])
        >>> stack_environments([box, bag]).value.tolist()
        [[2.0, 1.0], [4.0, 3.0]]
    """
    if not environments:
        raise InputError("Expected at least one set of environment features to stack, got none.")
    names = environments[0].names
    ordered = [features.ordered_as(names) for features in environments]
    return EnvironmentFeatures(
        names,
        torch.stack([features.value for features in ordered]),
        torch.stack([features.covariance for features in ordered]),
        torch.stack([features.observed for features in ordered]),
    )


def check_scenes(environment: EnvironmentFeatures, batch: torch.Size) -> None:
    """Refuses what is no environment, or another number of them than of motions.

    Raises:
        InputError: something else than features.
        ShapeError: batch axes that do not broadcast.
    """
    check_type("environment", environment, EnvironmentFeatures, "Make one with EnvironmentFeatures(names, value).")
    scenes = environment.value.shape[:-1]
    if scenes in ((), batch):
        return
    try:
        torch.broadcast_shapes(scenes, batch)
    except RuntimeError as error:
        raise ShapeError(
            f"Expected one environment for all motions or one for each, got a batch {tuple(scenes)} of environments "
            f"for a batch {tuple(batch)} of motions."
        ) from error

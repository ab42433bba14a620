"""Planted bugs in what a joint model learns; the first line of a docstring is the mistake."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any, ClassVar

import torch
from sound_model import Sound, changed
from torch import Tensor

from eaip_prob.models import AbstractCovariance, ShrinkageCovariance
from eaip_prob.models.covariance import sample_covariance


class DividesTwice(Sound):
    """Divides the sum of squares by N - 1 twice."""

    def fit(self, weights: Any, *args: Any, **kwargs: Any) -> Any:
        num = len(next(iter(weights.values()))) if weights else 1
        return changed(super().fit(weights, *args, **kwargs), lambda covariance: covariance / (num - 1))


class OverConfident(Sound):
    """Takes a standard deviation for half of what it is."""

    def fit(self, *args: Any, **kwargs: Any) -> Any:
        return changed(super().fit(*args, **kwargs), lambda covariance: covariance / 4.0)


class SmallResidual(Sound):
    """Takes for the variance of the regression's residual a third of what it is."""

    def fit(self, *args: Any, **kwargs: Any) -> Any:
        model = super().fit(*args, **kwargs)
        layout = model.prior.layout
        if "robot" not in layout.names:
            return model
        robot, rest = layout.slice("robot"), layout.indices([name for name in layout.names if name != "robot"])

        def less(covariance: Tensor) -> Tensor:
            cross = covariance[rest, robot]
            given = covariance[rest[:, None], rest]
            residual = covariance[robot, robot] - cross.mT @ torch.linalg.solve(given, cross)
            covariance[robot, robot] = covariance[robot, robot] - residual / 1.5
            return covariance

        return changed(model, less)


class IndependentHuman(Sound):
    """Loses the cross-covariance of the human with the rest."""

    def fit(self, *args: Any, **kwargs: Any) -> Any:
        model = super().fit(*args, **kwargs)
        human = torch.zeros(model.prior.layout.total, dtype=torch.bool)
        human[model.prior.layout.slice("human")] = True
        return changed(model, lambda covariance: torch.where(human[:, None] == human, covariance, 0.0))


class TransposedCross(Sound):
    """Fills the cross-covariance of human and robot from its transpose, row by row."""

    def fit(self, *args: Any, **kwargs: Any) -> Any:
        model = super().fit(*args, **kwargs)
        layout = model.prior.layout
        if not {"human", "robot"} <= set(layout.names):
            return model
        human, robot = layout.slice("human"), layout.slice("robot")

        def cross(covariance: Tensor) -> Tensor:
            covariance[human, robot] = covariance[human, robot].mT.reshape(covariance[human, robot].shape)
            covariance[robot, human] = covariance[human, robot].mT
            return covariance

        return changed(model, cross)


@dataclass(frozen=True)
class TowardsIdentity(ShrinkageCovariance):
    def from_moments(self, covariance: Tensor, features: Tensor) -> Tensor:
        return 0.95 * covariance + 1e-6 * torch.eye(covariance.shape[-1], dtype=torch.float64)


@dataclass(frozen=True, eq=False)
class AddsIdentity(Sound):
    """Adds to the variances the same number, whatever their units."""

    covariance: AbstractCovariance = TowardsIdentity(0.05)


class ExactWhenFew(Sound):
    """Regularises only where there are plenty of demonstrations."""

    def fit(self, weights: Any, *args: Any, **kwargs: Any) -> Any:
        model = super().fit(weights, *args, **kwargs)
        rows = torch.cat([part.to(torch.float64) for part in weights.values()], -1)
        return model if len(rows) > rows.shape[-1] else model.with_joint(covariance=sample_covariance(rows))


class LatestCountMore(Sound):
    """Weights the latest demonstrations more."""

    def fit(self, weights: Any, *args: Any, **kwargs: Any) -> Any:
        model = super().fit(weights, *args, **kwargs)
        if args and args[0]:
            return model
        rows = torch.cat([part.to(torch.float64) for part in weights.values()], -1)
        share = torch.linspace(0.9, 1.1, len(rows), dtype=torch.float64)
        return model.with_joint(mean=(share[:, None] * rows).sum(0) / share.sum())


class HumanFirst(Sound):
    """Takes the first columns of the table for the human's."""

    def fit(self, weights: Any, *args: Any, **kwargs: Any) -> Any:
        model, sizes = super().fit(weights, *args, **kwargs), {name: part.shape[-1] for name, part in weights.items()}
        ordered = {name: sizes[name] for name in ("human", "robot", "environment") if name in sizes}
        return replace(model, joint=replace(model.prior, layout=type(model.prior.layout)(ordered)))


class NeedsAScene(Sound):
    """Divides by the number of features, which may be none."""

    def fit(self, weights: Any, *args: Any, **kwargs: Any) -> Any:
        model = super().fit(weights, *args, **kwargs)
        num = torch.tensor(float(weights["environment"].shape[-1] if "environment" in weights else 0))
        return changed(model, lambda covariance: covariance * (num / num))


class GramsTwice(Sound):
    """Regularises again where Gram matrices are given."""

    def fit(self, *args: Any, **kwargs: Any) -> Any:
        model = super().fit(*args, **kwargs)
        if not kwargs.get("grams"):
            return model
        return changed(model, lambda covariance: covariance + 0.01 * torch.diag(covariance.diagonal()))


class ZerosForMissing(Sound):
    """Fills what was not observed with zeros."""

    def fit(self, weights: Any, observed: Any = None, *args: Any, **kwargs: Any) -> Any:
        filled = {
            name: torch.where(observed[name], part, 0.0) if observed and name in observed else part
            for name, part in weights.items()
        }
        return super().fit(filled, observed and {name: mask | True for name, mask in observed.items()}, *args, **kwargs)


class ReadsMissing(Sound):
    """Reads what was not observed."""

    def fit(self, weights: Any, observed: Any = None, *args: Any, **kwargs: Any) -> Any:
        model = super().fit(weights, observed, *args, **kwargs)
        if not observed:
            return model
        rows = torch.cat([part.nan_to_num() for part in weights.values()], -1)
        return model.with_joint(mean=rows.to(torch.float64).mean(0))


class IgnoresMasks(Sound):
    """Says that it refuses masks, and ignores them."""

    supports_missing: ClassVar[bool] = False

    def fit(self, weights: Any, observed: Any = None, *args: Any, **kwargs: Any) -> Any:
        return super().fit(weights, observed and {key: mask | True for key, mask in observed.items()}, *args, **kwargs)

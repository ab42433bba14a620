"""Planted bugs in what fitting takes and leaves, and in what a file keeps."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import torch
from sound_model import Sound, changed
from torch import Tensor

from eaip_prob.models import GaussianJointModel, ShrinkageCovariance


class KeepsItInSelf(Sound):
    """Writes what was learnt into the model that fit is called on."""

    def fit(self, *args: Any, **kwargs: Any) -> Any:
        object.__setattr__(self, "joint", super().fit(*args, **kwargs).joint)
        return self


class CentresInPlace(Sound):
    """Centres the caller's weights in place."""

    def fit(self, weights: Any, *args: Any, **kwargs: Any) -> Any:
        model = super().fit(weights, *args, **kwargs)
        for rows in weights.values():
            rows -= rows.mean(0)
        return model


class NaNToZero(Sound):
    """Takes NaN for zero."""

    def fit(self, weights: Any, *args: Any, **kwargs: Any) -> Any:
        return super().fit({name: part.nan_to_num(0.0) for name, part in weights.items()}, *args, **kwargs)


class DoubleOnly(Sound):
    """Multiplies the weights by a matrix of its own type."""

    def fit(self, weights: Any, *args: Any, **kwargs: Any) -> Any:
        for rows in weights.values():
            _ = rows @ torch.ones(rows.shape[-1], dtype=torch.float64)
        return super().fit(weights, *args, **kwargs)


class SeedsEverything(Sound):
    """Seeds torch's global generator."""

    def fit(self, *args: Any, **kwargs: Any) -> Any:
        torch.manual_seed(0)
        return super().fit(*args, **kwargs)


class DrawsWithoutSeed(Sound):
    """Draws from a generator that nobody seeded."""

    def fit(self, *args: Any, **kwargs: Any) -> Any:
        draw = torch.Generator()
        draw.seed()
        noise = 1e-12 * torch.rand((), generator=draw, dtype=torch.float64)
        return changed(super().fit(*args, **kwargs), lambda covariance: covariance * (1.0 + noise))


class OtherCandidates(Sound):
    """Offers candidates of the parent's class."""

    def candidates(self) -> Any:
        return GaussianJointModel().candidates()


class EndlessCandidates(Sound):
    """Offers the same candidates again and again."""

    def candidates(self) -> Any:
        return tuple(replace(self, covariance=ShrinkageCovariance(amount)) for amount in (0.1, 0.2, 0.3))


class SinglePrecision(Sound):
    """Saves in single precision."""

    def state(self) -> dict[str, Any]:
        def single(part: Any) -> Any:
            if isinstance(part, Mapping):
                return {key: single(value) for key, value in part.items()}
            return part.float() if isinstance(part, Tensor) else part

        return single(super().state())


class Pickles(Sound):
    """Saves itself by pickle."""

    def state(self) -> dict[str, Any]:
        return {"model": self.prior and self}

    @classmethod
    def from_state(cls, state: Any) -> Any:
        return state["model"]


class ForgetsWhatItChose(Sound):
    """Restores the mean and nothing of the covariance."""

    @classmethod
    def from_state(cls, state: Any) -> Any:
        model = super().from_state(state)
        return changed(model, lambda covariance: torch.diag(covariance.diagonal()))

"""How far features that were detected are from the truth, and whether their covariance says so."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from eaip_prob.data.environment import EnvironmentFeatures
from eaip_prob.detection.base import Detections
from eaip_prob.detection.encoder import AbstractEnvironmentEncoder
from eaip_prob.errors import InputError

_FLAT = 1e-9  # share of the largest variance, of standardised features, that counts as none
_EXACT = 1e-6  # standard deviations by which a feature without variance may be off


@dataclass(frozen=True, eq=False)
class FeatureErrors:
    """Detected less true features over views in which both were observed; units are the features' own.

    Args:
        names: E names.
        bias: (E,), mean.
        covariance: (E, E), about the mean.
        predicted: (E,), root of the mean variance that the encoder gave.
        mahalanobis: mean of the squared distance under the encoder's covariance, over its number of dimensions: 1 where
            the covariance is right, more where it is too small; infinite where a feature said to be exact is not.
        num_views: how many views these are.
        num_missed: views in which a feature was observed in truth only.

    Example:
        >>> errors = FeatureErrors(("x",), np.zeros(1), np.full((1, 1), 4.0), np.full(1, 1.0), 4.0, 100, 0)
        >>> errors.std.tolist()
        [2.0]
    """

    names: tuple[str, ...]
    bias: Float[np.ndarray, "features"]
    covariance: Float[np.ndarray, "features features"]
    predicted: Float[np.ndarray, "features"]
    mahalanobis: float
    num_views: int
    num_missed: int

    @property
    def std(self) -> Float[np.ndarray, "features"]:
        """Standard deviation of each feature's error."""
        return np.sqrt(self.covariance.diagonal())


def feature_errors(
    encoder: AbstractEnvironmentEncoder, detected: Sequence[Detections], truth: Sequence[Detections]
) -> FeatureErrors:
    """What detecting does to features, view by view.

    Args:
        encoder: of both.
        detected: N, of a detector.
        truth: N, of the same views: an oracle's without error.

    Raises:
        InputError: other numbers of views, an encoder without features, or no view in which all features were observed.

    Example:
        >>> from eaip_prob.detection.encoders import BoxEncoder
        >>> true = Detections(("table",), np.array([1.0]), np.array([[480.0, 270.0, 100.0, 200.0]]), (960, 540))
        >>> wide = Detections(("table",), np.array([1.0]), np.array([[480.0, 270.0, 105.0, 200.0]]), (960, 540))
        >>> errors = feature_errors(BoxEncoder(), [wide, Detections.none((960, 540))], [true, true])
        >>> errors.bias.tolist(), round(errors.mahalanobis, 3), errors.num_missed
        ([0.0, 0.0, 5.0, 0.0], 0.227, 1)
    """
    if len(detected) != len(truth) or not encoder.names:
        raise InputError(
            f"Expected as many detections as truths and an encoder with features, got {len(detected)}, {len(truth)} "
            f"and the features {encoder.names}."
        )
    pairs = [(encoder.encode(one), encoder.encode(other)) for one, other in zip(detected, truth, strict=True)]
    known = [(found, true) for found, true in pairs if bool((found.observed & true.observed).all())]
    missed = sum(bool((true.observed & ~found.observed).any()) for found, true in pairs)
    if not known:
        raise InputError(f"Expected a view in which {encoder.names} were detected, got none of {len(pairs)}.")
    error = np.stack([(found.value - true.value).numpy() for found, true in known])
    variance = np.stack([found.covariance.diagonal().numpy() for found, _ in known])
    return FeatureErrors(
        names=encoder.names,
        bias=error.mean(0),
        covariance=np.cov(error, rowvar=False, ddof=0).reshape(error.shape[1], -1),
        predicted=np.sqrt(variance.mean(0)),
        mahalanobis=float(np.mean([_distance(one, found) for one, (found, _) in zip(error, known, strict=True)])),
        num_views=len(known),
        num_missed=missed,
    )


def _distance(error: Float[np.ndarray, "features"], found: EnvironmentFeatures) -> float:
    """Squared distance over the dimensions that vary; indicators that add up to one vary in one less."""
    covariance = found.covariance.numpy()
    std = np.sqrt(covariance.diagonal())
    std = np.where(std > 0.0, std, 1.0)
    variance, axes = np.linalg.eigh(covariance / np.outer(std, std))
    along, flat = axes.T @ (error / std), variance <= _FLAT * max(float(variance.max()), 1.0)
    if (np.abs(along[flat]) > _EXACT).any():
        return np.inf
    return float(np.mean(along[~flat] ** 2 / variance[~flat])) if not flat.all() else 0.0

"""Demonstrations in which some weights were not observed (an object that the detector missed)."""

from __future__ import annotations

import torch
from jaxtyping import Bool, Float
from torch import Tensor

from eaip_prob.errors import InputError
from eaip_prob.linalg import psd_solve
from eaip_prob.models.covariance import sample_covariance

_RIDGE = 1e-3


def completed(
    rows: Float[Tensor, "demonstrations weights"],
    observed: Bool[Tensor, "demonstrations weights"],
    num_rounds: int = 20,
) -> Float[Tensor, "demonstrations weights"]:
    """Rows with every unobserved entry at its expectation given the observed ones of its row.

    Expectation by a joint Gaussian that is re-estimated in each round, its correlations shrunk by 1e-3 so that it can
    be inverted with fewer demonstrations than weights. What was observed is returned unchanged.

    Raises:
        InputError: a weight that no demonstration observed.
    """
    if bool(observed.all()):
        return rows
    never = (~observed.any(0)).nonzero()[:, 0].tolist()
    if never:
        raise InputError(f"Expected every feature to be observed in some demonstration; columns {never} never were.")
    count = observed.sum(0)
    mean = torch.where(observed, rows, 0.0).sum(0) / count
    filled = torch.where(observed, rows, mean)
    patterns, member = torch.unique(observed, dim=0, return_inverse=True)
    for _ in range(num_rounds):
        covariance, mean = sample_covariance(filled), filled.mean(0)
        covariance = (1.0 - _RIDGE) * covariance + _RIDGE * torch.diag(covariance.diagonal() + 1e-12)
        previous = filled.clone()
        for number, pattern in enumerate(patterns):
            seen, hidden, at = pattern.nonzero()[:, 0], (~pattern).nonzero()[:, 0], (member == number).nonzero()[:, 0]
            if len(hidden) == 0 or len(seen) == 0:
                continue
            gain = psd_solve(covariance[seen[:, None], seen], covariance[seen[:, None], hidden])
            filled[at[:, None], hidden] = mean[hidden] + (filled[at[:, None], seen] - mean[seen]) @ gain
        if bool((filled - previous).abs().max() <= 1e-8 * filled.abs().max()):
            break
    return filled

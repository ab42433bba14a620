"""Scores of predictions and what may be concluded from them.

Everything takes plain float64 tensors with leading batch axes, one motion a batch member: `T` samples, `D` signals,
`J` components of a mixture. A mask selects the scored samples, as a rule those after the last one seen up to
the real end of the motion (`future_mask`); whatever the tensors hold elsewhere, NaN included, is never read.

Scores are **per motion**, shape `(*batch,)`, so that callers average over motions or groups as they need; a motion
counts the same however many samples it has. The one pooled score is `rmse`; `motion_rmse` is its per-motion variant.
"""

from eaip_prob.evaluation.comparisons import Gain, Share, bootstrap_gain, paired_gain, success_share
from eaip_prob.evaluation.decodability import explained, identified
from eaip_prob.evaluation.scores import (
    dtw_to_motions,
    gaussian_mixture_nll,
    mahalanobis,
    motion_rmse,
    nll,
    rmse,
    squared_error,
)
from eaip_prob.evaluation.scoring import future_mask
from eaip_prob.evaluation.uncertainty import (
    coverage,
    interval,
    mixture_interval,
    mixture_pit,
    mixture_quantile,
    pit,
)

__all__ = [
    "Gain",
    "Share",
    "bootstrap_gain",
    "coverage",
    "dtw_to_motions",
    "explained",
    "future_mask",
    "gaussian_mixture_nll",
    "identified",
    "interval",
    "mahalanobis",
    "mixture_interval",
    "mixture_pit",
    "mixture_quantile",
    "motion_rmse",
    "nll",
    "paired_gain",
    "pit",
    "rmse",
    "squared_error",
    "success_share",
]

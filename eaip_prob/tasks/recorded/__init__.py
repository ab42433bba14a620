"""Tasks that were recorded from real people: predictions of motions of people who were left out of the fit.

What both experiments share: folds over groups, beginnings of each motion's own duration, scores and gains (`study`),
and their figures and recordings (`pictures`).
"""

from eaip_prob.tasks.recorded.study import (
    GAINS,
    Example,
    Fold,
    Measured,
    Study,
    beginning,
    consecutive_folds,
    measured,
    studied,
)

__all__ = [
    "GAINS",
    "Example",
    "Fold",
    "Measured",
    "Study",
    "beginning",
    "consecutive_folds",
    "measured",
    "studied",
]

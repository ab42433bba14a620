"""Tasks that were recorded from real people: predictions of motions of people who were left out of the fit.

What both experiments share: folds over groups and beginnings of each motion's own duration (`folds`), scores and gains
(`study`), what they say (`report`), figures (`pictures`) and recordings for the viewer (`recordings`).
"""

from eaip_prob.tasks.recorded.folds import Fold, beginning, consecutive_folds
from eaip_prob.tasks.recorded.study import GAINS, Example, Measured, Study, measured, studied

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

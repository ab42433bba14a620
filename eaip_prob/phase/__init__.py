"""Clocks: how far along is the partner."""

from eaip_prob.phase.base import AbstractPhaseEstimator, PhaseEstimate
from eaip_prob.phase.dtw import DTWClock
from eaip_prob.phase.elapsed import ElapsedClock, KnownPhase, known_phase
from eaip_prob.phase.expected import ExpectedClock
from eaip_prob.phase.expected_marginal import ExpectedMarginalClock
from eaip_prob.phase.marginal import MarginalClock

__all__ = [
    "AbstractPhaseEstimator",
    "DTWClock",
    "ElapsedClock",
    "ExpectedClock",
    "ExpectedMarginalClock",
    "KnownPhase",
    "MarginalClock",
    "PhaseEstimate",
    "known_phase",
]

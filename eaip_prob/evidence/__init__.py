"""Evidence: the beginning of a motion as an observation of weights."""

from eaip_prob.evidence.base import AbstractEvidence
from eaip_prob.evidence.forcing import ForcingEvidence
from eaip_prob.evidence.position import PositionEvidence

__all__ = ["AbstractEvidence", "ForcingEvidence", "PositionEvidence"]

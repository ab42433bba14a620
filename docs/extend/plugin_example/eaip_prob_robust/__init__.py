"""A joint model for `eaip_prob` that is robust to bad demonstrations."""

from eaip_prob_robust.model import RobustJointModel

__all__ = ["RobustJointModel"]

"""Joint models over blocks of weights, and what the author of another one needs."""

from eaip_prob.models.base import AbstractJointModel, Posterior, conditioned
from eaip_prob.models.covariance import AbstractCovariance, EmpiricalCovariance, ShrinkageCovariance
from eaip_prob.models.gaussian import GaussianJointModel
from eaip_prob.models.kernel import KernelJointModel
from eaip_prob.models.low_rank import LowRankCovariance
from eaip_prob.models.rows import Coordinates, WeightTable

__all__ = [
    "AbstractCovariance",
    "AbstractJointModel",
    "Coordinates",
    "EmpiricalCovariance",
    "GaussianJointModel",
    "KernelJointModel",
    "LowRankCovariance",
    "Posterior",
    "ShrinkageCovariance",
    "WeightTable",
    "conditioned",
]

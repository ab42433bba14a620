"""Joint models over blocks of weights."""

from eaip_prob.models.base import AbstractJointModel, Posterior
from eaip_prob.models.covariance import AbstractCovariance, EmpiricalCovariance, ShrinkageCovariance
from eaip_prob.models.gaussian import GaussianJointModel
from eaip_prob.models.kernel import KernelJointModel
from eaip_prob.models.low_rank import LowRankCovariance

__all__ = [
    "AbstractCovariance",
    "AbstractJointModel",
    "EmpiricalCovariance",
    "GaussianJointModel",
    "KernelJointModel",
    "LowRankCovariance",
    "Posterior",
    "ShrinkageCovariance",
]

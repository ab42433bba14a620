"""Joint models over blocks of weights."""

from eaip_prob.models.base import AbstractJointModel, Posterior
from eaip_prob.models.covariance import AbstractCovariance, EmpiricalCovariance, ShrinkageCovariance
from eaip_prob.models.folds import group_folds
from eaip_prob.models.gaussian import GaussianJointModel

__all__ = [
    "AbstractCovariance",
    "AbstractJointModel",
    "EmpiricalCovariance",
    "GaussianJointModel",
    "Posterior",
    "ShrinkageCovariance",
    "group_folds",
]

"""Conformance kits, for people who extend the package: what each kind of part promises, as tests of any such part."""

from eaip_prob.testing.check import Check
from eaip_prob.testing.joint_model import joint_model_checks

__all__ = ["Check", "joint_model_checks"]

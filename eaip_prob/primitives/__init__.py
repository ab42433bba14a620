"""Movement primitives: motions as weights, and back."""

from eaip_prob.primitives.base import AbstractPrimitive, Boundary, initial_boundary
from eaip_prob.primitives.dmp import DMP
from eaip_prob.primitives.promp import ProMP

__all__ = ["DMP", "AbstractPrimitive", "Boundary", "ProMP", "initial_boundary"]

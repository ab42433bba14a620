"""The simulated task of Sec. 4.1: passing over a rectangle with a mouse cursor."""

from eaip_prob.tasks.passing_over.person import CursorPerson, Intention
from eaip_prob.tasks.passing_over.success import clearance, passed, rise
from eaip_prob.tasks.passing_over.task import PassingOver

__all__ = ["CursorPerson", "Intention", "PassingOver", "clearance", "passed", "rise"]

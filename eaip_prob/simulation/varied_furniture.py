"""Instances of four classes of furniture that differ in size, proportions and parts, for training detectors.

What makes a class is the same in all its instances, and all else is drawn: a chair is a plate on any support with a
back above it, a table a plate on any of the same supports with nothing above it, a stepladder two splayed pairs of
rails with treads, a bookshelf two closed sides with boards between them. Lengths come from wide ranges, which chairs
and tables share where a piece could be either. Of the combinations of two parts, one in five is left to unusual
instances, whose lengths lie in bands around the ranges.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from eaip_prob.errors import InputError
from eaip_prob.simulation.furniture import AbstractObject
from eaip_prob.simulation.meshes import Mesh
from eaip_prob.simulation.varied_boards import bookshelf, stepladder
from eaip_prob.simulation.varied_draw import Draw
from eaip_prob.simulation.varied_plates import chair, table

_NEAR = (0.92, 1.09)  # factors on the lengths of one that is repainted
_ON_SUPPORTS, _OTHERS = {"chair": chair, "table": table}, {"stepladder": stepladder, "bookshelf": bookshelf}


@dataclass(frozen=True, eq=False)
class VariedObject(AbstractObject):
    """A piece of furniture that was drawn, kept as its mesh.

    Args:
        label: its class.
        shape: at the origin, lowest at z = 0, front towards +x.

    Example:
        >>> from eaip_prob.simulation.meshes import box
        >>> VariedObject("table", box((1.0, 1.0, 1.0), (1, 1, 1)).at(z=0.5)).mesh().extent()[:, 2].tolist()
        [0.0, 1.0]
    """

    label: str
    shape: Mesh

    def mesh(self) -> Mesh:
        """The mesh as it was drawn."""
        return self.shape


def varied(label: str, draw: Draw, shared: Draw | None = None) -> VariedObject:
    """An instance of a class.

    Args:
        label: chair, stepladder, table or bookshelf.
        draw: its lengths, parts and colours.
        shared: of a chair's seat and legs or a table's plate and legs, which are then of the size of chairs: from equal
            draws, a chair and a table get the same.

    Raises:
        InputError: another class.

    Example:
        >>> piece = varied("stepladder", Draw(np.random.default_rng(3)))
        >>> bool(0.4 < piece.mesh().extent()[1, 2] < 2.0)
        True
    """
    if label in _ON_SUPPORTS:
        return VariedObject(label, _ON_SUPPORTS[label](draw, shared))
    if label not in _OTHERS:
        raise InputError(f"Expected a class among {sorted([*_ON_SUPPORTS, *_OTHERS])}, got {label!r}.")
    return VariedObject(label, _OTHERS[label](draw))


def repainted(thing: AbstractObject, label: str, draw: Draw) -> VariedObject:
    """A piece of furniture in other colours, one for each of its own, and a little longer or shorter along each axis.

    Args:
        thing: the piece.
        label: its class.
        draw: colours and lengths.

    Example:
        >>> from eaip_prob.simulation.meshes import box
        >>> piece = VariedObject("table", box((1.0, 1.0, 1.0), (1, 1, 1)).at(z=0.5))
        >>> other = repainted(piece, "table", Draw(np.random.default_rng(0))).mesh()
        >>> bool(0.9 < other.extent()[1, 2] < 1.1), len(np.unique(other.color, axis=0))
        (True, 1)
    """
    mesh, first = thing.mesh(), draw.color()
    color = np.array(mesh.color)
    for number, own in enumerate(np.unique(mesh.color, axis=0)):
        color[(mesh.color == own).all(-1)] = draw.color(like=first) if number else first
    factors = np.array([draw.length(*_NEAR) for _ in range(3)])
    return VariedObject(label, replace(mesh, vertices=mesh.vertices * factors, color=color))

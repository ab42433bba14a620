"""Any further object, from a mesh file."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from eaip_prob.config import repository_path
from eaip_prob.errors import DataFileError, MissingDataError
from eaip_prob.simulation.furniture import AbstractObject, check_lengths
from eaip_prob.simulation.meshes import Color, Mesh


@dataclass(frozen=True)
class MeshFile(AbstractObject):
    """A mesh from a file that open3d reads (PLY, STL, OBJ, OFF, GLTF), set on the floor over the origin.

    Args:
        path: of the file; if relative, within the repository.
        scale: length of one unit of the file, m.
        color: of triangles whose corners have no colour in the file, RGB from 0 to 1.

    Raises:
        InputError: a scale not above zero.

    Example:
        >>> MeshFile("no/such.ply").mesh()
        Traceback (most recent call last):
        eaip_prob.errors.MissingDataError: Expected a mesh file at no/such.ply, got no such file. Give its path.
    """

    path: str
    scale: float = 1.0
    color: Color = (0.6, 0.6, 0.6)

    def __post_init__(self) -> None:
        check_lengths(self)

    def mesh(self) -> Mesh:
        """The mesh, its bounding box centred over the origin and lowest at z = 0.

        Raises:
            MissingDataError: no such file.
            DataFileError: open3d finds no triangle in it.
        """
        path = repository_path(self.path)
        if not path.is_file():
            raise MissingDataError(f"Expected a mesh file at {self.path}, got no such file. Give its path.")
        vertices, triangles, colors = _read(path)
        if not len(triangles) or not np.isfinite(vertices).all():
            raise DataFileError(
                f"Expected triangles with finite corners in {self.path}, got {len(triangles)} triangles. Export it "
                "as a triangle mesh (PLY, STL, OBJ, OFF or GLTF)."
            )
        low, high = vertices.min(0), vertices.max(0)
        origin = np.array([(low[0] + high[0]) / 2, (low[1] + high[1]) / 2, low[2]])
        plain = np.tile(np.asarray(self.color, np.float32), (len(triangles), 1))
        color = colors[triangles].mean(1).astype(np.float32).clip(0.0, 1.0) if len(colors) else plain
        return Mesh((vertices - origin) * self.scale, triangles.astype(np.int32), color)


def _read(path: Path) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    import open3d

    with open3d.utility.VerbosityContextManager(open3d.utility.VerbosityLevel.Error):
        mesh = open3d.io.read_triangle_mesh(path)
    return np.asarray(mesh.vertices), np.asarray(mesh.triangles), np.asarray(mesh.vertex_colors)

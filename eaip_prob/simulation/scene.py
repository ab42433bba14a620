"""What stands in a simulated room at one time, ready for rays to be cast into it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from jaxtyping import Float32, Int32

from eaip_prob.errors import InputError
from eaip_prob.simulation.meshes import Mesh

NOTHING = -1


@dataclass(frozen=True, eq=False)
class Part:
    """One thing in a scene, with a label of its own.

    Args:
        name: its label.
        mesh: where it is now.
        tile: edge of the tiles drawn on it, m; 0 for the plain colours of the mesh.

    Example:
        >>> from eaip_prob.simulation.meshes import box
        >>> Part("cube", box((1, 1, 1), (1, 0, 0))).name
        'cube'
    """

    name: str
    mesh: Mesh
    tile: float = 0.0


@dataclass(frozen=True, eq=False)
class Scene:
    """Parts, and one ray tracer for all cameras; a step of a simulation makes a new scene.

    A part's place in `parts` is its instance id in labels; `NOTHING` (-1) is where a ray leaves the scene.

    Args:
        parts: with names of their own.

    Raises:
        InputError: no part, or a name twice.

    Example:
        >>> from eaip_prob.simulation.meshes import box
        >>> scene = Scene([Part("low", box((1, 1, 1), (1, 0, 0))), Part("high", box((1, 1, 1), (0, 1, 0)).at(z=3.0))])
        >>> scene.cast(np.array([[0, 0, 9, 0, 0, -1]], np.float32))["t_hit"].round(5).tolist()
        [5.5]
        >>> scene.index("high")
        1
    """

    parts: Sequence[Part]

    def __post_init__(self) -> None:
        names = [part.name for part in self.parts]
        if not names or len(set(names)) < len(names):
            raise InputError(f"Expected parts with names of their own, got {names}. Rename one.")

    def index(self, name: str) -> int:
        """Instance id of a part.

        Raises:
            InputError: no part of that name.
        """
        names = [part.name for part in self.parts]
        if name not in names:
            raise InputError(f"Expected one of the parts {names}, got {name!r}.")
        return names.index(name)

    @cached_property
    def colors(self) -> Float32[np.ndarray, "faces 3"]:
        """Colours of all triangles, part by part."""
        return np.concatenate([part.mesh.color for part in self.parts]).astype(np.float32)

    @cached_property
    def first_faces(self) -> Int32[np.ndarray, "parts"]:
        """Where the triangles of each part begin in `colors`."""
        return np.cumsum([0] + [len(part.mesh.triangles) for part in self.parts[:-1]]).astype(np.int32)

    def cast(self, rays: Float32[np.ndarray, "*batch 6"]) -> dict[str, np.ndarray]:
        """What rays hit first: t_hit (inf for nothing), geometry_ids, primitive_ids, primitive_normals.

        Args:
            rays: (..., 6), origin and direction; a distance t_hit counts in lengths of the direction.
        """
        hits = self._tracer.cast_rays(_tensor(rays))
        return {name: hits[name].numpy() for name in ("t_hit", "geometry_ids", "primitive_ids", "primitive_normals")}

    def occluded(self, rays: Float32[np.ndarray, "*batch 6"]) -> np.ndarray:
        """Whether something stands between the origin of a ray and the tip of its direction.

        Args:
            rays: (..., 6).
        """
        return self._tracer.test_occlusions(_tensor(rays), tnear=0.0, tfar=1.0).numpy()

    @cached_property
    def _tracer(self) -> Any:
        import open3d

        tracer = open3d.t.geometry.RaycastingScene()
        for part in self.parts:
            vertices = open3d.core.Tensor.from_numpy(np.ascontiguousarray(part.mesh.vertices, np.float32))
            triangles = open3d.core.Tensor.from_numpy(np.ascontiguousarray(part.mesh.triangles, np.uint32))
            tracer.add_triangles(vertices, triangles)
        return tracer


def _tensor(rays: np.ndarray) -> Any:
    import open3d

    return open3d.core.Tensor.from_numpy(np.ascontiguousarray(rays, np.float32))

"""Images of a scene by ray casting: exact depth and labels, and colour with shadows.

A ray's direction has length one along the camera's z axis, so that the distance at which it hits is the depth.
Light: Lambert and a highlight (Blinn, 1977) from one lamp with shadows, and a sky that brightens what faces up.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from jaxtyping import Bool, Float, Float32, Int32, UInt8

from eaip_prob.data.frames import Intrinsics, check_transform
from eaip_prob.errors import InputError
from eaip_prob.simulation.scene import NOTHING, Scene

_SHADOW_OFFSET = 0.003  # metres along the normal, or a surface would shade itself
_GROUT = 0.012  # metres between tiles


@dataclass(frozen=True, eq=False)
class View:
    """A camera in its place; its rays are computed once.

    Args:
        intrinsics: with the distortion of the lens.
        T_world_camera: (4, 4), maps camera coordinates into the world.

    Example:
        >>> View(Intrinsics(4, 3, 4.0, 4.0, 1.5, 1.0), np.eye(4)).rays.shape
        (3, 4, 6)
    """

    intrinsics: Intrinsics
    T_world_camera: Float[np.ndarray, "4 4"]

    def __post_init__(self) -> None:
        check_transform("T_world_camera", self.T_world_camera)

    @cached_property
    def rays(self) -> Float32[np.ndarray, "height width 6"]:
        """Origin and direction of every pixel's ray in the world."""
        slopes = self.intrinsics.rays
        local = np.concatenate([slopes, np.ones((*slopes.shape[:2], 1))], -1)
        directions = local @ self.T_world_camera[:3, :3].T
        return np.concatenate([np.broadcast_to(self.T_world_camera[:3, 3], directions.shape), directions], -1).astype(
            np.float32
        )


@dataclass(frozen=True)
class Lighting:
    """One lamp and the light that comes from everywhere; brightness 1 shows a surface in its own colour.

    Args:
        lamp: (3,), where the lamp hangs in the world, m.
        ambient: brightness of what faces down.
        sky: brightness added to what faces up.
        lamp_light: brightness added to what faces the lamp.
        highlight: brightness of a highlight, of any colour's surface alike.
        background: RGB from 0 to 1, where there is nothing.

    Raises:
        InputError: a brightness below zero.

    Example:
        >>> Lighting(lamp=(0.0, 0.0, 2.0)).ambient
        0.35
    """

    lamp: Sequence[float] = (0.2, 0.9, 1.55)
    ambient: float = 0.35
    sky: float = 0.2
    lamp_light: float = 0.55
    highlight: float = 0.12
    background: Sequence[float] = (0.55, 0.57, 0.6)

    def __post_init__(self) -> None:
        levels = {name: getattr(self, name) for name in ("ambient", "sky", "lamp_light", "highlight")}
        if min(levels.values()) < 0.0:
            raise InputError(f"Expected brightness of at least zero, got {levels}.")


@dataclass(frozen=True, eq=False)
class Labels:
    """What every pixel of a view truly shows.

    Args:
        depth: (H, W), along z, m; infinite where there is nothing.
        instance: (H, W), index of the part, -1 where there is nothing.
        normal: (H, W, 3), of the surface in the world, towards the camera.
        incidence: (H, W), angle between the ray and the normal, rad.

    Example:
        >>> far = np.full((1, 1), np.inf, np.float32)
        >>> nothing = Labels(far, np.full((1, 1), -1, np.int32), np.zeros((1, 1, 3), np.float32), np.zeros_like(far))
        >>> bool(nothing.hit.any())
        False
    """

    depth: Float32[np.ndarray, "height width"]
    instance: Int32[np.ndarray, "height width"]
    normal: Float32[np.ndarray, "height width 3"]
    incidence: Float32[np.ndarray, "height width"]

    @property
    def hit(self) -> Bool[np.ndarray, "height width"]:
        """Where there is something."""
        return self.instance != NOTHING


def render_depth(scene: Scene, view: View) -> Labels:
    """Depth, instance and normal at every pixel, without noise.

    Args:
        scene: what is there.
        view: the camera.

    Example:
        >>> from eaip_prob.simulation import Part, box
        >>> scene = Scene([Part("wall", box((4.0, 4.0, 1.0), (1, 1, 1)).at(z=2.5))])
        >>> float(render_depth(scene, View(Intrinsics(4, 3, 4.0, 4.0, 1.5, 1.0), np.eye(4))).depth.mean().round(5))
        2.0
    """
    hits = scene.cast(view.rays)
    directions = view.rays[..., 3:]
    instance = hits["geometry_ids"].view(np.int32)  # the tracer's invalid id, all bits set, reads as -1
    normal = hits["primitive_normals"]
    along = np.einsum("hwc,hwc->hw", normal, directions)
    normal = normal * -np.sign(along)[..., None]
    length = np.sqrt(np.einsum("hwc,hwc->hw", directions, directions))
    incidence = np.arccos(np.minimum(np.abs(along) / length, 1.0))
    return Labels(hits["t_hit"], instance, normal, np.where(instance == NOTHING, np.float32(0.0), incidence))


def render_color(
    scene: Scene, view: View, lighting: Lighting | None = None, oversample: int = 1
) -> UInt8[np.ndarray, "height width 3"]:
    """What a colour camera sees, RGB, without noise.

    Args:
        scene: what is there.
        view: the camera.
        lighting: as `Lighting()` if None.
        oversample: n, for n by n rays a pixel: smooth edges, for n squared times the time.

    Raises:
        InputError: `oversample` below one.

    Example:
        >>> from eaip_prob.simulation import Part, box
        >>> scene = Scene([Part("wall", box((4.0, 4.0, 1.0), (1, 0, 0)).at(z=2.5))])
        >>> image = render_color(scene, View(Intrinsics(4, 3, 4.0, 4.0, 1.5, 1.0), np.eye(4)))
        >>> image.shape, bool((image[..., 0] > image[..., 1]).all())
        ((3, 4, 3), True)
    """
    if oversample < 1:
        raise InputError(f"Expected oversample of at least 1, got {oversample}.")
    lighting = lighting or Lighting()
    steps = (np.arange(oversample) + 0.5) / oversample - 0.5
    total = np.zeros((view.intrinsics.height, view.intrinsics.width, 3), np.float32)
    for down in steps:
        for along in steps:
            total += _shaded(scene, _shifted(view, along, down) if oversample > 1 else view, lighting)
    return (np.minimum(total / oversample**2, 1.0) * 255.0 + 0.5).astype(np.uint8)


def _shifted(view: View, along: float, down: float) -> View:
    camera = view.intrinsics
    return View(replace(camera, cx=camera.cx - along, cy=camera.cy - down), view.T_world_camera)


def _shaded(scene: Scene, view: View, lighting: Lighting) -> Float32[np.ndarray, "height width 3"]:
    from eaip_prob.simulation._shading import shade, shadow_rays

    rays = view.rays.reshape(-1, 6)
    hits = scene.cast(rays)
    part, distance, normals = hits["geometry_ids"].view(np.int32), hits["t_hit"], hits["primitive_normals"]
    # The background is the last entry.
    faces = np.where(part == NOTHING, np.int32(-1), scene.first_faces[part] + hits["primitive_ids"].view(np.int32))
    image = np.concatenate([scene.colors, np.asarray([lighting.background], np.float32)])[faces]
    _draw_tiles(scene, part, rays, distance, image)
    lamp = np.asarray(lighting.lamp, np.float32)
    to_lamp, facing = shadow_rays(rays, distance, normals, lamp, np.float32(_SHADOW_OFFSET))
    levels = (lighting.ambient, lighting.sky, lighting.lamp_light, lighting.highlight)
    shade(rays, distance, normals, image, lamp, facing, scene.occluded(to_lamp), levels)
    return image.reshape(view.intrinsics.height, view.intrinsics.width, 3)


def _draw_tiles(scene: Scene, part: np.ndarray, rays: np.ndarray, distance: np.ndarray, color: np.ndarray) -> None:
    for index, tiled in enumerate(scene.parts):
        if tiled.tile:
            here = np.flatnonzero(part == index)
            cell = (rays[here, :2] + distance[here, None] * rays[here, 3:5]) / np.float32(tiled.tile)
            whole = np.floor(cell)
            grout = (cell - whole < np.float32(_GROUT / tiled.tile)).any(1)
            odd = (whole.sum(1) % 2 > 0).astype(np.float32)
            color[here] *= np.where(grout, np.float32(0.75), 1.0 - np.float32(0.06) * odd)[:, None]

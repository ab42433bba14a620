"""The loops over pixels in which colour is computed, compiled: in numpy they take four times as long as the rays."""

from __future__ import annotations

import math

import numpy as np
from numba import njit

_FAR_AWAY = 1e6  # metres; a ray from there meets nothing


@njit(cache=True)
def shadow_rays(rays, distance, normals, lamp, offset):
    """(rays, facing): from each hit point to the lamp, and the cosine at which the lamp is seen; 0 where it is behind.

    Args:
        rays: (N, 6), origin and direction.
        distance: (N,), in lengths of the direction; infinite where nothing was hit.
        normals: (N, 3), to either side.
        lamp: (3,), m.
        offset: by which a shadow ray starts above the surface, m.
    """
    to_lamp = np.empty_like(rays)
    facing = np.zeros(len(rays), np.float32)
    for i in range(len(rays)):
        for k in range(3):
            to_lamp[i, k], to_lamp[i, 3 + k] = np.float32(_FAR_AWAY), np.float32(0.001)
        if not math.isfinite(distance[i]):
            continue
        along, cosine, length = 0.0, 0.0, 0.0
        for k in range(3):
            along += normals[i, k] * rays[i, 3 + k]
        side = np.float32(-1.0) if along > 0 else np.float32(1.0)
        for k in range(3):
            toward = lamp[k] - (rays[i, k] + distance[i] * rays[i, 3 + k])
            cosine += side * normals[i, k] * toward
            length += toward * toward
        if cosine <= 0.0:
            continue
        facing[i] = cosine / math.sqrt(length)
        for k in range(3):
            start = rays[i, k] + distance[i] * rays[i, 3 + k] + offset * side * normals[i, k]
            to_lamp[i, k], to_lamp[i, 3 + k] = start, lamp[k] - start
    return to_lamp, facing


@njit(cache=True)
def shade(rays, distance, normals, color, lamp, facing, hidden, levels):
    """Colour of each hit point, written over its colour in plain light; where nothing was hit it stays.

    Args:
        rays: (N, 6), as `shadow_rays`.
        distance: (N,), as `shadow_rays`.
        normals: (N, 3), as `shadow_rays`.
        color: (N, 3), RGB; written.
        lamp: (3,), m.
        facing: (N,), from `shadow_rays`.
        hidden: (N,), whether something stands before the lamp.
        levels: brightness of (ambient, sky, lamp, highlight).
    """
    ambient, sky, light, highlight = levels
    for i in range(len(rays)):
        if not math.isfinite(distance[i]):
            continue
        along, length = 0.0, 0.0
        for k in range(3):
            along += normals[i, k] * rays[i, 3 + k]
            length += rays[i, 3 + k] * rays[i, 3 + k]
        side = -1.0 if along > 0 else 1.0
        brightness = ambient + sky * max(side * normals[i, 2], 0.0)
        gloss = 0.0
        if facing[i] > 0.0 and not hidden[i]:
            brightness += light * facing[i]
            reach, size = 0.0, 0.0
            for k in range(3):
                reach += (lamp[k] - rays[i, k] - distance[i] * rays[i, 3 + k]) ** 2
            for k in range(3):
                toward = (lamp[k] - rays[i, k] - distance[i] * rays[i, 3 + k]) / math.sqrt(reach)
                half = toward - rays[i, 3 + k] / math.sqrt(length)
                gloss += side * normals[i, k] * half
                size += half * half
            gloss = max(gloss, 0.0) / math.sqrt(size)
            for _ in range(5):
                gloss = gloss * gloss
        for k in range(3):
            color[i, k] = color[i, k] * brightness + highlight * gloss

"""Compiled loop behind `detection.placing`: depth pixels on surfaces as points in the world."""

from __future__ import annotations

import numpy as np
from numba import njit


@njit(cache=True, nogil=True)
def steady_points(depth, valid, rays, stride, step, least, T_world_camera, lowest):
    """(N, 3) points, m, of every `stride`-th pixel that has `least` neighbours at its depth, above a height, m.

    Others lie in the air, between an edge and what is behind. Neighbours are at a pixel's depth if they differ by less
    than the share `step` of it. `rays` (rows, columns, 2) are those of the pixels that are looked at.
    """
    rows, columns = rays.shape[:2]
    height, width = depth.shape
    points, count = np.empty((rows * columns, 3)), 0
    for row in range(rows):
        for column in range(columns):
            i, j = row * stride, column * stride
            if not valid[i, j]:
                continue
            z = np.float64(depth[i, j])
            x, y = rays[row, column, 0] * z, rays[row, column, 1] * z
            up = T_world_camera[2, 0] * x + T_world_camera[2, 1] * y + T_world_camera[2, 2] * z + T_world_camera[2, 3]
            if not up > lowest:
                continue
            near = 0
            for other in range(max(i - 1, 0), min(i + 2, height)):
                for beside in range(max(j - 1, 0), min(j + 2, width)):
                    # The pixel itself is one of those counted.
                    near += valid[other, beside] and abs(depth[other, beside] - z) < step * z
            if near <= least:
                continue
            for axis in range(2):
                points[count, axis] = (
                    T_world_camera[axis, 0] * x
                    + T_world_camera[axis, 1] * y
                    + T_world_camera[axis, 2] * z
                    + T_world_camera[axis, 3]
                )
            points[count, 2] = up
            count += 1
    return points[:count].copy()

"""Compiled loops behind `perception.registration`: unchecked arrays in, results written to the arrays meant for them.

`lens` is (fx, fy, cx, cy, k1, k2, p1, p2, k3, largest radius) of the colour camera, `motion` the upper three rows of
T_color_depth, `window` the first and one past the last row and column of depth pixels that are looked at.
"""

from __future__ import annotations

import math

from numba import njit

NOWHERE = -1.0e9


@njit(cache=True, nogil=True)
def project_window(depth, valid, rays, motion, lens, window, places, nearest, cell):
    """Writes (column, row, z) in the colour camera to `places` (H, W, 3), and the nearest z to cells of its image.

    A point covers the four cells around it, so that a surface leaves no holes where pixels and cells beat.
    """
    per_cell = 1.0 / cell
    for row in range(window[0], window[1]):
        for column in range(window[2], window[3]):
            places[row, column, 0] = NOWHERE
            if not valid[row, column]:
                continue
            u, v, z = _image_of(rays[row, column, 0], rays[row, column, 1], depth[row, column], motion, lens)
            places[row, column, 0] = u
            places[row, column, 1] = v
            places[row, column, 2] = z
            if u != NOWHERE:
                _lower(
                    nearest, int(math.floor((v + 0.5) * per_cell - 0.5)), int(math.floor((u + 0.5) * per_cell - 0.5)), z
                )


@njit(cache=True, nogil=True, inline="always")
def _lower(nearest, top, left, z):
    """Lowers the four cells from (top, left) on, those that are there, to z."""
    num_rows, num_columns = nearest.shape
    if 0 <= top < num_rows - 1 and 0 <= left < num_columns - 1:
        nearest[top, left] = min(nearest[top, left], z)
        nearest[top, left + 1] = min(nearest[top, left + 1], z)
        nearest[top + 1, left] = min(nearest[top + 1, left], z)
        nearest[top + 1, left + 1] = min(nearest[top + 1, left + 1], z)
        return
    for i in range(max(top, 0), min(top + 2, num_rows)):
        for j in range(max(left, 0), min(left + 2, num_columns)):
            nearest[i, j] = min(nearest[i, j], z)


@njit(cache=True, nogil=True)
def take_colors(pixels, places, nearest, cell, color, slack, least, colors, seen):
    """Colours (P, 3) of flat places (P,) whose point no other lies before, by more than max(least, slack z^2)."""
    height, width = color.shape[:2]
    num_columns = places.shape[1]
    for index in range(len(pixels)):
        u, v, z = places[pixels[index] // num_columns, pixels[index] % num_columns]
        if not (-0.5 <= u < width - 0.5 and -0.5 <= v < height - 0.5):
            continue
        at_u, at_v = int(u + 0.5), int(v + 0.5)
        if z - nearest[at_v // cell, at_u // cell] <= max(least, slack * z * z):
            for channel in range(3):
                colors[index, channel] = color[at_v, at_u, channel]
            seen[index] = True


@njit(cache=True, nogil=True, inline="always")
def _image_of(x, y, z, motion, lens):
    """(column, row, z) in the colour camera of a depth pixel's point; NOWHERE behind it or beyond its lens."""
    X, Y = x * z, y * z
    z_c = motion[2, 0] * X + motion[2, 1] * Y + motion[2, 2] * z + motion[2, 3]
    if z_c <= 0.0:
        return NOWHERE, NOWHERE, z_c
    x = (motion[0, 0] * X + motion[0, 1] * Y + motion[0, 2] * z + motion[0, 3]) / z_c
    y = (motion[1, 0] * X + motion[1, 1] * Y + motion[1, 2] * z + motion[1, 3]) / z_c
    r2 = x * x + y * y
    if r2 > lens[9] * lens[9]:
        return NOWHERE, NOWHERE, z_c
    radial = 1.0 + r2 * (lens[4] + r2 * (lens[5] + r2 * lens[8]))
    u = x * radial + 2.0 * lens[6] * x * y + lens[7] * (r2 + 2.0 * x * x)
    v = y * radial + lens[6] * (r2 + 2.0 * y * y) + 2.0 * lens[7] * x * y
    return lens[0] * u + lens[2], lens[1] * v + lens[3], z_c

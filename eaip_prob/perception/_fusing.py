"""Compiled loops behind `perception.fusion`: unchecked arrays in, results written to the arrays meant for them."""

from __future__ import annotations

import math

import numpy as np
from numba import njit

KEY_BITS = 21  # of a voxel's place along an axis
HALF = 2 ** (KEY_BITS - 1)
MIX = -7046029254386353131  # 2^64 over the golden ratio, as a signed integer: spreads keys of neighbours


@njit(cache=True, nogil=True)
def crop_points(depth, valid, rays, pose, bounds, points, places):
    """Number of valid pixels within bounds (3, 2), m, whose world points and flat places were written."""
    count = 0
    height, width = depth.shape
    for row in range(height):
        for column in range(width):
            if not valid[row, column]:
                continue
            z = depth[row, column]
            x, y = rays[row, column, 0] * z, rays[row, column, 1] * z
            inside = True
            for axis in range(3):
                value = pose[axis, 0] * x + pose[axis, 1] * y + pose[axis, 2] * z + pose[axis, 3]
                points[count, axis] = value
                inside &= bounds[axis, 0] <= value < bounds[axis, 1]
            if inside:
                places[count] = row * width + column
                count += 1
    return count


@njit(cache=True, nogil=True)
def merge_voxels(points, colors, seen, weight, voxel, table, sums, count, half):
    """Number of voxels, `count` before; adds up in `sums` (N, 8) weighted x, y, z, weight, red, green, blue, number.

    Only voxels of one half (0 or 1) count, so that both halves can be merged at one time.
    `table` (a power of two, 2), all -1, is a hash table from a voxel's key to its row: eight sums lie together, since
    what this costs is memory that is not in the cache.
    """
    row, before = 0, np.int64(-1)
    shift = 64 - int(round(math.log2(len(table))))
    for i in range(len(points)):
        key = np.int64(0)
        for axis in range(3):
            key = (key << KEY_BITS) | (np.int64(math.floor(points[i, axis] / voxel)) + HALF)
        if ((key * MIX) >> 20) & 1 != half:
            continue
        row = row if key == before else _row(key, table, shift, count)
        before, count = key, max(count, row + 1)
        for axis in range(3):
            sums[row, axis] += weight[i] * points[i, axis]
        sums[row, 3] += weight[i]
        if seen[i]:
            for channel in range(3):
                sums[row, 4 + channel] += colors[i, channel]
            sums[row, 7] += 1.0
    return count


@njit(cache=True, nogil=True, inline="always")
def _row(key, table, shift, count):
    """The key's row; `count`, the next free one, for a key that is new."""
    last = len(table) - 1
    at = ((key * MIX) >> shift) & last  # the highest bits: only they depend on all of the key
    while table[at, 0] != key and table[at, 0] != -1:
        at = (at + 1) & last
    if table[at, 0] == -1:
        table[at, 0], table[at, 1] = key, count
    return table[at, 1]

"""Compiled loops behind `simulation.cloth`: unchecked arrays in, results written to the arrays meant for them.

Position-based dynamics (Mueller et al., 2007) in many short substeps of one pass each, which stiffens a cloth faster
than many passes over a long one (Macklin et al., 2019). Edges are put right by Jakobsen's formula (2001), which needs
no root. Letters: V vertices, E edges, F triangles, K planes.
"""

from __future__ import annotations

import math

import numpy as np
from numba import njit

# Overrelaxation of stretched edges; from 4/3 on, an edge between free vertices would swing up.
_RELAXED = 1.1
# Share by which an edge that is too short is pushed: cloth buckles, but is no point.
_COMPRESSED = 0.1
# Share by which a triangle is put out of the body in one substep: with all of it, vertices and centres take turns.
_SOFT = 0.3
# Below this cosine between a triangle and a plane it is the plane that says where out is.
_FLAT = 0.5

_compiled = njit(cache=True, nogil=True, error_model="numpy", fastmath={"contract", "arcp", "nsz"})


@_compiled
def advance(position, velocity, free, held, start, end, edges, rest, triangles, planes, floor, material, h, num):
    """Carries position and velocity (V, 3) through `num` substeps of h, s.

    `free` (V,) is 0 for the vertices `held` (n,), which go from `start` to `end` (n, 3), and 1 for others.
    `material`: gravity, drag, friction, thickness.
    """
    gravity, drag, friction, thickness = material
    previous = np.empty_like(position)
    vertex_plane, centre_plane = np.zeros(len(position), np.int64), np.zeros(len(triangles), np.int64)
    kept = math.exp(-drag * h)
    for step in range(1, num + 1):
        fall(position, previous, velocity, free, gravity * h, kept, h)
        for n in range(len(held)):
            for k in range(3):
                position[held[n], k] = start[n, k] + (end[n, k] - start[n, k]) * (step / num)
                if step == num:
                    position[held[n], k] = end[n, k]
        straighten(position, free, edges, rest)
        put_centres_out(position, previous, free, triangles, planes, floor, thickness, centre_plane)
        put_vertices_out(position, previous, free, planes, floor, thickness, friction, vertex_plane)
        for i in range(len(position)):
            for k in range(3):
                velocity[i, k] = (position[i, k] - previous[i, k]) / h


@_compiled
def fall(position, previous, velocity, free, faster, kept, h):
    """Moves free vertices as if nothing held them; `previous` (V, 3) becomes where all were."""
    for i in range(len(position)):
        velocity[i, 2] -= faster
        for k in range(3):
            previous[i, k] = position[i, k]
            position[i, k] += free[i] * h * kept * velocity[i, k]


@_compiled
def straighten(position, free, edges, rest):
    """One pass over edges (E, 2): stretched ones are pulled to `rest` (E,), short ones pushed a little."""
    for e in range(len(edges)):
        i, j = edges[e, 0], edges[e, 1]
        weight = free[i] + free[j]
        if weight == 0.0:
            continue
        half = 0.5 if weight == 2.0 else 1.0
        x = position[j, 0] - position[i, 0]
        y = position[j, 1] - position[i, 1]
        z = position[j, 2] - position[i, 2]
        square, wanted = x * x + y * y + z * z, rest[e] * rest[e]
        change = (1.0 - 2.0 * wanted / (square + wanted)) * (_RELAXED if square > wanted else _COMPRESSED)
        left, right = free[i] * half * change, free[j] * half * change
        position[i, 0] += left * x
        position[i, 1] += left * y
        position[i, 2] += left * z
        position[j, 0] -= right * x
        position[j, 1] -= right * y
        position[j, 2] -= right * z


@_compiled
def behind(x, y, z, plane, margin):
    """How far a point is behind a plane (4,) that a margin moved outwards, m; below zero before it."""
    return margin + plane[3] - plane[0] * x - plane[1] * y - plane[2] * z


@_compiled
def nearest_plane(x, y, z, planes, margin, first):
    """(index, depth) of the plane through which a point leaves the body thickened by a margin; depth <= 0 outside.

    `first` is tried first: what separated a point from the body a moment ago mostly still does.
    """
    if len(planes) == 0:
        return first, -1.0
    best, depth = first, behind(x, y, z, planes[first], margin)
    if depth > 0.0:
        for p in range(len(planes)):
            here = behind(x, y, z, planes[p], margin)
            if here < depth:
                best, depth = p, here
                if depth <= 0.0:
                    break
    return best, depth


@_compiled
def put_vertices_out(position, previous, free, planes, floor, margin, friction, planes_of):
    """Moves vertices out of the body along the nearest plane, and above the floor, with Coulomb's friction."""
    for i in range(len(position)):
        if free[i] == 0.0:
            continue
        x, y, z = position[i, 0], position[i, 1], position[i, 2]
        planes_of[i], depth = nearest_plane(x, y, z, planes, margin, planes_of[i])
        if depth > 0.0:
            p = planes_of[i]
            _touch(position[i], previous[i], planes[p, 0], planes[p, 1], planes[p, 2], planes[p, 3] + margin, friction)
        if position[i, 2] < floor + margin:
            _touch(position[i], previous[i], 0.0, 0.0, 1.0, floor + margin, friction)


@_compiled
def _touch(point, before, a, b, c, offset, friction):
    depth = offset - a * point[0] - b * point[1] - c * point[2]
    # To come out of where it was too deep before is no motion: else the vertex would be shot out.
    buried = max(offset - a * before[0] - b * before[1] - c * before[2], 0.0)
    for k, n in ((0, a), (1, b), (2, c)):
        point[k] += depth * n
        before[k] += buried * n
    x, y, z = point[0] - before[0], point[1] - before[1], point[2] - before[2]
    along = a * x + b * y + c * z
    x, y, z = x - along * a, y - along * b, z - along * c
    slid = math.sqrt(x * x + y * y + z * z)
    if slid > 0.0:
        held = min(friction * depth / slid, 1.0)
        point[0] -= held * x
        point[1] -= held * y
        point[2] -= held * z


@_compiled
def put_centres_out(position, previous, free, triangles, planes, floor, margin, planes_of):
    """Moves triangles (F, 3) whose centre is in the body, or under the floor, out of it as a whole."""
    for t in range(len(triangles)):
        a, b, c = triangles[t, 0], triangles[t, 1], triangles[t, 2]
        x = (position[a, 0] + position[b, 0] + position[c, 0]) / 3.0
        y = (position[a, 1] + position[b, 1] + position[c, 1]) / 3.0
        z = (position[a, 2] + position[b, 2] + position[c, 2]) / 3.0
        planes_of[t], depth = nearest_plane(x, y, z, planes, margin, planes_of[t])
        if depth > 0.0:
            way = way_out(position, a, b, c, planes[planes_of[t]])
            _lift(position, previous, free, (a, b, c), way, _SOFT * _length_out(x, y, z, planes, margin, way))
        if z < floor + margin:
            _lift(position, previous, free, (a, b, c), (0.0, 0.0, 1.0), floor + margin - z)


@_compiled
def way_out(position, a, b, c, plane):
    """Unit normal of a triangle on the side of a plane's; the plane's own where the triangle stands across it.

    A push along its own normal does not hold the cloth back where it slides over an edge of the body.
    """
    e0, e1, e2 = position[b, 0] - position[a, 0], position[b, 1] - position[a, 1], position[b, 2] - position[a, 2]
    f0, f1, f2 = position[c, 0] - position[a, 0], position[c, 1] - position[a, 1], position[c, 2] - position[a, 2]
    x, y, z = e1 * f2 - e2 * f1, e2 * f0 - e0 * f2, e0 * f1 - e1 * f0
    size = math.sqrt(x * x + y * y + z * z)
    along = x * plane[0] + y * plane[1] + z * plane[2]
    if abs(along) <= _FLAT * size:
        return plane[0], plane[1], plane[2]
    size = math.copysign(size, along)
    return x / size, y / size, z / size


@_compiled
def _length_out(x, y, z, planes, margin, way):
    length = np.inf
    for p in range(len(planes)):
        speed = planes[p, 0] * way[0] + planes[p, 1] * way[1] + planes[p, 2] * way[2]
        if speed > 0.0:
            length = min(length, behind(x, y, z, planes[p], margin) / speed)
    return length


@_compiled
def _lift(position, previous, free, corners, way, length):
    risen = length
    for n in corners:
        for k in range(3):
            risen += (position[n, k] - previous[n, k]) * way[k] / 3.0
    # As for vertices: what the push adds beyond stopping the triangle is no motion.
    back = min(max(risen, 0.0), length)
    for n in corners:
        for k in range(3):
            position[n, k] += free[n] * length * way[k]
            previous[n, k] += free[n] * back * way[k]

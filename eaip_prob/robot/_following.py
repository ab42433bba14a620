"""Compiled loops behind `robot.inverse`: which joint angles lead the tip along a path of points.

With J the Jacobian, e the way to the target, W the speeds of the joints (the largest is 1), r a change of joint angles
that is wished for and l the damping, one step is r + W J^T (J W J^T + l I)^-1 (e - J r): of all that lead to the target
the one nearest to r, where slow joints count more (Wampler, IEEE Trans. SMC 16(1), 1986; damping that grows with the
squared distance: Sugihara, IEEE Trans. Robotics 27(5), 2011).

Unchecked arrays in, results written to the arrays meant for them. `arm` (J + 2, 12) holds a row for each joint, then
the transforms of mount and tool, flat. All is in one file, because numba's cache looks only at the file of a function.
"""

from __future__ import annotations

import math

import numpy as np
from numba import njit

NEAR = 1e-6  # m; a sample is solved when the tip is that close
REACHED = 1e-3  # m; and reached when it is that close
PULLED = 12  # steps that also go to the posture; where they do not get near, the target alone is approached
APPROACHED = 60  # steps of that
DAMPING = 0.1  # share of the squared distance to the target
LEAST_DAMPING = 1e-9  # m^2; keeps the step of a straight arm finite
STALLED = 1e-3  # share of the distance; less won in each of three steps means that no more is to be had
FADING = 0.5  # m; over that way of the tip the distance to the posture falls to 1 / e, where the path lets it
SETTLING, SETTLED = 32, 0.2  # solutions of a cold start's first sample, and how far each goes towards the posture
SAME = 0.05  # rad; starts that close are one
CALM = 0.1  # s, that the longest step takes at full speed; with no longer one, no other start is tried

D, A, COS, SIN, THETA0, LOWER, UPPER, SPEED, POSTURE, WEIGHT = range(10)  # columns of `arm`
ORIGIN, STEP, FREE, AWAY, ROOM = 3, 6, 7, 8, 9  # rows of the room for work, after the Jacobian, and their number


@njit(cache=True, nogil=True)
def best_path(arm, path, seeds, joints, error):
    """Fills joints (T, J) and error (T,) with the path from one of the seeds (N, J) that reaches most.

    The first that reaches all and turns calmly will do; of several that reach all it is the calmest. Overwrites the
    seeds by the starts they lead to.
    """
    trial, miss = np.empty_like(joints), np.empty_like(error)
    work = np.empty((ROOM, max(3, joints.shape[1])))
    best_reached, best_miss, best_speed = -1, np.inf, np.inf
    for n in range(len(seeds)):
        for _ in range(SETTLING):
            if _solve(arm, path[0], seeds[n], SETTLED, work) > REACHED:
                break
        if _is_among(seeds[n], seeds[:n]):
            continue
        follow_path(arm, path, seeds[n], trial, miss)
        reached, missed, speed = _worth(arm, trial, miss)
        better = missed < best_miss if reached < len(path) else speed < best_speed
        if reached > best_reached or (reached == best_reached and better):
            best_reached, best_miss, best_speed = reached, missed, speed
            joints[:] = trial
            error[:] = miss
        if best_reached == len(path) and best_speed < CALM:
            break


@njit(cache=True, nogil=True)
def follow_path(arm, path, start, joints, error):
    """Fills joints (T, J) and error (T,) sample by sample, each from the one before, the first from start (J,)."""
    work = np.empty((ROOM, max(3, len(start))))
    q = start.copy()
    way = _look(arm, path[0], q, work)
    for t in range(len(path)):
        if t > 0:
            x, y, z = path[t, 0] - path[t - 1, 0], path[t, 1] - path[t - 1, 1], path[t, 2] - path[t - 1, 2]
            way = math.sqrt(x * x + y * y + z * z)
        error[t] = _solve(arm, path[t], q, 1.0 - math.exp(-way / FADING), work)
        if error[t] > REACHED:
            _try_from_posture(arm, path[t], q, error[t : t + 1], work)
        joints[t] = q


@njit(cache=True, nogil=True)
def _try_from_posture(arm, target, q, error, work):
    """Replaces q (J,) and error (1,) where that reaches the target: an arm that got stuck is not out of reach."""
    other = arm[: len(q), POSTURE].copy()
    distance = _approach(arm, target, other, _look(arm, target, other, work), work)
    if distance <= REACHED:
        q[:] = other
        error[0] = distance


@njit(cache=True, nogil=True)
def _is_among(start, others):
    near = False
    for n in range(len(others)):
        near |= np.abs(start - others[n]).max() < SAME
    return near


@njit(cache=True, nogil=True)
def _worth(arm, joints, error):
    """(samples reached, sum of the errors in m, s that the longest step takes at full speed) of one path."""
    reached, missed, largest = 0, 0.0, 0.0
    for t in range(len(joints)):
        reached += error[t] <= REACHED
        missed += error[t]
        if t > 0:
            for i in range(joints.shape[1]):
                largest = max(largest, abs(joints[t, i] - joints[t - 1, i]) / arm[i, SPEED])
    return reached, missed, largest


@njit(cache=True, nogil=True)
def _solve(arm, target, q, pull, work):
    """Moves q (J,) until the tip is at the target (3,), if it can be; returns the distance left, m.

    On the way there q goes `pull` of its way to the posture, as far as the target leaves it free.
    """
    before = q.copy()
    goal = q + pull * (arm[: len(q), POSTURE] - q)
    distance = _look(arm, target, q, work)
    for _ in range(PULLED):
        _find_step(arm, q, distance, DAMPING, goal - q, work)
        _take_step(arm, q, work)
        distance = _look(arm, target, q, work)
        if distance < NEAR:
            return distance
    q[:] = before  # the posture's pull would keep it from going as far as it can
    return _approach(arm, target, q, _look(arm, target, q, work), work)


@njit(cache=True, nogil=True)
def _approach(arm, target, q, distance, work):
    """Levenberg-Marquardt: a step that leads away from the target is taken back and tried again with more damping."""
    damping, stalls = DAMPING, 0
    nowhere = np.zeros(len(q))
    for _ in range(APPROACHED):
        good = q.copy()
        _find_step(arm, q, distance, damping, nowhere, work)
        _take_step(arm, q, work)
        new = _look(arm, target, q, work)
        stalls = stalls + 1 if distance - new < STALLED * distance else 0
        if new < distance:
            distance, damping = new, max(DAMPING, 0.3 * damping)
        else:
            damping *= 10.0
            q[:] = good
            _look(arm, target, q, work)
        if distance < NEAR or stalls == 3:
            break
    return distance


@njit(cache=True, nogil=True)
def _take_step(arm, q, work):
    for i in range(len(q)):
        q[i] = min(max(q[i] + work[STEP, i], arm[i, LOWER]), arm[i, UPPER])


@njit(cache=True, nogil=True)
def _look(arm, target, q, work):
    """Distance of the tip from the target (3,), m; fills the Jacobian and the way that is left."""
    mount, tool = arm[len(q)], arm[len(q) + 1]
    # Columns of the frame that was reached: its axes x, y, z and its origin p, with a letter for each component.
    xx, xy, xz = mount[0], mount[4], mount[8]
    yx, yy, yz = mount[1], mount[5], mount[9]
    zx, zy, zz = mount[2], mount[6], mount[10]
    px, py, pz = mount[3], mount[7], mount[11]
    for i in range(len(q)):
        work[0, i], work[1, i], work[2, i] = zx, zy, zz
        work[ORIGIN, i], work[ORIGIN + 1, i], work[ORIGIN + 2, i] = px, py, pz
        c, s = math.cos(q[i] + arm[i, THETA0]), math.sin(q[i] + arm[i, THETA0])
        xx, yx = c * xx + s * yx, c * yx - s * xx
        xy, yy = c * xy + s * yy, c * yy - s * xy
        xz, yz = c * xz + s * yz, c * yz - s * xz
        d, a, c, s = arm[i, D], arm[i, A], arm[i, COS], arm[i, SIN]
        px, py, pz = px + d * zx + a * xx, py + d * zy + a * xy, pz + d * zz + a * xz
        yx, zx = c * yx + s * zx, c * zx - s * yx
        yy, zy = c * yy + s * zy, c * zy - s * yy
        yz, zz = c * yz + s * zz, c * zz - s * yz
    px += tool[3] * xx + tool[7] * yx + tool[11] * zx
    py += tool[3] * xy + tool[7] * yy + tool[11] * zy
    pz += tool[3] * xz + tool[7] * yz + tool[11] * zz
    _fill_jacobian(len(q), px, py, pz, work)
    x, y, z = target[0] - px, target[1] - py, target[2] - pz
    work[AWAY, 0], work[AWAY, 1], work[AWAY, 2] = x, y, z
    return math.sqrt(x * x + y * y + z * z)


@njit(cache=True, nogil=True)
def _fill_jacobian(num, px, py, pz, work):
    for i in range(num):
        zx, zy, zz = work[0, i], work[1, i], work[2, i]
        x, y, z = px - work[ORIGIN, i], py - work[ORIGIN + 1, i], pz - work[ORIGIN + 2, i]
        work[0, i], work[1, i], work[2, i] = zy * z - zz * y, zz * x - zx * z, zx * y - zy * x


@njit(cache=True, nogil=True)
def _find_step(arm, q, distance, damping, wish, work):
    """Fills the step towards the target, as near to a wish (J,) as that allows; `damping` in squared distances.

    A joint that would leave its limits goes to the limit, and the others make up for it.
    """
    for i in range(len(q)):
        work[STEP, i], work[FREE, i] = wish[i], 1.0
    for _ in range(len(q) + 1):
        x, y, z = _multipliers(arm, len(q), distance, damping, work)
        stuck = False
        for i in range(len(q)):
            if work[FREE, i] == 0.0:
                continue
            new = q[i] + work[STEP, i] + arm[i, WEIGHT] * (work[0, i] * x + work[1, i] * y + work[2, i] * z)
            if new < arm[i, LOWER] or new > arm[i, UPPER]:
                work[STEP, i] = (arm[i, LOWER] if new < arm[i, LOWER] else arm[i, UPPER]) - q[i]
                work[FREE, i] = 0.0
                stuck = True
        if not stuck:
            break
    for i in range(len(q)):
        work[STEP, i] += work[FREE, i] * arm[i, WEIGHT] * (work[0, i] * x + work[1, i] * y + work[2, i] * z)


@njit(cache=True, nogil=True)
def _multipliers(arm, num, distance, damping, work):
    """(J W J^T + l I)^-1 (e - J r) over the joints that are free, by Cholesky's factor."""
    x, y, z = work[AWAY, 0], work[AWAY, 1], work[AWAY, 2]
    xx = yy = zz = damping * distance * distance + LEAST_DAMPING
    yx = zx = zy = 0.0
    for i in range(num):
        jx, jy, jz, step = work[0, i], work[1, i], work[2, i], work[STEP, i]
        x, y, z = x - jx * step, y - jy * step, z - jz * step
        w = work[FREE, i] * arm[i, WEIGHT]
        xx, yy, zz = xx + w * jx * jx, yy + w * jy * jy, zz + w * jz * jz
        yx, zx, zy = yx + w * jy * jx, zx + w * jz * jx, zy + w * jz * jy
    xx = math.sqrt(xx)
    yx, zx = yx / xx, zx / xx
    yy = math.sqrt(yy - yx * yx)
    zy = (zy - zx * yx) / yy
    zz = math.sqrt(zz - zx * zx - zy * zy)
    x = x / xx
    y = (y - yx * x) / yy
    z = (z - zx * x - zy * y) / zz
    z = z / zz
    y = (y - zy * z) / yy
    return (x - yx * y - zx * z) / xx, y, z

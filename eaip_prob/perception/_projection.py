"""Pixels of points, and their derivatives by the point and by the lens, whatever the lens.

Letters: x, y = X/Z, Y/Z of a point in camera coordinates, x', y' bent by the lens; a pixel is (fx x' + cx, fy y' + cy).
A lens is its vector (9,): fx, fy, cx, cy, k1, k2, p1, p2, k3. A step of a solver may try one that no camera has, and
that `Intrinsics` would refuse.
"""

from __future__ import annotations

import numpy as np
from jaxtyping import Float

from eaip_prob.data.lens import Distortion, distorted, distortion_jacobian, fold_radius


def projected(points: Float[np.ndarray, "n 3"], lens: Float[np.ndarray, "lens"]) -> Float[np.ndarray, "n 2"]:
    """Pixels (column, row) of points in camera coordinates, m; NaN behind the camera and beyond the lens's fold.

    Args:
        points: (n, 3), m.
        lens: (9,).

    Example:
        >>> lens = np.array([500.0, 501.0, 320.0, 240.0, 0.0, 0.0, 0.0, 0.0, 0.0])
        >>> projected(np.array([[0.2, 0.0, 2.0]]), lens).tolist()
        [[370.0, 240.0]]
    """
    coefficients = _coefficients(lens)
    depth = np.where(points[:, 2] > 0, points[:, 2], np.nan)
    x, y = points[:, 0] / depth, points[:, 1] / depth
    x = np.where(np.hypot(x, y) > fold_radius(coefficients), np.nan, x)
    x, y = distorted(x, y, coefficients)
    return np.column_stack([lens[0] * x + lens[2], lens[1] * y + lens[3]])


def by_point(points: Float[np.ndarray, "n 3"], lens: Float[np.ndarray, "lens"]) -> Float[np.ndarray, "n 2 3"]:
    """Derivatives of pixels by the point in camera coordinates, px / m.

    Args:
        points: (n, 3), m.
        lens: (9,).

    Example:
        >>> lens = np.array([500.0, 501.0, 320.0, 240.0, 0.0, 0.0, 0.0, 0.0, 0.0])
        >>> by_point(np.array([[0.0, 0.0, 2.0]]), lens)[0].tolist()
        [[250.0, 0.0, 0.0], [0.0, 250.5, 0.0]]
    """
    x, y, z = points[:, 0] / points[:, 2], points[:, 1] / points[:, 2], points[:, 2]
    j_xx, j_xy, j_yy = distortion_jacobian(x, y, _coefficients(lens))
    fx, fy = lens[0], lens[1]
    bent = np.stack([fx * j_xx, fx * j_xy, fy * j_xy, fy * j_yy], -1).reshape(-1, 2, 2)
    zero, one = np.zeros_like(x), np.ones_like(x)
    pinhole = np.stack([one, zero, -x, zero, one, -y], -1).reshape(-1, 2, 3) / z[:, None, None]
    return bent @ pinhole + 0.0


def by_lens(points: Float[np.ndarray, "n 3"], lens: Float[np.ndarray, "lens"]) -> Float[np.ndarray, "n 2 9"]:
    """Derivatives of pixels by the lens, px for each unit of its numbers.

    Args:
        points: (n, 3), in camera coordinates, m.
        lens: (9,).

    Example:
        >>> lens = np.array([500.0, 501.0, 320.0, 240.0, 0.0, 0.0, 0.0, 0.0, 0.0])
        >>> by_lens(np.array([[1.0, 0.0, 2.0]]), lens)[0, 0].tolist()
        [0.5, 0.0, 1.0, 0.0, 62.5, 15.625, 0.0, 375.0, 3.90625]
    """
    x, y = points[:, 0] / points[:, 2], points[:, 1] / points[:, 2]
    bent_x, bent_y = distorted(x, y, _coefficients(lens))
    r2, twice = x * x + y * y, 2.0 * x * y
    zero, one = np.zeros_like(x), np.ones_like(x)
    fx, fy = lens[0], lens[1]
    columns = [fx * x * r2, fx * x * r2**2, fx * twice, fx * (r2 + 2.0 * x * x), fx * x * r2**3]
    rows = [fy * y * r2, fy * y * r2**2, fy * (r2 + 2.0 * y * y), fy * twice, fy * y * r2**3]
    first, second = [bent_x, zero, one, zero, *columns], [zero, bent_y, zero, one, *rows]
    return np.stack([np.stack(first, -1), np.stack(second, -1)], 1)


def _coefficients(lens: np.ndarray) -> Distortion:
    k1, k2, p1, p2, k3 = (float(value) for value in lens[4:])
    return k1, k2, p1, p2, k3

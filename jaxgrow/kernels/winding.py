"""Winding numbers of points: the loop of `jaxgrow.mesh.winding`.

libigl takes 1.5 to 6 times as long for 100 to 1 000 points (half as long for 2 000 and
81 920 faces), and of 802 points on a surface it reports 324 as inside or outside, where
this loop reports none (experiments/benchmarks/libraries.py).
"""

import math
from typing import no_type_check

import numpy as np
from numba import njit

from jaxgrow.kernels.regrouped import regrouped


_SMALL = 0.1
"""Tangent of half a solid angle up to which the angle is summed as a series."""


@regrouped
@no_type_check
def _small_angles(
    point: np.ndarray,
    corners: np.ndarray,
    top: np.ndarray,
    bottom: np.ndarray,
    size: np.ndarray,
    on_surface: float,
) -> float:
    """Add up the halves of the small solid angles of all faces.

    For the other faces it writes `top`, `bottom` and `size`: the half angle is the
    arctangent of top over bottom, and size is the product of the three lengths. The
    loop has no branches, so that it is vectorised over faces.
    """
    px, py, pz = point[0], point[1], point[2]
    total = 0.0
    for f in range(corners.shape[1]):
        ax, ay, az = corners[0, f] - px, corners[1, f] - py, corners[2, f] - pz
        bx, by, bz = corners[3, f] - px, corners[4, f] - py, corners[5, f] - pz
        cx, cy, cz = corners[6, f] - px, corners[7, f] - py, corners[8, f] - pz
        a = math.sqrt(ax * ax + ay * ay + az * az)
        b = math.sqrt(bx * bx + by * by + bz * bz)
        c = math.sqrt(cx * cx + cy * cy + cz * cz)
        n = (
            ax * (by * cz - bz * cy)
            + ay * (bz * cx - bx * cz)
            + az * (bx * cy - by * cx)
        )
        s = a * b * c
        d = (
            s
            + (ax * bx + ay * by + az * bz) * c
            + (bx * cx + by * cy + bz * cz) * a
            + (cx * ax + cy * ay + cz * az) * b
        )
        top[f], bottom[f], size[f] = n, d, s
        small = (abs(n) <= _SMALL * d) & (d > on_surface * s)
        t = (n if small else 0.0) / (d if small else 1.0)
        # arctangent, to the last digit
        u = t * t
        rest = 1 / 9 - u * (1 / 11 - u * (1 / 13 - u / 15))
        total += t * (1 - u * (1 / 3 - u * (1 / 5 - u * (1 / 7 - u * rest))))
    return total


@njit(cache=True, error_model="numpy")
@no_type_check
def numbers(points: np.ndarray, corners: np.ndarray, on_surface: float) -> np.ndarray:
    """Compute winding numbers.

    Args:
        points: positions.
        corners: of the faces: nine coordinates, one row for each.
        on_surface: ratio of the triple product to the product of the lengths below
            which a point is in a face, whose angle is omitted.
    """
    result = np.zeros(len(points))
    count = corners.shape[1]
    top, bottom, size = np.zeros(count), np.zeros(count), np.zeros(count)
    for i in range(len(points)):
        total = _small_angles(points[i], corners, top, bottom, size, on_surface)
        for f in range(count):
            if not abs(top[f]) <= _SMALL * bottom[f]:
                least = on_surface * size[f]
                if not (abs(top[f]) <= least and bottom[f] <= least):
                    total += math.atan2(top[f], bottom[f])
        result[i] = total / (2.0 * np.pi)
    return result

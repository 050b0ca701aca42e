"""The loop over points that counts those without company."""

from typing import no_type_check

import numpy as np
from numba import njit


@njit(cache=True, error_model="numpy")
@no_type_check
def alone(points: np.ndarray, distance: float) -> int:
    """Number of points that no other one is closer to than a distance.

    Args:
        points: asked in the order of a coordinate.
        distance: the bound.
    """
    order = np.argsort(points[:, 0])
    placed = points[order]
    count = len(placed)
    accompanied = np.zeros(count, np.bool_)
    square = distance * distance
    for i in range(count):
        for j in range(i + 1, count):
            dx = placed[j, 0] - placed[i, 0]
            # a little further, so that rounding leaves nobody out
            if dx > distance * (1.0 + 1e-12):
                break
            if accompanied[i] and accompanied[j]:
                continue
            dy, dz = placed[j, 1] - placed[i, 1], placed[j, 2] - placed[i, 2]
            if dx * dx + dy * dy + dz * dz < square:
                accompanied[i] = accompanied[j] = True
    return count - int(accompanied.sum())

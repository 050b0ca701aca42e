"""Count of isolated points: a sweep along one axis."""

from typing import no_type_check

import numpy as np
from numba import njit


@njit(cache=True, error_model="numpy")
@no_type_check
def alone(points: np.ndarray, distance: float) -> int:
    """Count the points without another one within a distance.

    Pairs are found by a sweep along the first axis.

    Args:
        points: positions.
        distance: the bound, exclusive.
    """
    order = np.argsort(points[:, 0])
    placed = points[order]
    count = len(placed)
    accompanied = np.zeros(count, np.bool_)
    square = distance * distance
    for i in range(count):
        for j in range(i + 1, count):
            dx = placed[j, 0] - placed[i, 0]
            # slightly further, so that rounding omits no pair
            if dx > distance * (1.0 + 1e-12):
                break
            if accompanied[i] and accompanied[j]:
                continue
            dy, dz = placed[j, 1] - placed[i, 1], placed[j, 2] - placed[i, 2]
            if dx * dx + dy * dy + dz * dz < square:
                accompanied[i] = accompanied[j] = True
    return count - int(accompanied.sum())

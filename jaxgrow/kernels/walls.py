"""Search for near faces of `jaxgrow.mesh.collision_mesh.Walls`."""

import math
from typing import no_type_check

import numpy as np
from numba import njit


@njit(cache=True, error_model="numpy")
@no_type_check
def near(
    low: np.ndarray,
    high: np.ndarray,
    centre: np.ndarray,
    radius: np.ndarray,
    points: np.ndarray,
    distance: float,
) -> np.ndarray:
    """Find the faces that may be within a distance of some point.

    The bounding sphere of a face must be within this distance of a point, and its box
    of the bounding box of all points. Points are sorted along the axis of their largest
    extent.

    Args:
        low: lowest corner of each face's box.
        high: its highest corner.
        centre: of each face.
        radius: of the bounding sphere there.
        points: one at least.
        distance: the bound.
    """
    least, most = np.full(3, np.inf), np.full(3, -np.inf)
    for i in range(len(points)):
        for k in range(3):
            least[k] = min(least[k], points[i, k])
            most[k] = max(most[k], points[i, k])
    axis = np.argmax(most - least)
    order = np.argsort(points[:, axis])
    placed = points[order]
    along = placed[:, axis].copy()
    least, most = least - distance, most + distance
    found = np.zeros(len(radius), np.bool_)
    for f in range(len(radius)):
        if high[f, 0] < least[0] or high[f, 1] < least[1] or high[f, 2] < least[2]:
            continue
        if low[f, 0] > most[0] or low[f, 1] > most[1] or low[f, 2] > most[2]:
            continue
        bound = distance + radius[f]
        x, y, z = centre[f, 0], centre[f, 1], centre[f, 2]
        # slightly further, as the exact test follows
        begin = np.searchsorted(along, centre[f, axis] - bound * (1.0 + 1e-12))
        for at in range(begin, len(along)):
            if along[at] - centre[f, axis] > bound:
                break
            dx, dy, dz = placed[at, 0] - x, placed[at, 1] - y, placed[at, 2] - z
            if math.sqrt(dx * dx + dy * dy + dz * dz) <= bound:
                found[f] = True
                break
    return np.flatnonzero(found)

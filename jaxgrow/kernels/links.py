"""Listing single particles anew in lists that all others keep.

The loops of `jaxgrow.neighbors.update_particle`, for the near and for the wide
neighbours.
"""

from typing import no_type_check

import numpy as np
from numba import njit


@njit(cache=True)
@no_type_check
def relink(listed: np.ndarray, one: int, places: np.ndarray, radius: float) -> bool:
    """Give one particle the neighbours that it has now, from both sides.

    Args:
        listed: neighbours of each, neighbour-major; n for empty entries, which may be
            anywhere. Written.
        one: whose neighbours change.
        places: where everyone was when listed, in r0.
        radius: that neighbours are closer than, in r0.

    Returns:
        Whether they had room.
    """
    room, count = listed.shape
    for k in range(room):
        other = listed[k, one]
        if other < count:
            for entry in range(room):
                if listed[entry, other] == one:
                    listed[entry, other] = count
        listed[k, one] = count
    x, y, z = places[one, 0], places[one, 1], places[one, 2]
    square, found, fits = radius * radius, 0, True
    for other in range(count):
        dx, dy, dz = x - places[other, 0], y - places[other, 1], z - places[other, 2]
        if dx * dx + dy * dy + dz * dz < square and other != one:
            if found < room:
                listed[found, one] = other
            found += 1
            entry = 0
            while entry < room and listed[entry, other] < count:
                entry += 1
            if entry < room:
                listed[entry, other] = one
            fits &= entry < room
    return fits and found <= room

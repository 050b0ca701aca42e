"""Update of neighbour lists for single particles.

The loops of `jaxgrow.neighbors.update_particle`, for near and wide lists. The entries
of all other pairs do not change.
"""

from typing import no_type_check

import numpy as np
from numba import njit


@njit(cache=True)
@no_type_check
def relink(listed: np.ndarray, one: int, places: np.ndarray, radius: float) -> bool:
    """Update the neighbours of one particle, in its row and in theirs.

    Args:
        listed: neighbours of each, neighbour-major; n for empty entries, which may be
            anywhere. Written.
        one: the particle.
        places: positions of all particles when they were listed, in r0.
        radius: upper bound of a neighbour's distance, in r0.

    Returns:
        Whether the capacity was sufficient.
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

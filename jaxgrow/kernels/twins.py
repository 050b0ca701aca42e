"""Search for duplicate points by a hash table."""

from typing import no_type_check

import numpy as np
from numba import njit


@njit(cache=True)
@no_type_check
def any_same(points: np.ndarray, chosen: np.ndarray) -> bool:
    """Return whether two of the chosen points have the same coordinates.

    0 equals -0, and NaN equals nothing. Points are entered in a hash table with open
    addressing: at the place of their hash, or the next free one.

    Args:
        points: in any unit.
        chosen: mask of the points that are compared.
    """
    bits = 4
    while 1 << bits < 2 * len(points):
        bits += 1
    mask = (1 << bits) - 1
    table = np.full(1 << bits, -1, np.int64)
    whole = (points + 0.0).view(np.uint64)  # 0 for -0 too
    for i in range(len(points)):
        x, y, z = points[i, 0], points[i, 1], points[i, 2]
        if not chosen[i] or x != x or y != y or z != z:
            continue
        # by shifts alone: plain Python would warn of the overflow of a product
        mixed = np.uint64(0)
        for axis in range(3):
            mixed ^= whole[i, axis]
            mixed ^= mixed << np.uint64(13)
            mixed ^= mixed >> np.uint64(7)
            mixed ^= mixed << np.uint64(17)
        place = np.int64(mixed >> np.uint64(33)) & mask
        while table[place] >= 0:
            j = table[place]
            if points[j, 0] == x and points[j, 1] == y and points[j, 2] == z:
                return True
            place = (place + 1) & mask
        table[place] = i
    return False

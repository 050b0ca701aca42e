"""Near neighbours in the wide lists of `jaxgrow.neighbors.verlet_list`."""

from typing import no_type_check

import numpy as np
from numba import cfunc, njit

from jaxgrow.kernels import frames
from jaxgrow.kernels.arguments import codes_of
from jaxgrow.kernels.layout import AWAY, NEAR_ARGUMENTS, NEAR_RESULTS


_CODES = codes_of(NEAR_ARGUMENTS, NEAR_RESULTS)


@njit(cache=True)
@no_type_check
def find(
    position: np.ndarray,
    wide: np.ndarray,
    square: float,
    listed: np.ndarray,
    most: np.ndarray,
) -> None:
    """Filter the near neighbours of each particle from a wide list.

    Args:
        position: of the particles, in r0; those at `AWAY` or beyond have no neighbours.
        wide: neighbours of each, particle by particle; n and above for empty entries.
        square: squared upper bound of a near neighbour's distance.
        listed: the near ones of each, in their order, neighbour-major; n for empty
            entries. Written.
        most: largest number of near ones of a particle, listed or not. Written.
    """
    count, entries = wide.shape
    room, last = listed.shape[0], np.uint32(count - 1)
    row, near = np.zeros(entries + 1, np.int32), np.zeros(entries, np.uint8)
    most[0] = 0
    for i in range(count):
        x, y, z = position[i, 0], position[i, 1], position[i, 2]
        asked = entries if x < AWAY else 0
        while asked > 0 and wide[i, asked - 1] >= count:
            asked -= 1
        for entry in range(asked):
            # unsigned: no index counts from the end
            other = np.uint32(wide[i, entry])
            j = min(other, last)
            dx, dy, dz = x - position[j, 0], y - position[j, 1], z - position[j, 2]
            near[entry] = (dx * dx + dy * dy + dz * dz < square) & (other <= last)
        # without a branch, which would be mispredicted for each third
        found = np.uint64(0)
        for entry in range(asked):
            row[found] = wide[i, entry]
            found += np.uint64(near[entry])
        for entry in range(room):
            listed[entry, i] = row[entry] if entry < found else count
        most[0] = max(most[0], found)


@cfunc(frames.HANDLER, cache=True)
@no_type_check
def handler(frame: int) -> int:
    """Call `find` from XLA, with its arguments and results."""
    if frames.answers_version(frame):
        return 0
    bad = frames.mismatch(frame, _CODES)
    if bad:
        return frames.refuse(frame, bad)
    count, entries = frames.size(frame, 1, 0), frames.size(frame, 1, 1)
    room = frames.size_of_result(frame, 0, 0)
    find(
        frames.reals(frames.argument(frame, 0), (count, 3)),
        frames.indices(frames.argument(frame, 1), (count, entries)),
        frames.reals(frames.argument(frame, 2), (1,))[0],
        frames.indices(frames.result(frame, 0), (room, count)),
        frames.indices(frames.result(frame, 1), (1,)),
    )
    return 0

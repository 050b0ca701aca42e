"""Cell list of neighbours, for `jaxgrow.neighbors.cell_list.relist`."""

import math
from typing import no_type_check

import numpy as np
from numba import cfunc, njit

from jaxgrow.kernels import frames
from jaxgrow.kernels.layout import AWAY


@njit(cache=True)
@no_type_check
def _place(coordinate: float, size: float, side: int) -> int:
    """Return the cell along an axis; the first for non-finite coordinates."""
    cell = math.floor(coordinate / size)
    return int(cell) % side if abs(cell) < 1e15 else 0


@njit(cache=True)
@no_type_check
def find(
    position: np.ndarray,
    size: float,
    radius: float,
    side: int,
    asked: np.ndarray,
    entries: np.ndarray,
    most: np.ndarray,
) -> None:
    """List the neighbours of each point by a cell list.

    Candidates are the points of its cell and of the 26 around it. Cells repeat along
    every axis, so that every point has one; that adds candidates and omits none.

    Args:
        position: of the points, in r0; those at `AWAY` or beyond have no neighbours.
        size: of a cell; no less than the radius.
        radius: upper bound of a neighbour's distance.
        side: number of cells along an axis; three at least.
        asked: mask of the points whose neighbours are listed; the others have none, but
            are neighbours of these.
        entries: neighbours of each point, n for empty entries. Written.
        most: largest number of neighbours of a point, listed or not. Written.
    """
    count, room = entries.shape
    cell = np.zeros((count, 3), np.int64)
    first = np.zeros(side**3 + 1, np.int64)
    for i in range(count):
        if position[i, 0] >= AWAY:
            continue
        for axis in range(3):
            cell[i, axis] = _place(position[i, axis], size, side)
        first[(cell[i, 0] * side + cell[i, 1]) * side + cell[i, 2] + 1] += 1
    for number in range(side**3):
        first[number + 1] += first[number]
    # points, and their positions once more, in the order of their cells
    order, next_place = np.zeros(count, np.int64), first[:-1].copy()
    sorted_position = np.zeros((count, 3))
    for i in range(count):
        if position[i, 0] >= AWAY:
            continue
        number = (cell[i, 0] * side + cell[i, 1]) * side + cell[i, 2]
        place = next_place[number]
        next_place[number] += 1
        order[place] = i
        for axis in range(3):
            sorted_position[place, axis] = position[i, axis]
    most[0] = 0
    square = radius * radius
    rows = np.zeros((3, 3), np.int64)
    row = np.zeros(room + 1, np.int64)
    for i in range(count):
        x, y, z = position[i, 0], position[i, 1], position[i, 2]
        found = 0
        for axis in range(3):
            for way in range(3):
                rows[axis, way] = (cell[i, axis] + way - 1) % side
        for way in range(27 if asked[i] and x < AWAY else 0):
            a, b, c = rows[0, way // 9], rows[1, way // 3 % 3], rows[2, way % 3]
            number = (a * side + b) * side + c
            for place in range(first[number], first[number + 1]):
                dx = x - sorted_position[place, 0]
                dy = y - sorted_position[place, 1]
                dz = z - sorted_position[place, 2]
                near = dx * dx + dy * dy + dz * dz < square
                # without a branch, which would be mispredicted for each sixth
                row[min(found, room)] = order[place]
                found += near & (order[place] != i)
        for entry in range(room):
            entries[i, entry] = row[entry] if entry < found else count
        most[0] = max(most[0], found)


@cfunc(frames.HANDLER, cache=True)
@no_type_check
def handler(frame: int) -> int:
    """Call `find` from XLA.

    Arguments: positions; size and radius in one array; side; mask `asked`. Results:
    entries and most.
    """
    if frames.answers_version(frame):
        return 0
    count, room = frames.size(frame, 0, 0), frames.size_of_result(frame, 0, 1)
    lengths = frames.reals(frames.argument(frame, 1), (2,))
    find(
        frames.reals(frames.argument(frame, 0), (count, 3)),
        lengths[0],
        lengths[1],
        frames.indices(frames.argument(frame, 2), (1,))[0],
        frames.booleans(frames.argument(frame, 3), (count,)),
        frames.indices(frames.result(frame, 0), (count, room)),
        frames.indices(frames.result(frame, 1), (1,)),
    )
    return 0

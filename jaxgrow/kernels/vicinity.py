"""Local cell lists around a few of many points, for the host.

They find neighbours, and update pair forces. The loops visit the cells around those
points, and pass once over all others, so that the cost depends mainly on the number of
these few.
"""

import math
from typing import Any, no_type_check

import numpy as np
from numba import njit

from jaxgrow.kernels.regrouped import regrouped


_MOST_CELLS = 64
"""Largest number of cells along an axis; cells are enlarged if there would be more."""

_SLACK = 1.0001
"""Size of a cell over the radius, so that rounding omits no pair."""


@njit(cache=True)
@no_type_check
def _box_of(points: np.ndarray, chosen: np.ndarray, box: np.ndarray) -> None:
    """Enlarge a box, given by two corners, to hold the chosen points."""
    for i in range(len(points)):
        if chosen[i]:
            for axis in range(3):
                box[0, axis] = min(box[0, axis], points[i, axis])
                box[1, axis] = max(box[1, axis], points[i, axis])


@njit(cache=True)
@no_type_check
def _inside(point: np.ndarray, box: np.ndarray) -> bool:
    """Return whether a point is in a box; non-finite points are not."""
    inside = True
    for axis in range(3):
        inside &= (box[0, axis] <= point[axis]) & (point[axis] <= box[1, axis])
    return inside


@njit(cache=True)
@no_type_check
def _cells(box: np.ndarray, size: float) -> tuple[np.ndarray, float, np.ndarray]:
    """Choose the cells over a box, with an empty layer on all sides.

    Returns the lowest corner, the size of a cell, and the numbers along the axes.
    """
    widest = 0.0
    for axis in range(3):
        widest = max(widest, box[1, axis] - box[0, axis])
    size = max(size, widest / _MOST_CELLS)
    sides = np.zeros(3, np.int64)
    for axis in range(3):
        sides[axis] = int((box[1, axis] - box[0, axis]) / size) + 3
    return box[0] - size, size, sides


@njit(cache=True)
@no_type_check
def _cell(point: np.ndarray, low: np.ndarray, size: float, sides: np.ndarray) -> int:
    a = int((point[0] - low[0]) / size)
    b = int((point[1] - low[1]) / size)
    c = int((point[2] - low[2]) / size)
    return (a * sides[1] + b) * sides[2] + c


@njit(cache=True)
@no_type_check
def _rows(sides: np.ndarray) -> np.ndarray:
    """Compute the offsets from a cell to the 9 rows of 3 cells around it.

    Each offset is that of the row's first cell; the cell's own row is the first.
    """
    steps = np.zeros(9, np.int64)
    for way in range(9):
        other = (way + 4) % 9
        steps[way] = ((other // 3 - 1) * sides[1] + other % 3 - 1) * sides[2] - 1
    return steps


@njit(cache=True)
@no_type_check
def _sort(
    points: np.ndarray,
    chosen: np.ndarray,
    low: np.ndarray,
    size: float,
    sides: np.ndarray,
) -> tuple[np.ndarray, np.ndarray]:
    """Sort the chosen points by their cells.

    Returns where the points of each cell begin, and the sorted points.
    """
    first = np.zeros(sides[0] * sides[1] * sides[2] + 1, np.int64)
    cell = np.zeros(len(chosen), np.int64)
    for place in range(len(chosen)):
        cell[place] = _cell(points[chosen[place]], low, size, sides)
        first[cell[place] + 1] += 1
    for number in range(len(first) - 1):
        first[number + 1] += first[number]
    order, following = np.zeros(len(chosen), np.int64), first.copy()
    for place in range(len(chosen)):
        order[following[cell[place]]] = chosen[place]
        following[cell[place]] += 1
    return first, order


@njit(cache=True)
@no_type_check
def near(
    points: np.ndarray, seeds: np.ndarray, radius: float, found: np.ndarray
) -> None:
    """Mark the points that are within a radius of a seed.

    Args:
        points: many, in r0.
        seeds: few; one that is not finite has no neighbours.
        radius: in r0.
        found: mask of the points. Written.
    """
    known = np.zeros(len(seeds), np.bool_)
    for k in range(len(seeds)):
        known[k] = np.isfinite(seeds[k]).all()
    box = np.full((2, 3), math.inf)
    box[1] = -math.inf
    _box_of(seeds, known, box)
    found[:] = False
    if not known.any():
        return
    box[0] -= radius
    box[1] += radius
    low, size, sides = _cells(box, _SLACK * radius)
    first, order = _sort(seeds, np.flatnonzero(known), low, size, sides)
    sorted_seeds = seeds[order]
    steps = _rows(sides)
    square = radius * radius
    for i in range(len(points)):
        if not _inside(points[i], box):
            continue
        x, y, z = points[i, 0], points[i, 1], points[i, 2]
        own = _cell(points[i], low, size, sides)
        for way in range(9):
            cell = own + steps[way]
            for k in range(first[cell], first[cell + 3]):
                dx = x - sorted_seeds[k, 0]
                dy = y - sorted_seeds[k, 1]
                dz = z - sorted_seeds[k, 2]
                if dx * dx + dy * dy + dz * dz <= square:
                    found[i] = True
                    break
            if found[i]:
                break


@njit(cache=True)
@no_type_check
def differ(
    position: np.ndarray,
    species: np.ndarray,
    alive: np.ndarray,
    position_before: np.ndarray,
    species_before: np.ndarray,
    alive_before: np.ndarray,
    changed: np.ndarray,
) -> int:
    """Mark the particles that changed, and return their number.

    A particle changed if its position, its species or its being alive did.

    Args:
        position: of all, in r0.
        species: of all.
        alive: mask of those that are not padding.
        position_before: former positions, in r0.
        species_before: former species.
        alive_before: former mask.
        changed: mask of those that changed, or have a coordinate NaN. Written.
    """
    count = 0
    for i in range(len(position)):
        same = (species[i] == species_before[i]) & (alive[i] == alive_before[i])
        for axis in range(3):
            same &= position[i, axis] == position_before[i, axis]
        changed[i] = not same
        count += not same
    return count


@njit(cache=True)
@no_type_check
def _touched(
    points: np.ndarray,
    chosen: np.ndarray,
    low: np.ndarray,
    size: float,
    sides: np.ndarray,
    touched: np.ndarray,
) -> None:
    """Mark the cells around those of the chosen points."""
    steps = _rows(sides)
    for i in range(len(points)):
        if chosen[i]:
            own = _cell(points[i], low, size, sides)
            for way in range(9):
                for k in range(3):
                    touched[own + steps[way] + k] = True


@njit(cache=True)
@no_type_check
def _gather(
    cell: int,
    steps: np.ndarray,
    first: np.ndarray,
    position: np.ndarray,
    tumour: np.ndarray,
    others: np.ndarray,
    stiffer: np.ndarray,
) -> int:
    """Gather the points in and around a cell, and return their number.

    Args:
        cell: its number.
        steps: offsets to the rows around it, see `_rows`.
        first: where the points of each cell begin.
        position: in the order of the cells.
        tumour: likewise.
        others: coordinates of the gathered points. Written.
        stiffer: mask of those of the tumour. Written.
    """
    count = 0
    for way in range(9):
        row = cell + steps[way]
        for place in range(first[row], first[row + 3]):
            for axis in range(3):
                others[axis, count] = position[place, axis]
            stiffer[count] = tumour[place]
            count += 1
    return count


@njit(cache=True)
@no_type_check
def _most_around(first: np.ndarray, touched: np.ndarray, steps: np.ndarray) -> int:
    """Count the points in and around each touched cell; return the largest."""
    most = 0
    for cell in range(len(touched)):
        if touched[cell] and first[cell + 1] > first[cell]:
            count = 0
            for way in range(9):
                row = cell + steps[way]
                count += first[row + 3] - first[row]
            most = max(most, count)
    return most


@regrouped
@no_type_check
def _add_up(
    slope: Any,
    point: np.ndarray,
    tumour: bool,
    others: np.ndarray,
    kind: np.ndarray,
    count: int,
    cutoff: float,
    p: tuple,
    square: np.ndarray,
    close: np.ndarray,
    force: np.ndarray,
) -> None:
    """Compute the force on a point from candidates, as `jaxgrow.kernels.pair`."""
    x, y, z = point[0], point[1], point[2]
    own = 1.0 if tumour else 0.0
    for k in range(count):
        dx, dy, dz = x - others[0, k], y - others[1, k], z - others[2, k]
        square[k] = dx * dx + dy * dy + dz * dz
    found = 0
    for k in range(count):
        close[found] = k
        found += (square[k] <= cutoff * cutoff) & (square[k] != 0.0)
    fx, fy, fz = 0.0, 0.0, 0.0
    for place in range(found):
        k = close[place]
        u = math.sqrt(square[k])
        other = 1.0 if kind[k] else 0.0
        ratio = slope(u, own, other, *p)[0] / u
        fx -= ratio * (x - others[0, k])
        fy -= ratio * (y - others[1, k])
        fz -= ratio * (z - others[2, k])
    force[0], force[1], force[2] = fx, fy, fz


@regrouped
@no_type_check
def renew(
    slope: Any,
    position: np.ndarray,
    tumour: np.ndarray,
    alive: np.ndarray,
    before: np.ndarray,
    alive_before: np.ndarray,
    changed: np.ndarray,
    cutoff: float,
    p: tuple,
    force: np.ndarray,
) -> None:
    """Update the pair forces on all particles near those that changed.

    Forces change only where a changed particle is, or was, within the cutoff.

    Args:
        slope: derivative of a pair's energy, as for `jaxgrow.kernels.pair.add_forces`.
        position: of all particles, in r0.
        tumour: mask of those of the tumour.
        alive: mask of those that are not padding.
        before: positions for which the given forces are valid, in r0.
        alive_before: mask of those alive then.
        changed: mask of the particles that changed since.
        cutoff: distance in r0 beyond which no pair interacts.
        p: parameters of the law.
        force: in F(0); valid for the former state. Written.
    """
    is_here, was_there = changed & alive, changed & alive_before
    for i in np.flatnonzero(changed):
        is_here[i] &= np.isfinite(position[i]).all()
        was_there[i] &= np.isfinite(before[i]).all()
        force[i] = math.nan if alive[i] and not is_here[i] else 0.0
    box = np.full((2, 3), math.inf)
    box[1] = -math.inf
    _box_of(position, is_here, box)
    _box_of(before, was_there, box)
    if not box[0, 0] <= box[1, 0]:
        return
    reach = _SLACK * cutoff
    concerned, wide = box.copy(), box.copy()
    for axis in range(3):
        concerned[0, axis] -= reach
        concerned[1, axis] += reach
        wide[0, axis] -= 2 * reach
        wide[1, axis] += 2 * reach
    members = alive.copy()
    for i in range(len(position)):
        members[i] &= _inside(position[i], wide)
    low, size, sides = _cells(wide, reach)
    first, order = _sort(position, np.flatnonzero(members), low, size, sides)
    own, kind, steps = position[order], tumour[order], _rows(sides)
    touched = np.zeros(len(first) - 1, np.bool_)
    _touched(position, is_here, low, size, sides, touched)
    _touched(before, was_there, low, size, sides, touched)
    most = _most_around(first, touched, steps)
    others, stiffer = np.zeros((3, most)), np.zeros(most, np.bool_)
    square, close = np.zeros(most), np.zeros(most + 1, np.int64)
    for cell in range(len(touched)):
        if not touched[cell] or first[cell + 1] == first[cell]:
            continue
        count = _gather(cell, steps, first, own, kind, others, stiffer)
        for place in range(first[cell], first[cell + 1]):
            # farther out not all neighbours are members, and no force changed
            if _inside(own[place], concerned):
                _add_up(
                    slope,
                    own[place],
                    kind[place],
                    others,
                    stiffer,
                    count,
                    cutoff,
                    p,
                    square,
                    close,
                    force[order[place]],
                )

r"""Yardstick: pair forces over a full neighbour list, and the list, in numba loops.

The force is that of `jaxgrow.energy.pair`,
:math:`f_i = \sum_j s_{ij} F(r_{ij}) (x_i - x_j) / r_{ij}` with F of `jaxgrow.A2`. Every
pair is listed from both sides, so that nothing is scattered. One thread, 64 bits.
"""

import math
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Int
from numba import njit


CUTOFF = 1.5
"""Distance, in r0, from which on particles do not interact."""

LISTED = 1.9
"""Radius of a list, in r0: the cut-off and a skin of 0.4, as jaxgrow has it."""

REASSOCIATED = {"reassoc", "contract", "arcp", "nsz"}
"""What the compiler may do to sums; NaN and infinity stay what they are."""

_INNER = 27
_MOST_CELLS_PER_PARTICLE = 8


class Shape(NamedTuple):
    """The law with its branches as numbers, so that no loop has to ask for them.

    Attributes:
        low: distance at which the blend at u = 1/2 begins.
        blend: inverse of its width.
        edge: distance at which the taper ends.
        tail: inverse of its width.
        adhesion: factor of the attraction.
    """

    low: float
    blend: float
    edge: float
    tail: float
    adhesion: float


@njit(cache=True)
def shape_of(adhesion: float, smoothing: float) -> Shape:
    """The law; without smoothing both widths are one rounding."""
    if smoothing > 0.0:
        width = 1.0 / smoothing
        return Shape(0.5 - smoothing, 0.5 * width, CUTOFF, width, adhesion)
    low, edge = np.nextafter(0.5, 0.0), np.nextafter(CUTOFF, 2.0)
    return Shape(low, 1e300, edge, 1e300, adhesion)


@njit(cache=True, fastmath=REASSOCIATED, error_model="numpy")
def a2_force(u: float, shape: Shape) -> float:
    """Force of A2 in units of F(0) at distance u; positive repels."""
    share = min(max((u - shape.low) * shape.blend, 0.0), 1.0)
    taper = min(max((shape.edge - u) * shape.tail, 0.0), 1.0)
    taper = taper * shape.adhesion if u > 1.0 else taper
    far = 0.5 * (1.0 - u) * (2.0 - u)
    return (1.0 - u * u) * (1.0 - share) + far * share * taper


@njit(cache=True, fastmath=REASSOCIATED, error_model="numpy")
def set_pair_forces(
    position: np.ndarray,
    tumour: np.ndarray,
    start: np.ndarray,
    index: np.ndarray,
    shape: Shape,
    stiffness: float,
    force: np.ndarray,
) -> None:
    """Write the pair forces to `force`; arguments as of `pair_forces`."""
    for i in range(len(position)):
        x, y, z = position[i, 0], position[i, 1], position[i, 2]
        fx = fy = fz = 0.0
        # the branch is outside of the loop: inside it would double the yardstick's time
        if stiffness == 1.0 or not tumour[i]:
            for k in range(start[i], start[i + 1]):
                j = index[k]
                dx, dy, dz = x - position[j, 0], y - position[j, 1], z - position[j, 2]
                square = dx * dx + dy * dy + dz * dz
                u = math.sqrt(square)
                ratio = a2_force(u, shape) / u if square > 0.0 else 0.0
                fx += ratio * dx
                fy += ratio * dy
                fz += ratio * dz
        else:
            for k in range(start[i], start[i + 1]):
                j = index[k]
                dx, dy, dz = x - position[j, 0], y - position[j, 1], z - position[j, 2]
                square = dx * dx + dy * dy + dz * dz
                u = math.sqrt(square)
                ratio = a2_force(u, shape) / u if square > 0.0 else 0.0
                ratio = ratio * stiffness if tumour[j] else ratio
                fx += ratio * dx
                fy += ratio * dy
                fz += ratio * dz
        force[i, 0], force[i, 1], force[i, 2] = fx, fy, fz


def pair_forces(
    position: Float[np.ndarray, "n 3"],
    start: Int[np.ndarray, " n+1"],
    index: Int[np.ndarray, " p"],
    *,
    adhesion: float = 0.2,
    smoothing: float = 0.1,
    tumour_stiffness: float = 1.0,
    tumour: Bool[np.ndarray, " n"] | None = None,
    out: Float[np.ndarray, "n 3"] | None = None,
) -> Float[np.ndarray, "n 3"]:
    """Force on every particle, in F(0).

    Args:
        position: in r0.
        start: where the neighbours of each particle start in `index`, and the end.
        index: neighbours of all particles, one after the other.
        adhesion: factor of the attraction.
        smoothing: width of blend and taper of the law; 0 is the printed one.
        tumour_stiffness: factor of the force between two tumour particles.
        tumour: which are; None for all.
        out: where the forces are written, to spare their allocation.
    """
    if out is None:
        out = np.zeros_like(position)
    if tumour is None:
        tumour = np.ones(len(position), dtype=np.bool_)
    shape = shape_of(adhesion, smoothing)
    set_pair_forces(position, tumour, start, index, shape, tumour_stiffness, out)
    return out


@njit(cache=True)
def list_neighbours(
    position: np.ndarray, radius: float = LISTED
) -> tuple[np.ndarray, np.ndarray]:
    """Full list of all pairs closer than `radius`, by cells of that size.

    Particles are sorted along the cells, so that the candidates of one are nine runs
    of contiguous memory.

    Args:
        position: in r0.
        radius: in r0.

    Returns:
        start, index as `pair_forces` takes them.
    """
    count = len(position)
    low = np.zeros(3)
    size = np.zeros(3)
    cells = np.zeros(3, np.int64)
    for axis in range(3):
        low[axis] = position[:, axis].min()
        size[axis] = position[:, axis].max() - low[axis]
    side = radius
    while True:  # particles far apart must not make the grid larger than the memory
        total = 1.0
        for axis in range(3):
            cells[axis] = int(size[axis] / side) + 3  # an empty one at each end
            total *= cells[axis]
        if total <= _MOST_CELLS_PER_PARTICLE * count + _INNER * 64:
            break
        side *= 1.26
    row, layer = cells[0], cells[0] * cells[1]
    cell = np.zeros(count, np.int64)
    first = np.zeros(layer * cells[2] + 1, np.int64)
    for i in range(count):
        a = int((position[i, 0] - low[0]) / side) + 1
        b = int((position[i, 1] - low[1]) / side) + 1
        c = int((position[i, 2] - low[2]) / side) + 1
        cell[i] = a + row * b + layer * c
        first[cell[i] + 1] += 1
    for k in range(1, len(first)):
        first[k] += first[k - 1]
    place = first.copy()
    order = np.zeros(count, np.int32)
    there = np.zeros((count, 3))
    for i in range(count):
        k = place[cell[i]]
        place[cell[i]] += 1
        order[k] = i
        there[k] = position[i]

    square = radius * radius
    start = np.zeros(count + 1, np.int64)
    index = np.zeros(48 * count + 64, np.int32)
    filled = 0
    for i in range(count):
        start[i] = filled
        x, y, z = position[i, 0], position[i, 1], position[i, 2]
        for c in range(-1, 2):
            for b in range(-1, 2):
                run = cell[i] + layer * c + row * b
                begin, end = first[run - 1], first[run + 2]
                if filled + end - begin > len(index):
                    more = np.zeros(len(index) // 2 + (end - begin), np.int32)
                    index = np.concatenate((index, more))
                for k in range(begin, end):
                    dx, dy, dz = x - there[k, 0], y - there[k, 1], z - there[k, 2]
                    index[filled] = order[k]
                    near = dx * dx + dy * dy + dz * dz < square
                    filled += 1 if near and order[k] != i else 0
    start[count] = filled
    return start, index[:filled].copy()

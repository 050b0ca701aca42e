"""Yardstick: force-only L-BFGS of free particles, all of it one numba program.

The method is jaxgrow's (`jaxgrow.equilibrium.lbfgs`, `jaxgrow.equilibrium.descent`):
memory of 6, first step 0.1 of the force, longest displacement 0.1 r0, no line search,
pairs kept if s · y > 0. It ends when no force is larger than the tolerance, and lists
anew when a particle has moved by half of the skin. One thread.
"""

import math
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float
from numba import njit

from .pairs import (
    CUTOFF,
    list_neighbours,
    REASSOCIATED,
    set_pair_forces,
    Shape,
    shape_of,
)


class Relaxed(NamedTuple):
    """Outcome of a yardstick's relaxation.

    Attributes:
        position: in r0.
        residual: largest force, in F(0), as the method itself sees it.
        evaluations: of the forces of all particles.
        lists: how often the neighbours were listed.
    """

    position: Float[np.ndarray, "n 3"]
    residual: float
    evaluations: int
    lists: int


@njit(cache=True, fastmath=REASSOCIATED, error_model="numpy")
def _dot(a: np.ndarray, b: np.ndarray) -> float:
    total = 0.0
    for k in range(len(a)):
        total += a[k] * b[k]
    return total


@njit(cache=True, fastmath=REASSOCIATED, error_model="numpy")
def _add(a: np.ndarray, factor: float, b: np.ndarray) -> None:
    for k in range(len(a)):
        a[k] += factor * b[k]


@njit(cache=True, error_model="numpy")
def _longest(a: np.ndarray) -> float:
    """Length of the longest row; NaN if one is."""
    most = 0.0
    for i in range(len(a)):
        square = a[i, 0] ** 2 + a[i, 1] ** 2 + a[i, 2] ** 2
        if not square <= most:
            most = square
            if math.isnan(square):
                break
    return math.sqrt(most)


# Not cached: numba would not notice a change of what it calls in another file.
@njit(error_model="numpy")
def _relax(
    position: np.ndarray,
    tumour: np.ndarray,
    shape: Shape,
    stiffness: float,
    tolerance: float,
    most: int,
    memory: int,
    largest: float,
    first: float,
    skin: float,
) -> tuple[np.ndarray, float, int, int]:
    count = len(position)
    x = position.copy()
    force, after = np.zeros((count, 3)), np.zeros((count, 3))
    step = np.zeros(3 * count)
    moves, changes = np.zeros((memory, 3 * count)), np.zeros((memory, 3 * count))
    inverse, weight = np.zeros(memory), np.zeros(memory)
    kept, scale = 0, first
    start, index = list_neighbours(x, CUTOFF + skin)
    reference, lists = x.copy(), 1
    set_pair_forces(x, tumour, start, index, shape, stiffness, force)
    residual, evaluations = _longest(force), 1
    flat, flat_after, rows = force.reshape(-1), after.reshape(-1), step.reshape(-1, 3)
    while residual > tolerance and evaluations <= most:
        step[:] = flat
        for k in range(kept - 1, max(kept - memory, 0) - 1, -1):
            slot = k % memory
            weight[slot] = inverse[slot] * _dot(moves[slot], step)
            _add(step, -weight[slot], changes[slot])
        step *= scale
        for k in range(max(kept - memory, 0), kept):
            slot = k % memory
            along = inverse[slot] * _dot(changes[slot], step)
            _add(step, weight[slot] - along, moves[slot])
        if not _dot(step, flat) > 0:
            step[:] = 0.05 * flat
        longest = _longest(rows)
        if longest > largest:
            step *= largest / longest
        far = 0.0
        for i in range(count):
            moved = 0.0
            for axis in range(3):
                x[i, axis] += rows[i, axis]
                moved += (x[i, axis] - reference[i, axis]) ** 2
            far = max(far, moved)
        if far > (0.5 * skin) ** 2:
            start, index = list_neighbours(x, CUTOFF + skin)
            reference[:] = x
            lists += 1
        set_pair_forces(x, tumour, start, index, shape, stiffness, after)
        residual, evaluations = _longest(after), evaluations + 1
        for k in range(3 * count):
            flat[k] -= flat_after[k]  # now force before minus force after
        curvature = _dot(step, flat)
        size = math.sqrt(_dot(step, step) * _dot(flat, flat))
        if curvature > 1e-8 * size:
            slot = kept % memory
            changes[slot][:] = flat
            moves[slot][:] = step
            inverse[slot] = 1.0 / curvature
            scale = curvature / _dot(flat, flat)
            kept += 1
        flat[:] = flat_after
    return x, residual, evaluations, lists


def relax_lbfgs(
    position: Float[np.ndarray, "n 3"],
    *,
    tolerance: float,
    tumour: Bool[np.ndarray, " n"] | None = None,
    adhesion: float = 0.2,
    smoothing: float = 0.1,
    tumour_stiffness: float = 1.0,
    max_steps: int = 3000,
    memory: int = 6,
    largest_step: float = 0.1,
    first: float = 0.1,
    skin: float = 0.4,
) -> Relaxed:
    """Bring free particles to equilibrium.

    Args:
        position: in r0.
        tolerance: largest force allowed at the end, in F(0).
        tumour: which particles are of the tumour; None for all.
        adhesion: of the law, as are `smoothing` and `tumour_stiffness`.
        smoothing: of the law.
        tumour_stiffness: of the law.
        max_steps: bound on the number of steps.
        memory: pairs that are remembered.
        largest_step: longest displacement in one step, in r0.
        first: displacement per force of the first step.
        skin: extra radius of the list, in r0.
    """
    if tumour is None:
        tumour = np.ones(len(position), dtype=np.bool_)
    law = shape_of(adhesion, smoothing), tumour_stiffness
    limits = tolerance, max_steps, memory, largest_step, first, skin
    return Relaxed(*_relax(position, tumour, *law, *limits))

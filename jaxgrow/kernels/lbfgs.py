"""L-BFGS two-loop recursion for compiled loops.

It uses the memory of `jaxgrow.equilibrium.lbfgs`. The recursion reads every pair twice,
and the step after each: the update of the step by one pair and its scalar product with
the next are computed in one pass.
"""

import math
from typing import no_type_check

import numpy as np
from numba import njit

from jaxgrow.kernels.layout import Memory
from jaxgrow.kernels.regrouped import regrouped


@regrouped
@no_type_check
def dot(a: np.ndarray, b: np.ndarray) -> float:
    """Compute the scalar product of two vectors."""
    total = 0.0
    for k in range(len(a)):
        total += a[k] * b[k]
    return total


@regrouped
@no_type_check
def _add(
    step: np.ndarray, factor: float, way: np.ndarray, scale: float, along: np.ndarray
) -> float:
    """Update the step to scale (step + factor way).

    The result is the scalar product of the new step with `along`.
    """
    total = 0.0
    for k in range(len(step)):
        new = scale * (step[k] + factor * way[k])
        step[k] = new
        total += new * along[k]
    return total


@njit(cache=True)
@no_type_check
def propose(memory: Memory, force: np.ndarray, step: np.ndarray) -> None:
    """Compute the L-BFGS displacement for a force.

    Args:
        memory: of these nodes, followed by any number of others with entries of 0.
        force: all coordinates in a row.
        step: likewise; written.
    """
    pairs, size = len(memory.inverse), len(step)
    slots, weight = np.zeros(pairs, np.int64), np.zeros(pairs)
    kept = 0
    for k in range(pairs):  # from the oldest to the newest
        slot = (memory.oldest[0] + k) % pairs
        if memory.inverse[slot] > 0.0:
            slots[kept] = slot
            kept += 1
    scale = memory.scale[0]
    step[:] = force
    if kept == 0:
        step *= scale
        return
    s, y = memory.displacement, memory.change
    along = dot(s[slots[kept - 1]][:size], step)
    for k in range(kept - 1, 0, -1):
        slot = slots[k]
        weight[k] = memory.inverse[slot] * along
        then = s[slots[k - 1]][:size]
        along = _add(step, -weight[k], y[slot][:size], 1.0, then)
    first = slots[0]
    weight[0] = memory.inverse[first] * along
    along = _add(step, -weight[0], y[first][:size], scale, y[first][:size])
    for k in range(kept):
        slot = slots[k]
        then = y[slots[min(k + 1, kept - 1)]][:size]
        rest = weight[k] - memory.inverse[slot] * along
        along = _add(step, rest, s[slot][:size], 1.0, then)


@regrouped
@no_type_check
def learn(
    memory: Memory, displacement: np.ndarray, before: np.ndarray, after: np.ndarray
) -> None:
    """Store the pair of a step, if the curvature along it is positive."""
    curvature, square, length = 0.0, 0.0, 0.0
    for k in range(len(before)):
        change = before[k] - after[k]
        curvature += displacement[k] * change
        square += change * change
        length += displacement[k] * displacement[k]
    if not curvature > 1e-8 * math.sqrt(length * square):
        return
    slot = memory.oldest[0]
    for k in range(len(before)):
        memory.displacement[slot, k] = displacement[k]
        memory.change[slot, k] = before[k] - after[k]
    memory.inverse[slot] = 1.0 / curvature
    memory.oldest[0] = (slot + 1) % len(memory.inverse)
    memory.scale[0] = curvature / square

"""L-BFGS descent as one compiled loop: all steps of a relaxation.

It evaluates, learns, proposes, bounds and moves, and rebuilds lists, until the
tolerance is reached, or the host must rebuild the list of collisions. The names are
those of `jaxgrow.equilibrium.descent`, which explains them and their order.
"""

import math
from typing import no_type_check

import numpy as np
from numba import njit

from jaxgrow.kernels.layout import (
    AWAY,
    Bounds,
    CODE,
    FULL,
    Lists,
    Memory,
    Now,
    OLD_COLLISIONS,
    OVERFLOWN,
    Scene,
    STEPS,
)
from jaxgrow.kernels.lbfgs import dot, learn, propose
from jaxgrow.kernels.lists import relist
from jaxgrow.kernels.regrouped import regrouped
from jaxgrow.kernels.tables import make_tables, run
from jaxgrow.runtime.results import Result


CONVERGED, STEP_LIMIT = Result.CONVERGED.code, Result.STEP_LIMIT.code
NON_FINITE, OVERFLOW = Result.NON_FINITE.code, Result.OVERFLOW.code
ON_MEMBRANE = Result.ON_MEMBRANE.code


@njit(cache=True)
@no_type_check
def _masked(force: np.ndarray, free: np.ndarray, into: np.ndarray) -> float:
    """Copy the forces on free nodes in a row, and return the largest norm.

    It is NaN if one of them is NaN.
    """
    most = 0.0
    for i in range(len(free)):
        square = 0.0
        for axis in range(3):
            part = force[i, axis] if free[i] else 0.0
            into[3 * i + axis] = part
            square += part * part
        if not square <= most:
            most = square
            if math.isnan(square):
                into[0] = np.nan
                return np.nan
    return math.sqrt(most)


@regrouped
@no_type_check
def _bound(
    step: np.ndarray, free: np.ndarray, clear: np.ndarray, largest: float
) -> bool:
    """Bound a step: scale it as a whole, then each row by its clearance.

    The longest row is scaled to `largest` at most, then each row is clipped to 0.4 of
    its clearance.

    Returns:
        Whether a free node has no clearance at all.
    """
    longest = 0.0
    for i in range(len(step)):
        square = step[i, 0] ** 2 + step[i, 1] ** 2 + step[i, 2] ** 2
        longest = max(longest, square)
    longest = math.sqrt(longest)
    whole = min(1.0, largest / longest) if longest > 0.0 else 1.0
    stuck = False
    for i in range(len(step)):
        limit = min(largest, 0.4 * clear[i]) if free[i] else 0.0
        stuck |= bool(free[i]) and limit == 0.0
        square = step[i, 0] ** 2 + step[i, 1] ** 2 + step[i, 2] ** 2
        length = whole * math.sqrt(square)
        cut = whole * min(1.0, limit / length) if length > 0.0 else 0.0
        for axis in range(3):
            step[i, axis] *= cut
    return stuck


@njit(cache=True)
@no_type_check
def descend(
    frame: int,
    changed: int,
    addresses: np.ndarray,
    wiring: np.ndarray,
    scene: Scene,
    bounds: Bounds,
    wide: Lists,
    listed: Lists,
    now: Now,
    memory: Memory,
) -> None:
    """Make steps until the end, or until the host must list collisions.

    In that case it must do so at the trial positions.

    Args:
        frame: address of XLA's call, whose arguments are the buffers of the terms.
        changed: number of the first argument that became a result.
        addresses: of the terms' roots (see `jaxgrow.kernels.roots`).
        wiring: numbers of the arguments that are their buffers.
        scene: the constant arrays.
        bounds: of the descent, and of the validity of its lists.
        wide: wide lists; written.
        listed: near ones; written.
        now: state of the descent; written.
        memory: of L-BFGS; written.
    """
    count, total = len(scene.alive), len(scene.free)
    place = np.zeros((total + len(scene.still), 3))
    place[:count], place[count:total] = now.trial_particles, now.trial_vertices
    place[total:] = scene.still
    for i in range(count):
        if not scene.alive[i]:
            place[i] = AWAY
    moving = total  # nodes after the last free one are skipped
    while moving > 0 and not scene.free[moving - 1]:
        moving -= 1
    free, way = scene.free[:moving], now.step[:moving]
    force, clear = np.zeros(place.shape), np.zeros(len(place))
    given = changed, count, place, place[:0], force, clear
    tables = make_tables(frame, wiring, *given)
    before, after = np.zeros(3 * moving), np.zeros(3 * moving)
    force[:count], force[count:total] = now.on_particles, now.on_vertices
    _masked(force, free, before)
    counts, flat = now.counts, now.step.reshape(-1)[: 3 * moving]
    overflown = counts[OVERFLOWN] != 0
    while True:
        relist(scene, bounds, wide, listed, place, counts)
        if counts[OLD_COLLISIONS]:
            return
        for full in FULL:
            overflown |= counts[full] != 0
        force[:], clear[:] = 0.0, np.inf
        force[count : count + len(scene.load)] = scene.load
        run(addresses, tables)
        residual = _masked(force, free, after)
        first = counts[STEPS] < 0
        counts[STEPS] += 1
        counts[CODE] = STEP_LIMIT if residual > bounds.tolerance else CONVERGED
        if not residual < np.inf:
            counts[CODE] = NON_FINITE
        if overflown:
            counts[CODE] = OVERFLOW
        failed = counts[CODE] == OVERFLOW or counts[CODE] == NON_FINITE
        if first or not failed:
            now.on_particles[:], now.on_vertices[:] = force[:count], force[count:total]
            now.residual[0] = residual
        if failed:
            return
        if not first:
            learn(memory, flat, before, after)
        for i in range(count):
            if scene.alive[i]:
                now.particles[i] = place[i]
        now.vertices[:] = place[count:total]
        before, after = after, before
        if counts[CODE] == CONVERGED:
            return
        propose(memory, before, flat)
        if not dot(flat, before) > 0.0:
            flat[:] = 0.05 * before
        if _bound(way, free, clear, bounds.largest):
            counts[CODE] = ON_MEMBRANE
            return
        for i in range(moving):
            if free[i]:
                for axis in range(3):
                    place[i, axis] += way[i, axis]
        for i in range(count):
            if scene.alive[i]:
                now.trial_particles[i] = place[i]
        now.trial_vertices[:] = place[count:total]
        if counts[STEPS] >= bounds.steps:
            return

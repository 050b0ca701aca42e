"""The loop of `jaxgrow.equilibrium.descent` with L-BFGS: all steps of a relaxation.

It evaluates, learns, proposes, bounds and moves, and makes lists anew, until the
tolerance is reached, or the host must list what may collide. The names are those of
that module, which says what they do and in which order.
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
    """Write the forces that count, all coordinates in a row; the largest of them.

    NaN if one is not a number.
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
    """Cut a step: to the largest as a whole, then row by row to 0.4 of the clearance.

    Returns:
        Whether something that may move has no clearance at all.
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
    """Make steps until the end, or until the host must list collisions at the trial.

    Args:
        frame: address of XLA's call, whose arguments are the buffers of the terms.
        changed: number of the first argument that became a result.
        addresses: of the terms' roots (see `jaxgrow.kernels.roots`).
        wiring: numbers of the arguments that are their buffers.
        scene: what does not change.
        bounds: numbers that end the loop, or a list.
        wide: wide lists; written.
        listed: near ones; written.
        now: where the descent stands; written.
        memory: of L-BFGS; written.
    """
    count, total = len(scene.alive), len(scene.free)
    place = np.zeros((total + len(scene.still), 3))
    place[:count], place[count:total] = now.trial_particles, now.trial_vertices
    place[total:] = scene.still
    for i in range(count):
        if not scene.alive[i]:
            place[i] = AWAY
    moving = total  # behind the last node that may move there is only padding
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

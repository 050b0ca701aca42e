"""The loop over pairs of particles of `jaxgrow.energy.pair.pair_force`."""

import math
from typing import no_type_check

import numpy as np
from numba import cfunc

from jaxgrow.kernels import frames
from jaxgrow.kernels.laws import a2, branches
from jaxgrow.kernels.layout import AWAY
from jaxgrow.kernels.regrouped import regrouped


@regrouped
@no_type_check
def add_up(
    position: np.ndarray,
    tumour: np.ndarray,
    listed: np.ndarray,
    law: np.ndarray,
    force: np.ndarray,
) -> None:
    """Write the pair force on every particle.

    First the near neighbours of a particle are put in a row, then the law is evaluated
    along it: both are loops without a branch, which run on several pairs at once.

    Args:
        position: of the particles, in r0, dead ones at `AWAY` or beyond.
        tumour: which are of the tumour.
        listed: neighbours of each, neighbour-major; n and above for empty entries.
        law: adhesion, smoothing, stiffness of pairs of tumour particles, and distance
            in r0 beyond which no pair interacts.
        force: in F(0); written.
    """
    room, count = listed.shape
    adhesion, smoothing, stiffness, cutoff = law[0], law[1], law[2], law[3]
    low, blend, edge, tail = branches(smoothing, cutoff)
    gap = np.zeros((3, room + 1))
    square = np.zeros(room + 1)
    factor = np.ones(room + 1)
    farthest = cutoff * cutoff
    for i in range(count):
        x, y, z = position[i, 0], position[i, 1], position[i, 2]
        if x >= AWAY:
            force[i, 0], force[i, 1], force[i, 2] = 0.0, 0.0, 0.0
            continue
        stiffer = tumour[i] and stiffness != 1.0
        near = 0
        for k in range(room):
            j = listed[k, i]
            if j < count:
                dx, dy, dz = x - position[j, 0], y - position[j, 1], z - position[j, 2]
                apart = dx * dx + dy * dy + dz * dz
                gap[0, near], gap[1, near], gap[2, near] = dx, dy, dz
                square[near] = apart
                if stiffer:
                    factor[near] = stiffness if tumour[j] else 1.0
                # NaN counts as near, so that the force becomes NaN too
                near += (not apart > farthest) & (apart != 0.0)
        fx, fy, fz = 0.0 * x, 0.0 * y, 0.0 * z  # NaN without neighbours too
        for k in range(near):
            u = math.sqrt(square[k])
            ratio = a2(u, adhesion, low, blend, edge, tail) / u
            if stiffer:
                ratio *= factor[k]
            fx += ratio * gap[0, k]
            fy += ratio * gap[1, k]
            fz += ratio * gap[2, k]
        force[i, 0], force[i, 1], force[i, 2] = fx, fy, fz


@cfunc(frames.HANDLER, cache=True)
@no_type_check
def handler(frame: int) -> int:
    """For XLA: arguments and result as of `add_up`."""
    if frames.answers_version(frame):
        return 0
    room, count = frames.size(frame, 2, 0), frames.size(frame, 2, 1)
    add_up(
        frames.reals(frames.argument(frame, 0), (count, 3)),
        frames.booleans(frames.argument(frame, 1), (count,)),
        frames.indices(frames.argument(frame, 2), (room, count)),
        frames.reals(frames.argument(frame, 3), (4,)),
        frames.reals(frames.result(frame, 0), (count, 3)),
    )
    return 0

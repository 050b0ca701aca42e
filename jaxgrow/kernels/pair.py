"""Loops over pairs of particles, for a printed law.

The law is that of `jaxgrow.energy.pair`.
"""

import math
from typing import Any, no_type_check

import numpy as np

from jaxgrow.kernels.layout import AWAY
from jaxgrow.kernels.regrouped import regrouped


@regrouped
@no_type_check
def add_forces(
    slope: Any,
    position: np.ndarray,
    tumour: np.ndarray,
    listed: np.ndarray,
    cutoff: float,
    p: tuple,
    force: np.ndarray,
) -> None:
    """Add the pair force on every particle.

    First the near neighbours of a particle are gathered in an array, then the law is
    evaluated on it: both loops are without branches, and are vectorised over pairs.

    Args:
        slope: derivative of a pair's energy: function of distance, species and
            parameters.
        position: of the particles, in r0, dead ones at `AWAY` or beyond.
        tumour: 1 for those of the tumour.
        listed: neighbours of each, neighbour-major; n and above for empty entries.
        cutoff: distance in r0 beyond which no pair interacts.
        p: parameters of the law.
        force: in F(0); added to.
    """
    room, count = listed.shape
    gap, kind = np.zeros((3, room + 1)), np.zeros(room + 1)
    square = np.zeros(room + 1)
    farthest = cutoff * cutoff
    for i in range(count):
        x, y, z = position[i, 0], position[i, 1], position[i, 2]
        if x >= AWAY:
            continue
        near, own = 0, float(tumour[i])
        for k in range(room):
            j = listed[k, i]
            if j < count:
                dx, dy, dz = x - position[j, 0], y - position[j, 1], z - position[j, 2]
                apart = dx * dx + dy * dy + dz * dz
                gap[0, near], gap[1, near], gap[2, near] = dx, dy, dz
                square[near], kind[near] = apart, float(tumour[j])
                # NaN counts as near, so that the force becomes NaN too
                near += (not apart > farthest) & (apart != 0.0)
        fx, fy, fz = 0.0 * x, 0.0 * y, 0.0 * z  # NaN without neighbours too
        for k in range(near):
            u = math.sqrt(square[k])
            ratio = slope(u, own, kind[k], *p)[0] / u
            fx -= ratio * gap[0, k]
            fy -= ratio * gap[1, k]
            fz -= ratio * gap[2, k]
        force[i, 0] += fx
        force[i, 1] += fy
        force[i, 2] += fz


@regrouped
@no_type_check
def add_products(
    slopes: Any,
    position: np.ndarray,
    tumour: np.ndarray,
    listed: np.ndarray,
    cutoff: float,
    p: tuple,
    along: np.ndarray,
    product: np.ndarray,
) -> None:
    """Add the Hessian product of the pair energy with a displacement.

    Args:
        slopes: first and second derivative of the energy of a pair.
        position: as for `add_forces`, like the arguments below.
        tumour: likewise.
        listed: likewise.
        cutoff: likewise.
        p: likewise.
        along: the displacement.
        product: in F(0)/r0 times the unit of the displacement; added to.
    """
    room, count = listed.shape
    gap, way, kind = (
        np.zeros((3, room + 1)),
        np.zeros((3, room + 1)),
        np.zeros(room + 1),
    )
    square = np.zeros(room + 1)
    farthest = cutoff * cutoff
    for i in range(count):
        x, y, z = position[i, 0], position[i, 1], position[i, 2]
        if x >= AWAY:
            continue
        near, own = 0, float(tumour[i])
        vx, vy, vz = along[i, 0], along[i, 1], along[i, 2]
        for k in range(room):
            j = listed[k, i]
            if j < count:
                dx, dy, dz = x - position[j, 0], y - position[j, 1], z - position[j, 2]
                apart = dx * dx + dy * dy + dz * dz
                gap[0, near], gap[1, near], gap[2, near] = dx, dy, dz
                way[0, near], way[1, near] = vx - along[j, 0], vy - along[j, 1]
                way[2, near] = vz - along[j, 2]
                square[near], kind[near] = apart, float(tumour[j])
                near += (not apart > farthest) & (apart != 0.0)
        fx, fy, fz = 0.0, 0.0, 0.0
        for k in range(near):
            u = math.sqrt(square[k])
            slope, curvature = slopes(u, own, kind[k], *p)
            ratio = slope / u
            on = gap[0, k] * way[0, k] + gap[1, k] * way[1, k] + gap[2, k] * way[2, k]
            on *= (curvature - ratio) / square[k]
            fx += ratio * way[0, k] + on * gap[0, k]
            fy += ratio * way[1, k] + on * gap[1, k]
            fz += ratio * way[2, k] + on * gap[2, k]
        product[i, 0] += fx
        product[i, 1] += fy
        product[i, 2] += fz


@regrouped
@no_type_check
def add_blocks(
    slopes: Any,
    position: np.ndarray,
    tumour: np.ndarray,
    listed: np.ndarray,
    cutoff: float,
    p: tuple,
    blocks: np.ndarray,
) -> None:
    """Add the diagonal blocks of the pair energy's Hessian.

    Each pair at distance u along n adds U'' n nᵀ + U'/u (1 - n nᵀ).

    Args:
        slopes: first and second derivative of the energy of a pair.
        position: as for `add_forces`, like the arguments below.
        tumour: likewise.
        listed: likewise.
        cutoff: likewise.
        p: likewise.
        blocks: in F(0)/r0, of each particle in a row; added to.
    """
    room, count = listed.shape
    gap = np.zeros(3)
    for i in range(count):
        if position[i, 0] >= AWAY:
            continue
        for k in range(room):
            j = listed[k, i]
            if j >= count:
                continue
            for axis in range(3):
                gap[axis] = position[i, axis] - position[j, axis]
            square = gap[0] * gap[0] + gap[1] * gap[1] + gap[2] * gap[2]
            if square > cutoff * cutoff or square == 0.0:
                continue
            u = math.sqrt(square)
            slope, curvature = slopes(u, float(tumour[i]), float(tumour[j]), *p)
            ratio = slope / u
            factor = (curvature - ratio) / square
            for row in range(3):
                blocks[i, 4 * row] += ratio
                for column in range(3):
                    blocks[i, 3 * row + column] += factor * gap[row] * gap[column]

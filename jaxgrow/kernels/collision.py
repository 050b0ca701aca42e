"""The loops over pairs of `jaxgrow.energy.collision.collision_energy`.

The forces are minus the gradient of that energy. That of a distance is the one at fixed
closest points (envelope theorem).
"""

import math
from typing import no_type_check

import numpy as np

from jaxgrow.kernels.closest import (
    closest_of_segments,
    LENGTH,
    measure,
    OF_B,
    OF_C,
)
from jaxgrow.kernels.laws import a2, branches, steepness
from jaxgrow.kernels.layout import Pairs
from jaxgrow.kernels.regrouped import regrouped
from jaxgrow.kernels.smooth_minimum import smooth_minima


@regrouped
@no_type_check
def add_up(
    points: np.ndarray,
    pairs: Pairs,
    law: np.ndarray,
    force: np.ndarray,
    clear: np.ndarray,
) -> None:
    """Add the forces of collisions, and bound distances to what may not be crossed.

    Args:
        points: the membrane's vertices, then the static ones, in r0.
        pairs: that are near.
        law: collision range and stiffness, smoothing, sharpness, stiffness of the
            barrier, and the squared sine below which edges are nearly parallel.
        force: on all points, in F(0); added to.
        clear: distances in r0, the least so far; lowered.
    """
    _add_vertices(points, pairs, law, force, clear)
    _add_edges(points, pairs, law, force, clear)


@regrouped
@no_type_check
def _add_vertices(
    points: np.ndarray,
    pairs: Pairs,
    law: np.ndarray,
    force: np.ndarray,
    clear: np.ndarray,
) -> None:
    """Those of vertices against triangles."""
    scale, stiffness, half, barrier = law[0], law[1], 0.5 * law[3], law[4]
    low, blend, edge, tail = branches(law[2], 1.5)
    owner, corners, margin = pairs.vertex, pairs.corners, pairs.vertex_margin
    count = len(owner)
    while count > 0 and not margin[count - 1] > 0.0:
        count -= 1
    found = np.zeros((6, count))
    measure(points, owner[:count], points, corners[:count].T, found)
    value, u, slope = np.zeros(count), np.zeros(count), np.zeros(count)
    for pair in range(count):
        value[pair] = 1.0
        if margin[pair] > 0.0:
            i, length = owner[pair], found[LENGTH, pair]
            clear[i] = min(clear[i], length)
            for corner in range(3):
                node = corners[pair, corner]
                clear[node] = min(clear[node], length)
            if pairs.apart[pair]:
                value[pair] = length / scale
    smooth_minima(owner[:count], value, half, 1.0, u, slope)
    push = 0.0
    for pair in range(count):
        i, length = owner[pair], found[LENGTH, pair]
        if pair == 0 or i != owner[pair - 1]:
            push = 0.0
            if u[pair] < 1.0:
                push = stiffness * a2(u[pair], 0.0, low, blend, edge, tail)
        size = push * slope[pair]
        if margin[pair] > 0.0:
            size += barrier * steepness(length / scale, margin[pair])
        if size > 0.0 and length > 0.0:
            size /= length
            v, w = found[OF_B, pair], found[OF_C, pair]
            for axis in range(3):
                part = size * found[axis, pair]
                force[i, axis] += part
                force[corners[pair, 0], axis] -= part * (1.0 - v - w)
                force[corners[pair, 1], axis] -= part * v
                force[corners[pair, 2], axis] -= part * w


@regrouped
@no_type_check
def _add_edges(
    points: np.ndarray,
    pairs: Pairs,
    law: np.ndarray,
    force: np.ndarray,
    clear: np.ndarray,
) -> None:
    """Those of edges against edges: of m(sin²) b(u)."""
    scale, barrier, parallel = law[0], law[4], law[5]
    for pair in range(len(pairs.edges)):
        margin = pairs.edge_margin[pair]
        if not margin > 0.0:
            continue
        ends = pairs.edges[pair]
        a, b, c, d = ends[0], ends[1], ends[2], ends[3]
        found = closest_of_segments(points[a], points[b], points[c], points[d])
        length = math.sqrt(found[3])
        for node in (a, b, c, d):
            clear[node] = min(clear[node], length)
        u = length / scale
        if not 0.0 < u < margin:
            continue
        square, along, square_other = 0.0, 0.0, 0.0
        for axis in range(3):
            one = points[b, axis] - points[a, axis]
            other = points[d, axis] - points[c, axis]
            square += one * one
            along += one * other
            square_other += other * other
        whole = square * square_other
        area = 0.0
        for axis in range(3):
            y, z = (axis + 1) % 3, (axis + 2) % 3
            cross = (points[b, y] - points[a, y]) * (points[d, z] - points[c, z])
            cross -= (points[b, z] - points[a, z]) * (points[d, y] - points[c, y])
            area += cross * cross
        sine = area / whole if whole > 0.0 else 0.0
        share = min(sine / parallel, 1.0)
        size = barrier * share * (2.0 - share) * steepness(u, margin) / length
        # where m is not 1, its own derivative: b dm/dsin² · dsin²/d(one, other)
        fading = 0.0
        if share < 1.0 and whole > 0.0:
            wall = -((u - margin) ** 2) * math.log(u / margin)
            fading = 2.0 * barrier * scale * wall * (1.0 - share) / parallel / whole
        s, t = found[4], found[5]
        for axis in range(3):
            part = size * found[axis]
            force[a, axis] += part * (1.0 - s)
            force[b, axis] += part * s
            force[c, axis] -= part * (1.0 - t)
            force[d, axis] -= part * t
            if fading > 0.0:
                one = points[b, axis] - points[a, axis]
                other = points[d, axis] - points[c, axis]
                # d sin² / d one, but for 2 / (|one|² |other|²); likewise of the other
                of_one = square_other * one * (1.0 - sine) - along * other
                of_other = square * other * (1.0 - sine) - along * one
                force[b, axis] -= 2.0 * fading * of_one
                force[a, axis] += 2.0 * fading * of_one
                force[d, axis] -= 2.0 * fading * of_other
                force[c, axis] += 2.0 * fading * of_other

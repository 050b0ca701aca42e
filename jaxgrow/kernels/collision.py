"""Loops over collision pairs of the surface, for a printed law.

The law is that of `jaxgrow.energy.collision`; this module has the geometry.
"""

import math
from typing import Any, no_type_check

import numpy as np

from jaxgrow.kernels.closest import closest_of_segments, LENGTH, OF_B, OF_C
from jaxgrow.kernels.regrouped import regrouped
from jaxgrow.kernels.smooth_distance import (
    add_bent,
    add_squares,
    approach,
    smooth_distances,
)
from jaxgrow.kernels.smooth_minimum import smooth_changes


@regrouped
@no_type_check
def _counted(apart: np.ndarray, margin: np.ndarray) -> np.ndarray:
    """Mark the pairs with a smooth distance, up to the padding at the end."""
    count = len(margin)
    while count > 0 and not margin[count - 1] > 0.0:
        count -= 1
    counts = np.zeros(count, np.bool_)
    for pair in range(count):
        counts[pair] = margin[pair] > 0.0 and apart[pair]
    return counts


@regrouped
@no_type_check
def add_forces(
    slope_of: Any,
    wall_of: Any,
    points: np.ndarray,
    vertex: np.ndarray,
    corners: np.ndarray,
    apart: np.ndarray,
    margin: np.ndarray,
    scale: float,
    half: float,
    p: tuple,
    force: np.ndarray,
    clear: np.ndarray,
) -> None:
    """Add the forces of vertices against triangles, and update clearances.

    Args:
        slope_of: derivative of the repulsion: function of a smooth distance and the
            parameters.
        wall_of: derivative of the barrier: function of distance, margin and parameters.
        points: the membrane's vertices, then the static ones, in r0.
        vertex: of each pair, ascending.
        corners: of its triangle.
        apart: whether the two are far from each other along the surface.
        margin: distance at which the barrier begins, in collision ranges; 0 for
            padding.
        scale: collision range, in r0.
        half: half of the sharpness.
        p: parameters of the laws.
        force: on all points, in F(0); added to.
        clear: least distances so far, in r0; lowered.
    """
    counts = _counted(apart, margin)
    count = len(counts)
    owner, own = vertex[:count], corners[:count].T
    given = points, owner, points, own, counts, scale, half, 1.0
    found, _, u, slope, _ = smooth_distances(*given)
    push = 0.0
    for pair in range(count):
        i, length = vertex[pair], found[LENGTH, pair]
        a, b, c = corners[pair, 0], corners[pair, 1], corners[pair, 2]
        if pair == 0 or i != vertex[pair - 1]:
            push = -slope_of(u[pair], *p)[0] / scale if u[pair] < 1.0 else 0.0
        size = push * slope[pair]
        if margin[pair] > 0.0:
            for node in (i, a, b, c):
                clear[node] = min(clear[node], length)
            if length < margin[pair] * scale:
                size -= wall_of(length, margin[pair], *p)[0]
        if size > 0.0 and length > 0.0:
            size /= length
            v, w = found[OF_B, pair], found[OF_C, pair]
            for axis in range(3):
                part = size * found[axis, pair]
                force[i, axis] += part
                force[a, axis] -= part * (1.0 - v - w)
                force[b, axis] -= part * v
                force[c, axis] -= part * w


@regrouped
@no_type_check
def add_products(
    slopes_of: Any,
    walls_of: Any,
    points: np.ndarray,
    vertex: np.ndarray,
    corners: np.ndarray,
    apart: np.ndarray,
    margin: np.ndarray,
    scale: float,
    half: float,
    p: tuple,
    way: np.ndarray,
    product: np.ndarray,
) -> None:
    """Add the Hessian product of the energy of `add_forces`; see there.

    Args:
        slopes_of: first and second derivative of the repulsion.
        walls_of: of the barrier.
        points: as for `add_forces`, like the arguments below.
        vertex: likewise.
        corners: likewise.
        apart: likewise.
        margin: likewise.
        scale: likewise.
        half: likewise.
        p: likewise.
        way: displacement of all points.
        product: added to.
    """
    counts = _counted(apart, margin)
    count = len(counts)
    owner, own = vertex[:count], corners[:count].T
    given = points, owner, points, own, counts, scale, half, 1.0
    found, value, u, slope, power = smooth_distances(*given)
    moved, turned, along = np.zeros(count), np.zeros(count), np.zeros(count)
    for pair in range(count):
        if slope[pair] > 0.0:
            a, b, c = corners[pair, 0], corners[pair, 1], corners[pair, 2]
            moved[pair] = approach(found, pair, way, vertex[pair], way, a, b, c) / scale
    smooth_changes(owner, value, moved, half, 1.0, u, slope, power, along, turned)
    push, second = 0.0, 0.0
    for pair in range(count):
        i, length = vertex[pair], found[LENGTH, pair]
        a, b, c = corners[pair, 0], corners[pair, 1], corners[pair, 2]
        if pair == 0 or i != vertex[pair - 1]:
            push, second = slopes_of(u[pair], *p) if u[pair] < 1.0 else (0.0, 0.0)
        if not (margin[pair] > 0.0 and length > 0.0):
            continue
        change = second * along[pair] * slope[pair] + push * turned[pair]
        change, size = change / scale, push * slope[pair] / scale
        if length < margin[pair] * scale:
            wall, steeper = walls_of(length, margin[pair], *p)
            change += steeper * approach(found, pair, way, i, way, a, b, c)
            size += wall
        if size != 0.0:
            given = points, a, b, c, way, way, product, product
            add_bent(change, size, found, pair, i, *given)


@regrouped
@no_type_check
def add_forces_of_edges(
    wall_of: Any,
    points: np.ndarray,
    edges: np.ndarray,
    margin: np.ndarray,
    scale: float,
    p: tuple,
    force: np.ndarray,
    clear: np.ndarray,
) -> None:
    """Add the forces of edges against edges, and update clearances.

    Args:
        wall_of: gradient of the barrier: function of the twelve coordinates of the four
            ends, of margin and parameters.
        points: the membrane's vertices, then the static ones, in r0.
        edges: the four ends of each pair.
        margin: distance at which the barrier begins, in collision ranges; 0 for
            padding.
        scale: collision range, in r0.
        p: parameters of the law.
        force: on all points, in F(0); added to.
        clear: least distances so far, in r0; lowered.
    """
    for pair in range(len(edges)):
        if not margin[pair] > 0.0:
            continue
        ends = edges[pair]
        length = _between(points, ends)
        for node in ends:
            clear[node] = min(clear[node], length)
        if 0.0 < length < margin[pair] * scale:
            a, b, c, d = ends[0], ends[1], ends[2], ends[3]
            g = wall_of(
                *(points[a, 0], points[a, 1], points[a, 2]),
                *(points[b, 0], points[b, 1], points[b, 2]),
                *(points[c, 0], points[c, 1], points[c, 2]),
                *(points[d, 0], points[d, 1], points[d, 2]),
                margin[pair],
                *p,
            )
            for axis in range(3):
                force[a, axis] -= g[axis]
                force[b, axis] -= g[3 + axis]
                force[c, axis] -= g[6 + axis]
                force[d, axis] -= g[9 + axis]


@regrouped
@no_type_check
def add_products_of_edges(
    walls_of: Any,
    points: np.ndarray,
    edges: np.ndarray,
    margin: np.ndarray,
    scale: float,
    p: tuple,
    way: np.ndarray,
    product: np.ndarray,
) -> None:
    """Add the Hessian product of the energy of `add_forces_of_edges`.

    Args:
        walls_of: Hessian product of the barrier: function of twelve coordinates, twelve
            displacements, margin and parameters.
        points: as for `add_forces_of_edges`, like the arguments below.
        edges: likewise.
        margin: likewise.
        scale: likewise.
        p: likewise.
        way: displacement of all points.
        product: added to.
    """
    for pair in range(len(edges)):
        ends = edges[pair]
        if not margin[pair] > 0.0:
            continue
        if 0.0 < _between(points, ends) < margin[pair] * scale:
            a, b, c, d = ends[0], ends[1], ends[2], ends[3]
            g = walls_of(
                *(points[a, 0], points[a, 1], points[a, 2]),
                *(points[b, 0], points[b, 1], points[b, 2]),
                *(points[c, 0], points[c, 1], points[c, 2]),
                *(points[d, 0], points[d, 1], points[d, 2]),
                *(way[a, 0], way[a, 1], way[a, 2]),
                *(way[b, 0], way[b, 1], way[b, 2]),
                *(way[c, 0], way[c, 1], way[c, 2]),
                *(way[d, 0], way[d, 1], way[d, 2]),
                margin[pair],
                *p,
            )
            for axis in range(3):
                product[a, axis] += g[axis]
                product[b, axis] += g[3 + axis]
                product[c, axis] += g[6 + axis]
                product[d, axis] += g[9 + axis]


@regrouped
@no_type_check
def add_blocks(
    slopes_of: Any,
    walls_of: Any,
    points: np.ndarray,
    vertex: np.ndarray,
    corners: np.ndarray,
    apart: np.ndarray,
    margin: np.ndarray,
    scale: float,
    half: float,
    p: tuple,
    blocks: np.ndarray,
) -> None:
    """Add approximate diagonal blocks of the Hessian of `add_forces`.

    See `jaxgrow.kernels.contact.add_blocks`; the barrier's second derivative is added.
    Pairs of edges are omitted, as there are pairs of a vertex and a triangle at the
    same places.

    Args:
        slopes_of: first and second derivative of the repulsion.
        walls_of: of the barrier.
        points: as for `add_forces`, like the arguments below.
        vertex: likewise.
        corners: likewise.
        apart: likewise.
        margin: likewise.
        scale: likewise.
        half: likewise.
        p: likewise.
        blocks: in F(0)/r0, of each point in a row; added to.
    """
    counts = _counted(apart, margin)
    count = len(counts)
    owner, own = vertex[:count], corners[:count].T
    given = points, owner, points, own, counts, scale, half, 1.0
    found, _, u, slope, _ = smooth_distances(*given)
    for pair in range(count):
        length, stiffness = found[LENGTH, pair], 0.0
        if not (margin[pair] > 0.0 and length > 0.0):
            continue
        if slope[pair] > 0.0 and u[pair] < 1.0:
            stiffness = slopes_of(u[pair], *p)[1] * slope[pair] / (scale * scale)
        if length < margin[pair] * scale:
            stiffness += walls_of(length, margin[pair], *p)[1]
        if stiffness > 0.0:
            a, b, c = corners[pair, 0], corners[pair, 1], corners[pair, 2]
            add_squares(stiffness, found, pair, vertex[pair], a, b, c, blocks, blocks)


@regrouped
@no_type_check
def _between(points: np.ndarray, ends: np.ndarray) -> float:
    """Compute the distance of two edges."""
    found = closest_of_segments(
        points[ends[0]], points[ends[1]], points[ends[2]], points[ends[3]]
    )
    return math.sqrt(found[3])

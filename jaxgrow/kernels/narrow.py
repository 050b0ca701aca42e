"""Narrow phase: near pairs of wide lists of contacts and of collisions.

The loops of `jaxgrow.energy.contact.narrow_contacts` and
`jaxgrow.energy.collision.narrow_collisions`.
"""

import math
from typing import no_type_check

import numpy as np

from jaxgrow.kernels.closest import closest_of_segments, LENGTH, measure
from jaxgrow.kernels.layout import Pairs, Touching
from jaxgrow.kernels.regrouped import regrouped
from jaxgrow.kernels.touching import pad


@regrouped
@no_type_check
def find_contacts(
    wide: Touching,
    position: np.ndarray,
    vertices: np.ndarray,
    radius: float,
    near: Touching,
) -> int:
    """Filter the contacts closer than a radius, in their order.

    Args:
        wide: the wide list.
        position: of the particles, in r0.
        vertices: of the membrane.
        radius: in r0.
        near: the near list; written, with padding at the end.

    Returns:
        Number of near contacts, listed or not.
    """
    room, count, pairs = len(near.real), 0, len(wide.real)
    while pairs > 0 and not wide.real[pairs - 1]:
        pairs -= 1
    found = np.zeros((6, pairs))
    owner, corners = wide.particle[:pairs], wide.corners[:, :pairs]
    measure(position, owner, vertices, corners, found)
    for pair in range(pairs):
        if wide.real[pair] and found[LENGTH, pair] < radius:
            if count < room:
                near.particle[count] = owner[pair]
                near.face[count] = wide.face[pair]
                for corner in range(3):
                    near.corners[corner, count] = corners[corner, pair]
                near.real[count] = True
            count += 1
    pad(near, count, len(position))
    return count


@regrouped
@no_type_check
def find_collisions(
    wide: Pairs,
    points: np.ndarray,
    scale: float,
    least: float,
    skin: float,
    near: Pairs,
) -> int:
    """Filter the collision pairs that can interact within a skin.

    They are all that do so until the moves of two vertices sum to a skin.

    Args:
        wide: the wide list.
        points: the membrane's vertices, then the static ones, in r0.
        scale: collision range, in r0.
        least: distance, in r0, up to which pairs are listed in any case.
        skin: extra distance, in r0.
        near: the near list; written, with padding at the end.

    Returns:
        Number of pairs of a vertex and a triangle, listed or not, or half the number of
        pairs of edges if that is more.
    """
    room, count, pairs = len(near.vertex), 0, len(wide.vertex)
    while pairs > 0 and not wide.vertex_margin[pairs - 1] > 0.0:
        pairs -= 1
    found = np.zeros((6, pairs))
    measure(points, wide.vertex[:pairs], points, wide.corners[:pairs].T, found)
    for pair in range(pairs):
        margin = wide.vertex_margin[pair]
        within = scale if wide.apart[pair] else scale * margin
        near_now = found[LENGTH, pair] < max(within, least) + skin
        if margin > 0.0 and near_now:
            if count < room:
                near.vertex[count] = wide.vertex[pair]
                near.corners[count] = wide.corners[pair]
                near.apart[count] = wide.apart[pair]
                near.vertex_margin[count] = margin
            count += 1
    for pair in range(count, room):
        near.vertex[pair], near.corners[pair] = len(points) - 1, 0
        near.apart[pair], near.vertex_margin[pair] = False, 0.0
    most, room, count = count, len(near.edges), 0
    for pair in range(len(wide.edges)):
        margin = wide.edge_margin[pair]
        if not margin > 0.0:
            continue
        ends = wide.edges[pair]
        a, b, c, d = points[ends[0]], points[ends[1]], points[ends[2]], points[ends[3]]
        between = math.sqrt(closest_of_segments(a, b, c, d)[3])
        if between < max(scale * margin, least) + skin:
            if count < room:
                near.edges[count], near.edge_margin[count] = ends, margin
            count += 1
    for pair in range(count, room):
        near.edges[pair], near.edge_margin[pair] = 0, 0.0
    return max(most, (count + 1) // 2)

"""Broad phase of collision detection: loops that list near pairs.

They are those of `jaxgrow.mesh.collision_mesh`. Candidates are pairs whose bounding
boxes are near, found by a sweep along the longest axis of the sheet.
"""

import math
from typing import no_type_check

import numpy as np
from numba import njit

from jaxgrow.kernels import distances


_Pairs = tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]
"""First and second of each pair, their distance, and whether they are apart."""

_ROUNDING = 1.0 + 1e-12
"""Factor of a distance, so that rounding omits no pair."""


@njit(cache=True, error_model="numpy")
@no_type_check
def _longest(vertices: np.ndarray) -> int:
    """Find the axis along which points are farthest apart."""
    longest, most = 0, -1.0
    for axis in range(3):
        low, high = np.inf, -np.inf
        for i in range(len(vertices)):
            low, high = min(low, vertices[i, axis]), max(high, vertices[i, axis])
        if high - low > most:
            longest, most = axis, high - low
    return longest


@njit(cache=True, error_model="numpy")
@no_type_check
def _neighbours(
    edges: np.ndarray, count: int
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Build the adjacency of vertices, in compressed rows.

    Returns where each vertex's neighbours begin, the neighbours, and the edges to them.
    """
    begin = np.zeros(count + 1, np.int64)
    for e in range(len(edges)):
        begin[edges[e, 0] + 1] += 1
        begin[edges[e, 1] + 1] += 1
    for i in range(count):
        begin[i + 1] += begin[i]
    place = begin[:-1].copy()
    head, edge = np.zeros(begin[count], np.int64), np.zeros(begin[count], np.int64)
    for e in range(len(edges)):
        for end in range(2):
            at = place[edges[e, end]]
            head[at], edge[at] = edges[e, 1 - end], e
            place[edges[e, end]] += 1
    return begin, head, edge


@njit(cache=True, error_model="numpy")
@no_type_check
def joined(
    edges: np.ndarray, length: np.ndarray, count: int, along: float
) -> tuple[np.ndarray, np.ndarray]:
    """List the vertices within a distance along edges of each vertex.

    The length of a path is summed from its start, as by Dijkstra's algorithm.

    Args:
        edges: of the sheet.
        length: of each.
        count: number of vertices.
        along: the bound.

    Returns:
        For each vertex, where those joined with it begin; and these vertices.
    """
    begin, head, edge = _neighbours(edges, count)
    first, reached = np.zeros(count + 1, np.int64), np.zeros(8 * count + 8, np.int64)
    best, waiting = np.full(count, np.inf), np.zeros(count, np.bool_)
    used = 0
    for source in range(count):
        if used + count > len(reached):
            reached = np.append(reached, np.zeros(len(reached) + count, np.int64))
        best[source], reached[used], last = 0.0, source, used + 1
        queue = [source]
        while len(queue) > 0:
            v = queue.pop()
            waiting[v] = False
            for at in range(begin[v], begin[v + 1]):
                w, far = head[at], best[v] + length[edge[at]]
                if far <= along and far < best[w]:
                    if best[w] == np.inf:
                        reached[last] = w
                        last += 1
                    best[w] = far
                    if not waiting[w]:
                        waiting[w] = True
                        queue.append(w)
        for at in range(used, last):
            best[reached[at]] = np.inf
        used = last
        first[source + 1] = used
    return first, reached[:used]


@njit(cache=True)
@no_type_check
def _are_joined(first: np.ndarray, reached: np.ndarray, v: int, w: int) -> bool:
    """Return whether two vertices are joined."""
    found = False
    for at in range(first[v], first[v + 1]):
        found |= reached[at] == w
    return found


@njit(cache=True)
@no_type_check
def _no_pairs(room: int) -> _Pairs:
    """Allocate arrays for a number of pairs."""
    return (
        np.zeros(room, np.int64),
        np.zeros(room, np.int64),
        np.zeros(room),
        np.zeros(room, np.bool_),
    )


@njit(cache=True)
@no_type_check
def _put(
    pairs: _Pairs, found: int, one: int, other: int, distance: float, far: bool
) -> _Pairs:
    """Add a pair after those found; full arrays are doubled."""
    firsts, seconds, distances_, fars = pairs
    if found == len(firsts):
        more = _no_pairs(found)
        firsts, seconds = np.append(firsts, more[0]), np.append(seconds, more[1])
        distances_, fars = np.append(distances_, more[2]), np.append(fars, more[3])
    firsts[found], seconds[found] = one, other
    distances_[found], fars[found] = distance, far
    return firsts, seconds, distances_, fars


@njit(cache=True, error_model="numpy")
@no_type_check
def vertices_and_faces(
    vertices: np.ndarray,
    faces: np.ndarray,
    moving: np.ndarray,
    first: np.ndarray,
    reached: np.ndarray,
    apart: float,
    local: float,
) -> _Pairs:
    """List the near pairs of a vertex and a face.

    Two elements are apart if none of their vertices are joined, see `joined`.

    Args:
        vertices: of the sheet.
        faces: of the sheet.
        moving: mask of the vertices of which one is in every pair.
        first: for each vertex, where those joined with it begin, see `joined`.
        reached: these vertices.
        apart: upper bound of the distance of pairs that are apart.
        local: upper bound of the distance of the others.

    Returns:
        Vertex, ascending, face, distance, and whether the two are apart.
    """
    reach = max(apart, local)
    wide = reach * _ROUNDING
    axis = _longest(vertices)
    one, two = (axis + 1) % 3, (axis + 2) % 3
    order = np.argsort(vertices[:, axis])
    sorted_ = vertices[order, axis]
    pairs, found = _no_pairs(8 * len(vertices) + 8), 0
    of_vertex = np.zeros(len(vertices) + 1, np.int64)
    low, high = np.zeros(3), np.zeros(3)
    for f in range(len(faces)):
        a, b, c = faces[f, 0], faces[f, 1], faces[f, 2]
        may_move = moving[a] or moving[b] or moving[c]
        for k in range(3):
            x, y, z = vertices[a, k], vertices[b, k], vertices[c, k]
            low[k], high[k] = min(x, y, z) - wide, max(x, y, z) + wide
        for at in range(np.searchsorted(sorted_, low[axis]), len(order)):
            if sorted_[at] > high[axis]:
                break
            v = order[at]
            x, y = vertices[v, one], vertices[v, two]
            if x < low[one] or x > high[one] or y < low[two] or y > high[two]:
                continue
            if v in (a, b, c) or not (may_move or moving[v]):
                continue
            gap = distances.to_triangle(vertices, v, vertices, a, b, c)[0]
            if not gap < reach:
                continue
            is_far = not (
                _are_joined(first, reached, v, a)
                or _are_joined(first, reached, v, b)
                or _are_joined(first, reached, v, c)
            )
            if gap < (apart if is_far else local):
                pairs = _put(pairs, found, v, f, gap, is_far)
                of_vertex[v + 1] += 1
                found += 1
    # faces ascend already; sorting by vertex keeps that
    for v in range(len(vertices)):
        of_vertex[v + 1] += of_vertex[v]
    vertex, face, distance, far = pairs
    place = np.zeros(found, np.int64)
    for i in range(found):
        place[of_vertex[vertex[i]]] = i
        of_vertex[vertex[i]] += 1
    return vertex[place], face[place], distance[place], far[place]


@njit(cache=True, error_model="numpy")
@no_type_check
def pairs_of_edges(
    vertices: np.ndarray,
    edges: np.ndarray,
    rank: np.ndarray,
    moving: np.ndarray,
    first: np.ndarray,
    reached: np.ndarray,
    apart: float,
    local: float,
) -> _Pairs:
    """List the near pairs of edges.

    Args:
        vertices: of the sheet.
        edges: of the sheet.
        rank: of each edge; the one of higher rank is the first of a pair.
        moving: see `vertices_and_faces`; so are the others.
        first: as there.
        reached: as there.
        apart: as there.
        local: as there.

    Returns:
        First edge, second edge, distance, and whether the two are apart; in no order.
    """
    count = len(edges)
    reach = max(apart, local)
    wide = reach * _ROUNDING
    axis = _longest(vertices)
    half, low, high = np.zeros(count), np.zeros(count), np.zeros(count)
    for e in range(count):
        a, b = edges[e, 0], edges[e, 1]
        square = 0.0
        for k in range(3):
            square += (vertices[a, k] - vertices[b, k]) ** 2
        half[e] = 0.5 * math.sqrt(square) * _ROUNDING
        low[e] = min(vertices[a, axis], vertices[b, axis])
        high[e] = max(vertices[a, axis], vertices[b, axis]) + wide
    order = np.argsort(low)
    low, high, half = low[order], high[order], half[order]
    ends = edges[order]
    middle = np.zeros((3, count))
    for i in range(count):
        for k in range(3):
            middle[k, i] = 0.5 * (vertices[ends[i, 0], k] + vertices[ends[i, 1], k])
    x, y, z = middle[0], middle[1], middle[2]
    pairs, found = _no_pairs(8 * count + 8), 0
    for i in range(count):
        for j in range(i + 1, count):
            if low[j] > high[i]:
                break
            bound = half[i] + half[j] + wide
            square = (x[i] - x[j]) ** 2 + (y[i] - y[j]) ** 2 + (z[i] - z[j]) ** 2
            if square > bound * bound:
                continue
            e, g = order[i], order[j]
            if rank[e] < rank[g]:
                e, g = g, e
            a, b, c, d = edges[e, 0], edges[e, 1], edges[g, 0], edges[g, 1]
            if c in (a, b) or d in (a, b):
                continue
            if not (moving[a] or moving[b] or moving[c] or moving[d]):
                continue
            gap = distances.between(vertices, a, b, c, d)
            if not gap < reach:
                continue
            is_far = not (
                _are_joined(first, reached, a, c)
                or _are_joined(first, reached, a, d)
                or _are_joined(first, reached, b, c)
                or _are_joined(first, reached, b, d)
            )
            if gap < (apart if is_far else local):
                pairs = _put(pairs, found, e, g, gap, is_far)
                found += 1
    longer, shorter, distance, far = pairs
    return longer[:found], shorter[:found], distance[:found], far[:found]

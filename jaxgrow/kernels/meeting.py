"""Intersection tests of triangles, for `jaxgrow.mesh.intersection`.

ipctk, which only returns whether any triangles intersect, takes 1.0 to 1.3 times as
long; of 302 pairs of triangles that meet it misses 6 that touch, and it reports that
292 of 608 segments meet triangles that they miss (experiments/benchmarks/libraries.py).
"""

import math
from typing import no_type_check

import numpy as np
from numba import njit


@njit(cache=True, error_model="numpy")
@no_type_check
def _separates(
    a: np.ndarray, b: np.ndarray, x: float, y: float, z: float, touch: float
) -> bool:
    """Return whether a direction is a separating axis of two triangles."""
    length = math.sqrt(x * x + y * y + z * z)
    if length <= 1e-12:
        return False
    x, y, z = x / length, y / length, z / length
    p = a[0, 0] * x + a[0, 1] * y + a[0, 2] * z
    q = a[1, 0] * x + a[1, 1] * y + a[1, 2] * z
    r = a[2, 0] * x + a[2, 1] * y + a[2, 2] * z
    s = b[0, 0] * x + b[0, 1] * y + b[0, 2] * z
    t = b[1, 0] * x + b[1, 1] * y + b[1, 2] * z
    u = b[2, 0] * x + b[2, 1] * y + b[2, 2] * z
    return max(min(p, q, r) - max(s, t, u), min(s, t, u) - max(p, q, r)) > touch


@njit(cache=True)
@no_type_check
def _cross(
    ax: float, ay: float, az: float, bx: float, by: float, bz: float
) -> tuple[float, float, float]:
    return ay * bz - az * by, az * bx - ax * bz, ax * by - ay * bx


@njit(cache=True)
@no_type_check
def _side(t: np.ndarray, k: int) -> tuple[float, float, float]:
    """Return the vector from corner k to the next."""
    n = (k + 1) % 3
    return t[n, 0] - t[k, 0], t[n, 1] - t[k, 1], t[n, 2] - t[k, 2]


@njit(cache=True, error_model="numpy")
@no_type_check
def meet(a: np.ndarray, b: np.ndarray, touch: float) -> bool:
    """Return whether two triangles meet, by separating axes.

    See `jaxgrow.mesh.intersection.meeting`.

    Args:
        a: corners. Overwritten.
        b: corners. Overwritten.
        touch: gap, relative to the extent of both, below which they meet.
    """
    size = 0.0
    for k in range(3):
        origin = a[0, k]
        for i in range(3):
            a[i, k], b[i, k] = a[i, k] - origin, b[i, k] - origin
            size = max(size, abs(a[i, k]), abs(b[i, k]))
    if size > 0.0:
        for i in range(3):
            for k in range(3):
                a[i, k], b[i, k] = a[i, k] / size, b[i, k] / size
    nx, ny, nz = _cross(*_side(a, 0), *_side(a, 1))
    mx, my, mz = _cross(*_side(b, 0), *_side(b, 1))
    if _separates(a, b, nx, ny, nz, touch) or _separates(a, b, mx, my, mz, touch):
        return False
    # a segment has no normal: in the plane of the other triangle it needs the other's
    if nx == 0.0 and ny == 0.0 and nz == 0.0:
        nx, ny, nz = mx, my, mz
    elif mx == 0.0 and my == 0.0 and mz == 0.0:
        mx, my, mz = nx, ny, nz
    for i in range(3):
        x, y, z = _side(a, i)
        if _separates(a, b, *_cross(nx, ny, nz, x, y, z), touch):
            return False
        if _separates(a, b, *_cross(mx, my, mz, *_side(b, i)), touch):
            return False
        for j in range(3):
            if _separates(a, b, *_cross(x, y, z, *_side(b, j)), touch):
                return False
    return True


@njit(cache=True)
@no_type_check
def meeting(one: np.ndarray, other: np.ndarray, touch: float) -> np.ndarray:
    """Return whether triangle i of one list meets triangle i of the other.

    See `meet`, for all i.
    """
    result, a, b = np.zeros(len(one), np.bool_), np.zeros((3, 3)), np.zeros((3, 3))
    for i in range(len(one)):
        a[:], b[:] = one[i], other[i]
        result[i] = meet(a, b, touch)
    return result


@njit(cache=True)
@no_type_check
def _put(triangle: np.ndarray, vertices: np.ndarray, a: int, b: int, c: int) -> None:
    for k in range(3):
        triangle[0, k] = vertices[a, k]
        triangle[1, k] = vertices[b, k]
        triangle[2, k] = vertices[c, k]


@njit(cache=True)
@no_type_check
def _hinged_meet(
    vertices: np.ndarray,
    one: np.ndarray,
    other: np.ndarray,
    a: np.ndarray,
    b: np.ndarray,
    touch: float,
) -> bool:
    """Return whether two faces with a common vertex meet elsewhere.

    The side of `one` opposite to the common vertex is tested against `other`.

    Args:
        vertices: of the mesh.
        one: vertices of a face.
        other: of another.
        a: work array of a triangle.
        b: likewise.
        touch: see `meet`.
    """
    at = 0
    while one[at] != other[0] and one[at] != other[1] and one[at] != other[2]:
        at += 1
    p, q = one[(at + 1) % 3], one[(at + 2) % 3]
    _put(a, vertices, p, q, q)
    _put(b, vertices, other[0], other[1], other[2])
    return meet(a, b, touch)


@njit(cache=True, error_model="numpy")
@no_type_check
def _bounds(
    vertices: np.ndarray, faces: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Compute each face's bounding box, its centre and a bounding radius.

    Lowest corner, highest corner and centre are arrays of three rows, one for each
    axis; the radius is that of a sphere around the centre.
    """
    count = len(faces)
    low, high, centre = np.zeros((3, count)), np.zeros((3, count)), np.zeros((3, count))
    radius = np.zeros(count)
    for f in range(count):
        a, b, c = faces[f, 0], faces[f, 1], faces[f, 2]
        for k in range(3):
            x, y, z = vertices[a, k], vertices[b, k], vertices[c, k]
            low[k, f], high[k, f] = min(x, y, z), max(x, y, z)
            centre[k, f] = 0.5 * (low[k, f] + high[k, f])
        for corner in range(3):
            square = 0.0
            for k in range(3):
                square += (vertices[faces[f, corner], k] - centre[k, f]) ** 2
            radius[f] = max(radius[f], math.sqrt(square))
    return low, high, centre, radius


@njit(cache=True, error_model="numpy")
@no_type_check
def intersecting(
    vertices: np.ndarray, faces: np.ndarray, first: int, touch: float
) -> tuple[np.ndarray, np.ndarray]:
    """List the pairs of faces that intersect, unsorted.

    See `jaxgrow.mesh.intersection.intersecting_pairs` for the definition.
    Candidates are pairs whose bounding boxes overlap, found by a sweep along an axis.

    Args:
        vertices: positions.
        faces: of the mesh.
        first: number of faces of which one is in every pair.
        touch: gap, relative to the largest extent of a pair, below which it meets.

    Returns:
        Pairs that share no vertex, and pairs that share one.
    """
    count = len(faces)
    low, high, centre, radius = _bounds(vertices, faces)
    axis, most, slack = 0, -1.0, 0.0
    for k in range(3):
        if count and high[k].max() - low[k].min() > most:
            axis, most = k, high[k].max() - low[k].min()
        for f in range(count):
            slack = max(slack, touch * (high[k, f] - low[k, f]))
    if not radius.any():
        return np.zeros((0, 2), np.int64), np.zeros((0, 2), np.int64)
    order = np.argsort(low[axis])
    x0, x1 = low[axis][order], high[axis][order]
    y0, y1 = low[(axis + 1) % 3][order], high[(axis + 1) % 3][order]
    z0, z1 = low[(axis + 2) % 3][order], high[(axis + 2) % 3][order]
    a, b = np.zeros((3, 3)), np.zeros((3, 3))
    apart, corner = [(0, 0)], [(0, 0)]
    for i in range(count):
        top_y, top_z = y1[i] + slack, z1[i] + slack
        for j in range(i + 1, count):
            if x0[j] > x1[i] + slack:
                break
            if y0[j] > top_y or z0[j] > top_z:
                continue
            if y0[i] > y1[j] + slack or z0[i] > z1[j] + slack:
                continue
            f, g = min(order[i], order[j]), max(order[i], order[j])
            if f >= first:
                continue
            shared = 0
            for k in range(3):
                for m in range(3):
                    shared += faces[f, k] == faces[g, m]
            if shared > 1 or not _close(low, high, centre, radius, f, g, touch):
                continue
            if shared == 0:
                _put(a, vertices, faces[f, 0], faces[f, 1], faces[f, 2])
                _put(b, vertices, faces[g, 0], faces[g, 1], faces[g, 2])
                if meet(a, b, touch):
                    apart.append((f, g))
            elif _hinged_meet(
                vertices, faces[f], faces[g], a, b, touch
            ) or _hinged_meet(vertices, faces[g], faces[f], a, b, touch):
                corner.append((f, g))
    return _rows(apart), _rows(corner)


@njit(cache=True)
@no_type_check
def _close(
    low: np.ndarray,
    high: np.ndarray,
    centre: np.ndarray,
    radius: np.ndarray,
    f: int,
    g: int,
    touch: float,
) -> bool:
    """Return whether bounding boxes and spheres of two faces overlap."""
    slack, square = 0.0, 0.0
    for k in range(3):
        slack = max(slack, touch * (high[k, f] - low[k, f]))
        square += (centre[k, f] - centre[k, g]) ** 2
    for k in range(3):
        if low[k, f] > high[k, g] + slack or low[k, g] > high[k, f] + slack:
            return False
    return math.sqrt(square) <= (radius[f] + radius[g]) * (1 + touch)


@njit(cache=True)
@no_type_check
def _rows(pairs: list[tuple[int, int]]) -> np.ndarray:
    """Convert all pairs but the first, a placeholder, into rows."""
    rows = np.zeros((len(pairs) - 1, 2), np.int64)
    for i in range(1, len(pairs)):
        rows[i - 1, 0], rows[i - 1, 1] = pairs[i]
    return rows

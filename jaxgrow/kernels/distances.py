"""Exact distances of points to triangles, and of segments.

They serve `jaxgrow.mesh`.
"""

import math
from typing import no_type_check

import numpy as np
from numba import njit

from jaxgrow.kernels.closest import closest_of_segments


@njit(cache=True, error_model="numpy")
@no_type_check
def _share(along: float, square: float) -> float:
    """Compute the closest parameter on a segment, 0 to 1."""
    return min(max(along / (square if square > 0.0 else 1.0), 0.0), 1.0)


@njit(cache=True, error_model="numpy")
@no_type_check
def _to_side(
    px: float, py: float, pz: float, sx: float, sy: float, sz: float
) -> tuple[float, float]:
    """Compute the squared distance of a point to the segment from 0 to s.

    The second result is the closest parameter on it, 0 to 1.
    """
    square = sx * sx + sy * sy + sz * sz
    t = _share(px * sx + py * sy + pz * sz, square)
    gx, gy, gz = px - t * sx, py - t * sy, pz - t * sz
    return gx * gx + gy * gy + gz * gz, t


@njit(cache=True, error_model="numpy")
@no_type_check
def to_triangle(
    points: np.ndarray, i: int, vertices: np.ndarray, a: int, b: int, c: int
) -> tuple[float, float, float, float]:
    """Compute the distance of point i to a triangle.

    The other results are the barycentric weights of a, b and c at the closest point.
    See `jaxgrow.mesh.proximity.closest_on_triangles`.
    """
    ax, ay, az = vertices[a, 0], vertices[a, 1], vertices[a, 2]
    bx, by, bz = vertices[b, 0], vertices[b, 1], vertices[b, 2]
    cx, cy, cz = vertices[c, 0], vertices[c, 1], vertices[c, 2]
    x, y, z = points[i, 0], points[i, 1], points[i, 2]
    px, py, pz = x - ax, y - ay, z - az
    qx, qy, qz = x - bx, y - by, z - bz
    rx, ry, rz = x - cx, y - cy, z - cz
    ux, uy, uz = bx - ax, by - ay, bz - az
    wx, wy, wz = cx - ax, cy - ay, cz - az

    best, t = _to_side(px, py, pz, ux, uy, uz)
    at_a, at_b, at_c = 1.0 - t, t, 0.0
    other, t = _to_side(qx, qy, qz, cx - bx, cy - by, cz - bz)
    if other < best:
        best, at_a, at_b, at_c = other, 0.0, 1.0 - t, t
    other, t = _to_side(rx, ry, rz, -wx, -wy, -wz)
    if other < best:
        best, at_a, at_b, at_c = other, t, 0.0, 1.0 - t

    nx, ny, nz = uy * wz - uz * wy, uz * wx - ux * wz, ux * wy - uy * wx
    square = nx * nx + ny * ny + nz * nz
    if square > 0.0:
        # areas of the triangles of each side and the foot
        of_a = nx * (qy * rz - qz * ry) + ny * (qz * rx - qx * rz)
        of_a += nz * (qx * ry - qy * rx)
        of_b = nx * (ry * pz - rz * py) + ny * (rz * px - rx * pz)
        of_b += nz * (rx * py - ry * px)
        of_c = nx * (py * qz - pz * qy) + ny * (pz * qx - px * qz)
        of_c += nz * (px * qy - py * qx)
        if of_a > 0.0 and of_b > 0.0 and of_c > 0.0:
            height = (px * nx + py * ny + pz * nz) / math.sqrt(square)
            if height * height <= best:
                total = of_a + of_b + of_c
                return abs(height), of_a / total, of_b / total, of_c / total
    return math.sqrt(best), at_a, at_b, at_c


@njit(cache=True, error_model="numpy")
@no_type_check
def to_triangles(
    points: np.ndarray, corners: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Compute the distance of point i to triangle i, for all i.

    The second result is the barycentric weights of its corners at the closest point.

    Args:
        points: positions.
        corners: three rows of each triangle.
    """
    distance, weights = np.zeros(len(points)), np.zeros((len(points), 3))
    for i in range(len(points)):
        a, b, c = 3 * i, 3 * i + 1, 3 * i + 2
        gap, at_a, at_b, at_c = to_triangle(points, i, corners, a, b, c)
        distance[i] = gap
        weights[i, 0], weights[i, 1], weights[i, 2] = at_a, at_b, at_c
    return distance, weights


@njit(cache=True, error_model="numpy")
@no_type_check
def of_segments(ends: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Compute the distance of the two segments of each row of four ends.

    The other results are the closest parameters on them, 0 to 1.
    """
    count = len(ends)
    distance, on_first, on_second = np.zeros(count), np.zeros(count), np.zeros(count)
    for i in range(count):
        row = ends[i]
        found = closest_of_segments(row[0], row[1], row[2], row[3])
        distance[i] = math.sqrt(found[3])
        on_first[i], on_second[i] = found[4], found[5]
    return distance, on_first, on_second


@njit(cache=True, error_model="numpy")
@no_type_check
def between(vertices: np.ndarray, a: int, b: int, c: int, d: int) -> float:
    """Compute the distance of the segments from a to b and from c to d.

    See `jaxgrow.mesh.proximity.closest_on_segments`.
    """
    ends = vertices[a], vertices[b], vertices[c], vertices[d]
    return math.sqrt(closest_of_segments(*ends)[3])


@njit(cache=True, error_model="numpy")
@no_type_check
def of_pairs(
    vertices: np.ndarray, vertex: np.ndarray, corners: np.ndarray, edges: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Compute distances of vertices to triangles, and of edges to edges.

    Args:
        vertices: positions.
        vertex: of each pair of a vertex and a triangle.
        corners: of its triangle.
        edges: the four ends of each pair of edges.
    """
    to_triangles, to_edges = np.zeros(len(vertex)), np.zeros(len(edges))
    for i in range(len(vertex)):
        a, b, c = corners[i, 0], corners[i, 1], corners[i, 2]
        to_triangles[i] = to_triangle(vertices, vertex[i], vertices, a, b, c)[0]
    for i in range(len(edges)):
        a, b, c, d = edges[i, 0], edges[i, 1], edges[i, 2], edges[i, 3]
        to_edges[i] = between(vertices, a, b, c, d)
    return to_triangles, to_edges

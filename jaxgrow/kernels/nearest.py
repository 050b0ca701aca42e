"""Bounding volume tree of a mesh: the triangle nearest to each point.

`jaxgrow.mesh.proximity.Proximity` uses it. libigl takes 1.1 to 1.4 times as long for
closest points (0.8 where 81 920 faces are sorted first), 1.2 to 2.1 times for the
weights of corners there, and is wrong for 12 of 500 points around triangles of zero
area (experiments/benchmarks/libraries.py).
"""

from typing import no_type_check

import numpy as np
from numba import njit

from jaxgrow.kernels import distances


LEAF = 4
"""Largest number of triangles of a leaf."""


@njit(cache=True, error_model="numpy")
@no_type_check
def plant(
    vertices: np.ndarray, faces: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Build a tree of bounding boxes, by median splits of triangle centres.

    Args:
        vertices: of the mesh.
        faces: of the mesh.

    Returns:
        The faces in the order of the leaves; for each node, where its faces begin and
        end, and the number of its first child (the second is the next node; 0: none);
        and its box, lowest corner first.
    """
    count = len(faces)
    centre = np.zeros((count, 3))
    for f in range(count):
        for k in range(3):
            for corner in range(3):
                centre[f, k] += vertices[faces[f, corner], k]
    order = np.arange(count)
    nodes, boxes = np.zeros((2 * count + 1, 3), np.int64), np.zeros((2 * count + 1, 6))
    nodes[0, 1] = count
    used, node = 1, 0
    while node < used:
        begin, end = nodes[node, 0], nodes[node, 1]
        _box(vertices, faces, order[begin:end], boxes[node])
        if end - begin > LEAF:
            widest, most = 0, -1.0
            for k in range(3):
                if boxes[node, 3 + k] - boxes[node, k] > most:
                    widest, most = k, boxes[node, 3 + k] - boxes[node, k]
            part = order[begin:end].copy()
            along = np.argsort(centre[part, widest], kind="mergesort")
            order[begin:end] = part[along]
            middle = (begin + end) // 2
            nodes[node, 2] = used
            nodes[used, 0], nodes[used, 1] = begin, middle
            nodes[used + 1, 0], nodes[used + 1, 1] = middle, end
            used += 2
        node += 1
    return order, nodes[:used], boxes[:used]


@njit(cache=True, error_model="numpy")
@no_type_check
def _box(
    vertices: np.ndarray, faces: np.ndarray, chosen: np.ndarray, box: np.ndarray
) -> None:
    """Compute the bounding box of some faces."""
    for k in range(3):
        low, high = np.inf, -np.inf
        for f in chosen:
            for corner in range(3):
                x = vertices[faces[f, corner], k]
                low, high = min(low, x), max(high, x)
        box[k], box[3 + k] = low, high


@njit(cache=True, error_model="numpy")
@no_type_check
def _to_box(box: np.ndarray, x: float, y: float, z: float) -> float:
    """Compute the squared distance of a point to a box, rounded down."""
    dx = max(box[0] - x, x - box[3], 0.0)
    dy = max(box[1] - y, y - box[4], 0.0)
    dz = max(box[2] - z, z - box[5], 0.0)
    return (dx * dx + dy * dy + dz * dz) * (1.0 - 1e-12)


@njit(cache=True, error_model="numpy")
@no_type_check
def find(
    points: np.ndarray,
    vertices: np.ndarray,
    faces: np.ndarray,
    order: np.ndarray,
    nodes: np.ndarray,
    boxes: np.ndarray,
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Find the nearest face of each point.

    Returns the distance, the face, and the barycentric weights of the closest point.

    Args:
        points: positions.
        vertices: of the mesh.
        faces: of the mesh.
        order: see `plant`; so are the others.
        nodes: as there.
        boxes: as there.
    """
    count = len(points)
    distance, face = np.full(count, np.inf), np.zeros(count, np.int64)
    weights = np.zeros((count, 3))
    waiting, gap = np.zeros(128, np.int64), np.zeros(128)
    for i in range(count):
        x, y, z = points[i, 0], points[i, 1], points[i, 2]
        best = np.inf
        waiting[0], gap[0], last = 0, _to_box(boxes[0], x, y, z), 1
        while last > 0:
            last -= 1
            node = waiting[last]
            if gap[last] > best * best:
                continue
            child = nodes[node, 2]
            if child == 0:
                for at in range(nodes[node, 0], nodes[node, 1]):
                    f = order[at]
                    a, b, c = faces[f, 0], faces[f, 1], faces[f, 2]
                    d, u, v, w = distances.to_triangle(points, i, vertices, a, b, c)
                    # of equally near faces the first, in any order of the leaves
                    if d < best or (d == best and f < face[i]):
                        best, face[i] = d, f
                        weights[i, 0], weights[i, 1], weights[i, 2] = u, v, w
                continue
            near, far = child, child + 1
            to_near = _to_box(boxes[near], x, y, z)
            to_far = _to_box(boxes[far], x, y, z)
            if to_far < to_near:
                near, far, to_near, to_far = far, near, to_far, to_near
            waiting[last], gap[last] = far, to_far
            waiting[last + 1], gap[last + 1] = near, to_near
            last += 2
        distance[i] = best
    return distance, face, weights

"""Which triangles of a mesh intersect each other.

Two triangles that share no vertex are convex sets; they are disjoint exactly if one of
17 directions separates them (the two normals, the nine cross products of sides, and for
coplanar ones the six in-plane normals of the sides). Intervals that come closer than
`TOUCH` times the size of the pair count as meeting, so a touch is reported too, and
rounding cannot hide an intersection.

Two triangles that share one vertex intersect beyond it exactly if the side opposite to
it of one of them meets the other triangle: the same test with a side as a degenerate
triangle. Two that share a side overlap only if they are folded onto each other, which
is the audit's fold check; two that share three vertices are duplicates.
"""

from __future__ import annotations

import numpy as np
from jaxtyping import Bool, Float, Int
from scipy.spatial import KDTree

from jaxgrow import kernels


TOUCH = 1e-10
"""Gap, relative to the largest extent of a pair, below which it counts as meeting."""

_CHUNK = 200_000


def intersecting_pairs(
    vertices: Float[np.ndarray, "m 3"],
    faces: Int[np.ndarray, "f 3"],
    first: int | None = None,
) -> tuple[Int[np.ndarray, "p 2"], Int[np.ndarray, "q 2"]]:
    """All pairs of faces that intersect other than in a shared vertex or side.

    Args:
        vertices: Positions, finite.
        faces: Faces.
        first: Number of faces of which one is in every pair; None for all pairs.

    Returns:
        Pairs that share no vertex, and pairs that share exactly one; smaller face index
        first, in ascending order.
    """
    first = len(faces) if first is None else first
    loops = kernels.loops("meeting", vertices)
    if loops is not None:
        apart, corner = loops.intersecting(vertices, faces, first)
    else:
        apart, corner = _intersecting(vertices, faces)
        apart, corner = apart[apart[:, 0] < first], corner[corner[:, 0] < first]
    return _in_order(apart), _in_order(corner)


def _in_order(pairs: Int[np.ndarray, "p 2"]) -> Int[np.ndarray, "p 2"]:
    """The same, ascending."""
    return pairs[np.lexsort((pairs[:, 1], pairs[:, 0]))] if len(pairs) > 1 else pairs


def _intersecting(
    vertices: Float[np.ndarray, "m 3"], faces: Int[np.ndarray, "f 3"]
) -> tuple[Int[np.ndarray, "p 2"], Int[np.ndarray, "q 2"]]:
    """The same as `intersecting_pairs` without loops, of all faces, in no order."""
    triangles = vertices[faces]
    low, high = triangles.min(axis=1), triangles.max(axis=1)
    apart: list[Int[np.ndarray, "_ 2"]] = [np.zeros((0, 2), dtype=np.int64)]
    corner = list(apart)
    for pairs in _close_pairs(triangles):
        first, second = pairs.T
        slack = TOUCH * np.abs(high[first] - low[first]).max(axis=1, initial=0.0)
        near = np.all(
            (low[first] <= high[second] + slack[:, None])
            & (low[second] <= high[first] + slack[:, None]),
            axis=1,
        )
        kept = pairs[near]
        same = faces[kept[:, 0]][:, :, None] == faces[kept[:, 1]][:, None, :]
        shared = same.sum(axis=(1, 2))
        free = kept[shared == 0]
        apart.append(free[meeting(triangles[free[:, 0]], triangles[free[:, 1]])])
        hinged, same = kept[shared == 1], same[shared == 1]
        bad = np.zeros(len(hinged), dtype=bool)
        for a, b, axis in ((0, 1, 2), (1, 0, 1)):
            at = same.any(axis=axis).argmax(axis=1)
            one, other = triangles[hinged[:, a]], triangles[hinged[:, b]]
            rows = np.arange(len(hinged))
            p, q = one[rows, (at + 1) % 3], one[rows, (at + 2) % 3]
            bad |= meeting(np.stack([p, q, q], axis=1), other)
        corner.append(hinged[bad])
    return np.concatenate(apart), np.concatenate(corner)


def _close_pairs(
    triangles: Float[np.ndarray, "f 3 3"],
) -> list[Int[np.ndarray, "_ 2"]]:
    """Pairs whose bounding spheres meet, in chunks, by classes of like size."""
    centre = 0.5 * (triangles.min(axis=1) + triangles.max(axis=1))
    radius = np.linalg.norm(triangles - centre[:, None], axis=2).max(axis=1)
    largest = radius.max(initial=0.0)
    if largest == 0.0:
        return []
    sizes = np.ceil(np.log2(np.maximum(radius / largest, 1e-6)))
    members = [np.flatnonzero(sizes == size) for size in np.unique(sizes)]
    trees = [KDTree(centre[group]) for group in members]
    chunks = []
    for i, first in enumerate(members):
        for j in range(i, len(members)):
            second = members[j]
            reach = (radius[first].max() + radius[second].max()) * (1 + TOUCH)
            if i == j:
                found = trees[i].query_pairs(reach, output_type="ndarray")
            else:
                # The matrix keeps explicit zeros: concentric triangles stay a pair.
                matrix = trees[i].sparse_distance_matrix(
                    trees[j], reach, output_type="ndarray"
                )
                found = np.stack([matrix["i"], matrix["j"]], axis=1)
            pairs = np.stack([first[found[:, 0]], second[found[:, 1]]], axis=1)
            gap = np.linalg.norm(centre[pairs[:, 0]] - centre[pairs[:, 1]], axis=1)
            touch = gap <= (radius[pairs[:, 0]] + radius[pairs[:, 1]]) * (1 + TOUCH)
            pairs = np.sort(pairs[touch], axis=1)
            chunks += [pairs[k : k + _CHUNK] for k in range(0, len(pairs), _CHUNK)]
    return chunks


def meeting(
    one: Float[np.ndarray, "p 3 3"], other: Float[np.ndarray, "p 3 3"]
) -> Bool[np.ndarray, " p"]:
    """Whether triangle i of one list meets triangle i of the other (touching counts).

    Triangles may be degenerate: segments and points.

    Args:
        one: Corners.
        other: Corners, in the same unit.
    """
    origin = one[:, :1]
    one, other = one - origin, other - origin
    size = np.maximum(np.abs(one), np.abs(other)).max(axis=(1, 2), initial=0.0)
    open_ = np.arange(len(one))
    size = np.where(size > 0, size, 1.0)
    one, other = one / size[:, None, None], other / size[:, None, None]
    for kind in range(17):
        a, b = one[open_], other[open_]
        axis = _axis(a, b, kind)
        length = np.linalg.norm(axis, axis=1)
        usable = length > 1e-12
        axis = axis / np.where(usable, length, 1.0)[:, None]
        left = np.einsum("pki,pi->pk", a, axis)
        right = np.einsum("pki,pi->pk", b, axis)
        gap = np.maximum(
            left.min(axis=1) - right.max(axis=1), right.min(axis=1) - left.max(axis=1)
        )
        open_ = open_[~(usable & (gap > TOUCH))]
        if not len(open_):
            break
    result = np.zeros(len(one), dtype=bool)
    result[open_] = True
    return result


def _axis(
    a: Float[np.ndarray, "p 3 3"], b: Float[np.ndarray, "p 3 3"], kind: int
) -> Float[np.ndarray, "p 3"]:
    """The candidate direction of one kind: normals first, they separate most pairs."""
    if kind < 2:
        return _normal((a, b)[kind])
    if kind < 8:
        triangle, other = (a, b) if kind % 2 == 0 else (b, a)
        normal = _normal(triangle)
        # a segment has no normal: in the plane of the other triangle it needs that one
        flat = np.count_nonzero(normal, axis=1) == 0
        normal = np.where(flat[:, None], _normal(other), normal)
        return np.cross(normal, _side(triangle, kind // 2 - 1))
    return np.cross(_side(a, (kind - 8) // 3), _side(b, (kind - 8) % 3))


def _side(triangle: Float[np.ndarray, "p 3 3"], k: int) -> Float[np.ndarray, "p 3"]:
    """From corner k to the next."""
    return triangle[:, (k + 1) % 3] - triangle[:, k]


def _normal(triangle: Float[np.ndarray, "p 3 3"]) -> Float[np.ndarray, "p 3"]:
    """Twice the area vector."""
    return np.cross(_side(triangle, 0), _side(triangle, 1))

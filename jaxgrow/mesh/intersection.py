"""Intersection tests between the triangles of a mesh.

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

from jaxgrow import kernels


TOUCH = 1e-10
"""Gap, relative to the largest extent of a pair, below which it counts as meeting."""


def intersecting_pairs(
    vertices: Float[np.ndarray, "m 3"],
    faces: Int[np.ndarray, "f 3"],
    first: int | None = None,
) -> tuple[Int[np.ndarray, "p 2"], Int[np.ndarray, "q 2"]]:
    """Find all pairs of faces that intersect beyond shared parts.

    Shared parts are a common vertex or side.

    Args:
        vertices: Positions, finite.
        faces: Faces.
        first: Every pair contains one of the first so many faces; None for all pairs.

    Returns:
        Pairs that share no vertex, and pairs that share exactly one; smaller face index
        first, in ascending order.
    """
    first = len(faces) if first is None else first
    vertices, faces = (
        np.require(vertices, float, ["C", "W"]),
        np.require(faces, int, ["C", "W"]),
    )
    apart, corner = kernels.loops("meeting").intersecting(vertices, faces, first, TOUCH)
    return _in_order(apart), _in_order(corner)


def _in_order(pairs: Int[np.ndarray, "p 2"]) -> Int[np.ndarray, "p 2"]:
    """Sort pairs in ascending order."""
    return pairs[np.lexsort((pairs[:, 1], pairs[:, 0]))] if len(pairs) > 1 else pairs


def meeting(
    one: Float[np.ndarray, "p 3 3"], other: Float[np.ndarray, "p 3 3"]
) -> Bool[np.ndarray, " p"]:
    """Test whether triangle i of one list meets triangle i of the other.

    Touching counts as meeting.

    Triangles may be degenerate: segments and points.

    Args:
        one: Corners.
        other: Corners, in the same unit.
    """
    one, other = (
        np.require(one, float, ["C", "W"]),
        np.require(other, float, ["C", "W"]),
    )
    return kernels.loops("meeting").meeting(one, other, TOUCH)

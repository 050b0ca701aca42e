"""Pairs of triangles: shared corners, overlap, distance; vectorised.

Corners are shared if their coordinates are equal to the last bit. Two triangles do not
overlap beyond shared corners

- with none shared: if they are disjoint;
- with one: if the side opposite to it of each misses the other;
- with two: if they are not folded onto each other, within the audit's `FOLD_DEGREES`
  (different planes have only the line of the common side in common);
- with three: never.
"""

from __future__ import annotations

import numpy as np
from jaxtyping import Bool, Float

from jaxgrow.mesh.audit import FOLD_DEGREES
from jaxgrow.mesh.intersection import meeting, TOUCH
from jaxgrow.mesh.proximity import closest_on_segments, closest_on_triangles
from jaxgrow.mesh.quality import area_vectors, lengths, unit


def same_corners(
    one: Float[np.ndarray, "p 3 3"], other: Float[np.ndarray, "p 3 3"]
) -> Bool[np.ndarray, "p 3 3"]:
    """Return whether corner i of one triangle is corner j of the other."""
    a, b = one[:, :, None], other[:, None]
    same = a[..., 0] == b[..., 0]
    same &= a[..., 1] == b[..., 1]
    same &= a[..., 2] == b[..., 2]
    return same


def overlapping(
    one: Float[np.ndarray, "p 3 3"],
    other: Float[np.ndarray, "p 3 3"],
    same: Bool[np.ndarray, "p 3 3"],
) -> Bool[np.ndarray, " p"]:
    """Return whether two triangles meet beyond the corners that they share."""
    mine, its = np.any(same, axis=2), np.any(same, axis=1)
    shared = mine.sum(axis=1)
    result = shared > 2
    free = np.flatnonzero(shared == 0)
    free = free[~_parted(one[free], other[free])]
    hinged = np.flatnonzero(shared == 1)
    side = _opposite_side(one[hinged], mine[hinged])
    its_side = _opposite_side(other[hinged], its[hinged])
    tip = one[hinged, mine[hinged].argmax(axis=1)]
    open_ = ~_parted_at(tip, side, its_side)
    hinged, side, its_side = hinged[open_], side[open_], its_side[open_]
    met = meeting(
        np.concatenate([one[free], side, one[hinged]]),
        np.concatenate([other[free], other[hinged], its_side]),
    )
    result[np.concatenate([free, hinged, hinged])[met]] = True

    hinge = np.flatnonzero(shared == 2)
    start, end, _ = _opposite_side(one[hinge], ~mine[hinge]).transpose(1, 0, 2)
    along = unit(end - start)
    arms = []
    for triangles, alone in ((one, ~mine), (other, ~its)):
        arm = triangles[hinge, alone[hinge].argmax(axis=1)] - start
        arms.append(unit(arm - np.einsum("pi,pi->p", arm, along)[:, None] * along))
    turn = np.einsum("pi,pi->p", *arms)
    result[hinge] = turn > np.cos(np.deg2rad(180.0 - FOLD_DEGREES))
    return result


def _parted(
    one: Float[np.ndarray, "p 3 3"], other: Float[np.ndarray, "p 3 3"]
) -> Bool[np.ndarray, " p"]:
    """Return whether an obvious plane separates two triangles.

    The planes are those along each, and across the line of their middles.

    It holds for most pairs, and costs less than all the directions of `meeting`.
    """
    origin = one[:, :1]
    one, other = one - origin, other - origin
    size = np.sqrt(sum(np.einsum("pki,pki->p", x, x) for x in (one, other)))
    line = one.sum(axis=1) - other.sum(axis=1)
    result = np.zeros(len(one), dtype=bool)
    for axis in (area_vectors(one), area_vectors(other), line):
        left, right = (np.einsum("pki,pi->kp", x, axis) for x in (one, other))
        apart = np.maximum(
            left.min(axis=0) - right.max(axis=0), right.min(axis=0) - left.max(axis=0)
        )
        result |= apart > 10 * TOUCH * size * lengths(axis)
    return result


def _parted_at(
    tip: Float[np.ndarray, "p 3"],
    one: Float[np.ndarray, "p 3 3"],
    other: Float[np.ndarray, "p 3 3"],
) -> Bool[np.ndarray, " p"]:
    """Return whether a plane through a common corner separates two triangles.

    Seen from there they are two angles. If one is in a closed half-space and the other
    inside the opposite one, the triangles meet nowhere else.

    Args:
        tip: The common corner.
        one: The side opposite to it.
        other: The side opposite to it of the other triangle.
    """
    a, b, c, d = (unit(x[:, k] - tip) for x in (one, other) for k in (0, 1))
    result = np.zeros(len(tip), dtype=bool)
    for axis in (_cross(a, b), _cross(c, d), unit(a + b) - unit(c + d)):
        at = [np.einsum("pi,pi->p", x, unit(axis)) for x in (a, b, c, d)]
        for p, q, r, s in (at, at[2:] + at[:2]):
            up, down = np.minimum(p, q), np.maximum(r, s)
            result |= (up > -1e-12) & (down < 1e-12) & (up - down > 1e-6)
    return result


def _cross(
    a: Float[np.ndarray, "p 3"], b: Float[np.ndarray, "p 3"]
) -> Float[np.ndarray, "p 3"]:
    """Return vector products, for a few thousand rows faster than numpy."""
    return 2 * area_vectors(np.stack([np.zeros_like(a), a, b], axis=1))


def _opposite_side(
    triangles: Float[np.ndarray, "p 3 3"], corner: Bool[np.ndarray, "p 3"]
) -> Float[np.ndarray, "p 3 3"]:
    """Return the side opposite to the marked corner, as a degenerate triangle."""
    rows, place = np.arange(len(triangles)), corner.argmax(axis=1)
    a, b = triangles[rows, (place + 1) % 3], triangles[rows, (place + 2) % 3]
    return np.stack([a, b, b], axis=1)


def facing(
    one: Float[np.ndarray, "p 3 3"], other: Float[np.ndarray, "p 3 3"]
) -> Bool[np.ndarray, " p"]:
    """Return whether the normals are opposed."""
    return np.einsum("pi,pi->p", area_vectors(one), area_vectors(other)) < 0


def distances(
    one: Float[np.ndarray, "p 3 3"], other: Float[np.ndarray, "p 3 3"]
) -> Float[np.ndarray, " p"]:
    """Compute the exact distance of triangle i to triangle i of another list.

    It is zero, or reached at a corner of one of them, or inside a side of both.
    """
    count = len(one)
    if not count:
        return np.zeros(0)
    points = np.concatenate(
        [one[:, k] for k in range(3)] + [other[:, k] for k in range(3)]
    )
    onto = np.concatenate([other] * 3 + [one] * 3)
    best = closest_on_triangles(points, onto)[0].reshape(6, count).min(axis=0)
    first, second = np.repeat(range(3), 3), np.tile(range(3), 3)
    sides = one[:, [first, (first + 1) % 3]], other[:, [second, (second + 1) % 3]]
    between, _, _ = closest_on_segments(
        *(side.transpose(2, 0, 1, 3).reshape(-1, 2, 3) for side in sides)
    )
    best = np.minimum(best, between.reshape(9, count).min(axis=0))
    best[meeting(one, other)] = 0.0
    return best

"""Exact distances, point-triangle and segment-segment, with derivatives."""

from collections.abc import Sequence

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, PyTree

from jaxgrow.energy.vectors import cross, dot, minus, norm, split, unit
from jaxgrow.runtime.types import Columns


def split_corners(shapes: Float[Array, "*p k 3"]) -> tuple[Columns, ...]:
    """Split triangles or segment pairs into columns of each corner or end."""
    return tuple(split(shapes[..., k, :]) for k in range(shapes.shape[-2]))


def _along(to_point: Columns, side: Columns) -> Float[Array, "*p"]:
    """Return the share of a side at its point closest to a point.

    It is 0 for a side of length 0.
    """
    square = dot(side, side)
    return jnp.clip(dot(to_point, side) / jnp.where(square > 0, square, 1), 0, 1)


def closest_weights(point: Columns, a: Columns, b: Columns, c: Columns) -> Columns:
    """Return barycentric weights of the triangle's point closest to `point`.

    The nearest of four candidates: the closest point of each side, and the foot of the
    perpendicular where it falls inside. A triangle without area is therefore treated as
    its sides; a classification by Voronoi regions would depend on the rounding of its
    area, and overestimate the distance.
    """
    ab, bc, ac = minus(b, a), minus(c, b), minus(c, a)
    ap, bp = minus(point, a), minus(point, b)
    on_ab, on_bc, on_ac = _along(ap, ab), _along(bp, bc), _along(ap, ac)
    zero = jnp.zeros_like(on_ab)

    normal = cross(ab, ac)
    square = dot(normal, normal)
    longest = jnp.maximum(dot(ab, ab), jnp.maximum(dot(bc, bc), dot(ac, ac)))
    has_area = square > (64 * jnp.finfo(square.dtype).eps * longest) ** 2
    scale = 1 / jnp.where(has_area, square, 1)
    of_b = dot(cross(ap, ac), normal) * scale
    of_c = dot(cross(ab, ap), normal) * scale
    of_b, of_c, on_ab, on_bc, on_ac = _once((of_b, of_c, on_ab, on_bc, on_ac))
    of_a = 1 - of_b - of_c
    inside = has_area & (of_a > 0) & (of_b > 0) & (of_c > 0)

    candidates = (
        (inside, (of_a, of_b, of_c)),
        (True, (zero, 1 - on_bc, on_bc)),
        (True, (1 - on_ac, zero, on_ac)),
        (True, (1 - on_ab, on_ab, zero)),
    )
    gaps = [minus(point, _at(parts, a, b, c)) for _, parts in candidates]
    return _nearest(candidates, gaps)


def _nearest(
    candidates: Sequence[tuple[Bool[Array, "*p"] | bool, Columns]],
    gaps: Sequence[Columns],
) -> Columns:
    """Select the valid candidate with the shortest gap, the first of equals."""
    best = jnp.full_like(gaps[0][0], jnp.inf)
    which = jnp.full(best.shape, -1)
    for number, ((possible, _), gap) in enumerate(zip(candidates, gaps, strict=True)):
        square = jnp.where(possible, dot(gap, gap), jnp.inf)
        nearer = square < best
        best = jnp.where(nearer, square, best)
        which = jnp.where(nearer, number, which)
    which = _once(which)
    found = tuple(jnp.zeros_like(best) for _ in candidates[0][1])
    for number, (_, parts) in enumerate(candidates):
        chosen = which == number
        found = tuple(
            jnp.where(chosen, new, old) for new, old in zip(parts, found, strict=True)
        )
    return found


def _once(values: PyTree) -> PyTree:
    """Return the same values, computed once (optimisation barrier).

    Otherwise the compiler recomputes them, with other rounding, for each of several
    results, and the three weights of a needle would be inconsistent.
    """
    return jax.lax.optimization_barrier(values)


def _at(weights: Columns, *points: Columns) -> Columns:
    """Return the weighted sum of points."""
    total = tuple(weights[0] * x for x in points[0])
    for weight, point in zip(weights[1:], points[1:], strict=True):
        total = tuple(t + weight * x for t, x in zip(total, point, strict=True))
    return total


@jax.custom_jvp
def triangle_distance(
    point: Columns, a: Columns, b: Columns, c: Columns
) -> Float[Array, "*p"]:
    """Return the exact distance of each point to its triangle.

    Its first derivative is the one at a fixed closest point (envelope theorem). The
    rule below states it as a function that is differentiated again in full, through
    the closest point: stopping the gradient there leaves forces right and Hessians
    wrong.
    """
    return norm(minus(point, _at(closest_weights(point, a, b, c), a, b, c)))


@triangle_distance.defjvp
def _triangle_jvp(
    primals: tuple[Columns, ...], tangents: tuple[Columns, ...]
) -> tuple[Array, Array]:
    point, *corners = primals
    weights = closest_weights(point, *corners)
    offset = minus(point, _at(weights, *corners))
    length = norm(offset)
    moved = minus(tangents[0], _at(weights, *tangents[1:]))
    return length, dot(unit(offset, length), moved)


def point_triangle_distance(
    point: Float[Array, "*p 3"], corners: Float[Array, "*p 3 3"]
) -> Float[Array, "*p"]:
    """Return `triangle_distance` of arrays of rows."""
    return triangle_distance(split(point), *split_corners(corners))


def closest_shares(
    a: Columns, b: Columns, c: Columns, d: Columns
) -> tuple[Float[Array, "*p"], Float[Array, "*p"]]:
    """Return the shares s, t of the closest points of segments ab and cd.

    They run from 0 (a, c) to 1 (b, d).

    The nearest of five candidates: the feet of the common perpendicular, where both
    fall inside, and the closest point of each end on the other segment. Parallel
    segments have no such feet and are treated by their ends.
    """
    one, other, gap = minus(b, a), minus(d, c), minus(c, a)
    square, along, square_other = dot(one, one), dot(one, other), dot(other, other)
    determinant = square * square_other - along**2
    skew = determinant > 64 * jnp.finfo(along.dtype).eps * square * square_other
    scale = 1 / jnp.where(skew, determinant, 1)
    on_one, on_other = dot(one, gap), dot(other, gap)
    s = (on_one * square_other - on_other * along) * scale
    t = (on_one * along - on_other * square) * scale
    inside = skew & (s > 0) & (s < 1) & (t > 0) & (t < 1)
    zero = jnp.zeros_like(s)
    ends = (
        _along(minus(a, c), other),
        _along(minus(b, c), other),
        _along(gap, one),
        _along(minus(d, a), one),
    )
    s, t, a_on, b_on, c_on, d_on = _once((s, t, *ends))
    candidates = (
        (inside, (s, t)),
        (True, (zero, a_on)),
        (True, (zero + 1, b_on)),
        (True, (c_on, zero)),
        (True, (d_on, zero + 1)),
    )
    gaps = [_between(*shares, a, b, c, d) for _, shares in candidates]
    s, t = _nearest(candidates, gaps)
    return s, t


def _between(s: Float[Array, "*p"], t: Float[Array, "*p"], *ends: Columns) -> Columns:
    """Return the vector from share t of the second segment to s of the first."""
    a, b, c, d = ends
    return minus(_at((1 - s, s), a, b), _at((1 - t, t), c, d))


@jax.custom_jvp
def segment_distance(
    a: Columns, b: Columns, c: Columns, d: Columns
) -> Float[Array, "*p"]:
    """Return the exact distance of the segments ab and cd.

    Its derivatives are taken as in `triangle_distance`. It has a kink where the
    segments are parallel.
    """
    return norm(_between(*closest_shares(a, b, c, d), a, b, c, d))


@segment_distance.defjvp
def _segment_jvp(
    primals: tuple[Columns, ...], tangents: tuple[Columns, ...]
) -> tuple[Array, Array]:
    s, t = closest_shares(*primals)
    offset = _between(s, t, *primals)
    length = norm(offset)
    return length, dot(unit(offset, length), _between(s, t, *tangents))

"""Exact distances, point to triangle and segment to segment, twice differentiable."""

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from jaxgrow.numerics import safe_norm


def _dot(a: Float[Array, "*p 3"], b: Float[Array, "*p 3"]) -> Float[Array, "*p"]:
    return jnp.sum(a * b, axis=-1)


def _along(
    to_point: Float[Array, "*p 3"], side: Float[Array, "*p 3"]
) -> Float[Array, "*p"]:
    """Share of the side at which it is closest to the point; 0 for length 0."""
    square = _dot(side, side)
    return jnp.clip(_dot(to_point, side) / jnp.where(square > 0, square, 1), 0, 1)


def closest_weights(
    point: Float[Array, "*p 3"], corners: Float[Array, "*p 3 3"]
) -> Float[Array, "*p 3"]:
    """Barycentric weights of the point of the triangle closest to `point`.

    The nearest of four candidates: the closest point of each side, and the foot of the
    perpendicular where it falls inside. A triangle without area is so treated as its
    sides; a decision by Voronoi regions would take it for whatever the rounding of its
    area says, and overestimate the distance.
    """
    a, b, c = corners[..., 0, :], corners[..., 1, :], corners[..., 2, :]
    ab, bc, ac = b - a, c - b, c - a
    ap = point - a
    on_ab, on_bc, on_ac = _along(ap, ab), _along(point - b, bc), _along(ap, ac)
    zero = jnp.zeros_like(on_ab)

    normal = jnp.cross(ab, ac)
    square = _dot(normal, normal)
    longest = jnp.maximum(_dot(ab, ab), jnp.maximum(_dot(bc, bc), _dot(ac, ac)))
    has_area = square > (64 * jnp.finfo(square.dtype).eps * longest) ** 2
    scale = 1 / jnp.where(has_area, square, 1)
    of_b = _dot(jnp.cross(ap, ac), normal) * scale
    of_c = _dot(jnp.cross(ab, ap), normal) * scale
    of_a = 1 - of_b - of_c
    inside = has_area & (of_a > 0) & (of_b > 0) & (of_c > 0)

    candidates = (
        (inside, (of_a, of_b, of_c)),
        (True, (zero, 1 - on_bc, on_bc)),
        (True, (1 - on_ac, zero, on_ac)),
        (True, (1 - on_ab, on_ab, zero)),
    )
    weights = jnp.zeros_like(corners[..., 0])
    best = jnp.full_like(zero, jnp.inf)
    for possible, parts in candidates:
        weight = jnp.stack(parts, axis=-1)
        gap = point - jnp.sum(weight[..., None] * corners, axis=-2)
        distance = jnp.where(possible, _dot(gap, gap), jnp.inf)
        nearer = distance < best
        best = jnp.where(nearer, distance, best)
        weights = jnp.where(nearer[..., None], weight, weights)
    return weights


def _offset(
    point: Float[Array, "*p 3"], corners: Float[Array, "*p 3 3"]
) -> tuple[Float[Array, "*p 3"], Float[Array, "*p 3"]]:
    """Vector from the closest point of the triangle to `point`, and its weights."""
    weights = closest_weights(point, corners)
    closest = jnp.sum(weights[..., None] * corners, axis=-2)
    return point - closest, weights


@jax.custom_jvp
def point_triangle_distance(
    point: Float[Array, "*p 3"], corners: Float[Array, "*p 3 3"]
) -> Float[Array, "*p"]:
    """Exact distance of each point to its triangle.

    Its first derivative is the one at a fixed closest point (envelope theorem). The
    rule below states it as a function that is differentiated again in full, through
    the closest point: stopping the gradient there leaves forces right and Hessians
    wrong.
    """
    return safe_norm(_offset(point, corners)[0])


@point_triangle_distance.defjvp
def _distance_jvp(
    primals: tuple[Array, Array], tangents: tuple[Array, Array]
) -> tuple[Array, Array]:
    point, corners = primals
    offset, weights = _offset(point, corners)
    length = safe_norm(offset)
    direction = offset / jnp.where(length > 0, length, 1)[..., None]
    moved = tangents[0] - jnp.sum(weights[..., None] * tangents[1], axis=-2)
    return length, jnp.sum(direction * moved, axis=-1)


def closest_shares(
    first: Float[Array, "*p 2 3"], second: Float[Array, "*p 2 3"]
) -> tuple[Float[Array, "*p"], Float[Array, "*p"]]:
    """Where two segments are closest: shares s, t from 0 (start) to 1 (end) of each.

    The nearest of five candidates: the feet of the common perpendicular, where both
    fall inside, and the closest point of each end on the other segment. Parallel
    segments have no such feet and are treated by their ends.
    """
    a, b = first[..., 0, :], first[..., 1, :]
    c, d = second[..., 0, :], second[..., 1, :]
    one, other, gap = b - a, d - c, c - a
    square, along, square_other = _dot(one, one), _dot(one, other), _dot(other, other)
    determinant = square * square_other - along**2
    skew = determinant > 64 * jnp.finfo(along.dtype).eps * square * square_other
    scale = 1 / jnp.where(skew, determinant, 1)
    on_one, on_other = _dot(one, gap), _dot(other, gap)
    s = (on_one * square_other - on_other * along) * scale
    t = (on_one * along - on_other * square) * scale
    inside = skew & (s > 0) & (s < 1) & (t > 0) & (t < 1)
    zero = jnp.zeros_like(s)
    candidates = (
        (inside, s, t),
        (True, zero, _along(-gap, other)),
        (True, zero + 1, _along(b - c, other)),
        (True, _along(gap, one), zero),
        (True, _along(d - a, one), zero + 1),
    )
    best = jnp.full_like(zero, jnp.inf)
    shares = zero, zero
    for possible, s, t in candidates:
        between = gap + t[..., None] * other - s[..., None] * one
        distance = jnp.where(possible, _dot(between, between), jnp.inf)
        nearer = distance < best
        best = jnp.where(nearer, distance, best)
        shares = jnp.where(nearer, s, shares[0]), jnp.where(nearer, t, shares[1])
    return shares


def _between(
    first: Float[Array, "*p 2 3"], second: Float[Array, "*p 2 3"]
) -> tuple[Float[Array, "*p 3"], Float[Array, "*p"], Float[Array, "*p"]]:
    """Vector from the closest point of the second segment to that of the first."""
    s, t = closest_shares(first, second)
    return _at(first, s) - _at(second, t), s, t


def _at(segment: Float[Array, "*p 2 3"], share: Float[Array, "*p"]) -> Array:
    """The point of a segment at a share of its length."""
    share = share[..., None]
    return (1 - share) * segment[..., 0, :] + share * segment[..., 1, :]


@jax.custom_jvp
def segment_distance(
    first: Float[Array, "*p 2 3"], second: Float[Array, "*p 2 3"]
) -> Float[Array, "*p"]:
    """Exact distance of two segments each; its derivatives are as for a triangle.

    It has a kink where the segments are parallel.
    """
    return safe_norm(_between(first, second)[0])


@segment_distance.defjvp
def _segment_jvp(
    primals: tuple[Array, Array], tangents: tuple[Array, Array]
) -> tuple[Array, Array]:
    offset, s, t = _between(*primals)
    length = safe_norm(offset)
    direction = offset / jnp.where(length > 0, length, 1)[..., None]
    moved = _at(tangents[0], s) - _at(tangents[1], t)
    return length, jnp.sum(direction * moved, axis=-1)

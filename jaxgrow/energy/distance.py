"""Exact distance from a point to a triangle, twice differentiable."""

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

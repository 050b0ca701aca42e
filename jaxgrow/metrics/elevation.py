"""Signed height above the former surface, and the raised part."""

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from jaxgrow.energy.distance import closest_weights, split_corners
from jaxgrow.energy.vectors import split
from jaxgrow.numerics.guards import safe_norm
from jaxgrow.state import FormerSurface


RAISED = 0.5
"""Height (r0) above the former surface from which on the surface is raised."""

FLAT = 0.25
"""Height (r0) up to which it is not raised; in between it counts in part."""

_ON = 1e-6
"""Distance (r0) below which the surface's normal replaces the direction to it."""


def smoothstep(share: Float[Array, "*shape"]) -> Float[Array, "*shape"]:
    """Return s²(3 - 2s) of a share clipped to 0 and 1, dimensionless.

    It is the part of a ball's volume below a plane that cuts off the share s of its
    diameter, and it is continuously differentiable.
    """
    share = jnp.clip(share, 0, 1)
    return share**2 * (3 - 2 * share)


def raisedness(above: Float[Array, "*shape"]) -> Float[Array, "*shape"]:
    """Return the share by which a height is raised: 0 to FLAT, 1 from RAISED."""
    return smoothstep((above - FLAT) / (RAISED - FLAT))


def height_above(
    points: Float[Array, "n 3"], former: FormerSurface
) -> Float[Array, " n"]:
    """Compute the signed distance to the former surface, in r0.

    It is positive on the lumen's side.

    The derivative is the one at a fixed nearest triangle. It jumps where two triangles
    are equally near, but not over one smooth surface; and beside the patch, where the
    side is that of the plane of the nearest triangle, the sign itself does.
    """
    return height_and_direction(points, former)[0]


def height_and_direction(
    points: Float[Array, "n 3"], former: FormerSurface
) -> tuple[Float[Array, " n"], Float[Array, "n 3"]]:
    """Compute the height above the former surface and its gradient.

    The gradient is the unit vector from the nearest point of the former surface, into
    the lumen; on the surface it is the normal of the nearest triangle.
    """
    corners = former.vertices[former.faces]
    # all pairs are compared without derivatives, which are those of the nearest alone
    fixed, fixed_corners = jax.lax.stop_gradient((points, corners))
    nearest = jax.lax.map(
        lambda point: jnp.argmin(_square_distances(point, fixed_corners)),
        fixed,
        batch_size=64,
    )
    triangle = corners[nearest]
    weights = jnp.stack(
        closest_weights(split(points), *split_corners(triangle)), axis=1
    )
    offset = points - jnp.sum(weights[..., None] * triangle, axis=1)
    normal = jnp.cross(triangle[:, 1] - triangle[:, 0], triangle[:, 2] - triangle[:, 0])
    size = safe_norm(normal)
    normal = normal / jnp.where(size > 0, size, 1)[:, None]
    to_plane = jnp.sum(offset * normal, axis=1)
    distance = safe_norm(offset)
    away = distance > _ON
    height = jnp.where(away, jnp.sign(to_plane) * distance, to_plane)
    outwards = offset / jnp.where(away, height, 1)[:, None]
    return height, jnp.where(away[:, None], outwards, normal)


def _square_distances(
    point: Float[Array, "3"], corners: Float[Array, "g 3 3"]
) -> Float[Array, " g"]:
    """Compute squared distances of one point to all triangles."""
    a, b, c = jnp.moveaxis(corners, (1, 2), (0, 1))
    ab, bc, ca = b - a, c - b, a - c
    normal = jnp.cross(ab, bc, axis=0)
    square = _dot(normal, normal)
    inside = square > 0
    to_sides = jnp.full_like(square, jnp.inf)
    for start, side in ((a, ab), (b, bc), (c, ca)):
        gap = point[:, None] - start
        inside &= _dot(jnp.cross(normal, side, axis=0), gap) > 0
        length = _dot(side, side)
        share = jnp.clip(_dot(gap, side) / jnp.where(length > 0, length, 1), 0, 1)
        rest = gap - share[None, :] * side
        to_sides = jnp.minimum(to_sides, _dot(rest, rest))
    to_plane = _dot(normal, point[:, None] - a) ** 2 / jnp.where(inside, square, 1)
    return jnp.where(inside, to_plane, to_sides)


def _dot(a: Float[Array, "3 g"], b: Float[Array, "3 g"]) -> Float[Array, " g"]:
    return jnp.sum(a * b, axis=0)

"""Height and width of a lesion: extents of its raised surface."""

import jax.numpy as jnp
from jaxtyping import Array, Float

from jaxgrow.metrics.elevation import RAISED, raisedness
from jaxgrow.metrics.extremes import largest, temperature
from jaxgrow.numerics.guards import safe_divide, safe_norm
from jaxgrow.runtime.types import Scalar
from jaxgrow.state import Membrane


DIRECTIONS = 32
"""Directions across the axis, every 180°/32; the error of a width is at most 0.12 %."""


def height_of(
    membrane: Membrane,
    above: Float[Array, " m"],
    axis: Float[Array, "3"],
    smoothing: Scalar | None,
) -> Float[Array, ""]:
    """Compute the height in r0 of the highest vertex over the site.

    Each vertex's height is multiplied by its raisedness.

    Args:
        membrane: its vertices are relative to the site.
        above: height of each vertex above the former surface.
        axis: unit normal of the former surface at the site.
        smoothing: largest error in r0; None for the exact maximum.
    """
    alive = membrane.vertex_alive
    count = jnp.sum(alive.astype(above.dtype))
    heights = raisedness(above) * (membrane.vertices @ axis)
    return largest(heights, alive, temperature(smoothing, count))


def width_of(
    membrane: Membrane,
    above: Float[Array, " m"],
    axis: Float[Array, "3"],
    smoothing: Scalar | None,
) -> Float[Array, ""]:
    """Compute the largest extent of the raised surface across the axis, in r0.

    Its corners are the raised vertices, and the points where edges cross the level
    `RAISED`. A vertex that is raised in part counts in part: it is moved towards the
    middle of the raised vertices. So the width is continuous when a vertex rises.

    Args:
        membrane: its vertices are relative to the site.
        above: height of each vertex above the former surface.
        axis: unit normal of the former surface at the site.
        smoothing: largest error in r0; None for the exact maxima.
    """
    weight = jnp.where(membrane.vertex_alive, raisedness(above), 0)
    total = jnp.sum(weight)
    share = safe_divide(weight, jnp.full_like(weight, total), weight > 0)
    middle = share @ membrane.vertices

    start, end = membrane.edges.T
    off = jnp.abs(above - RAISED)
    both = off[start] + off[end]
    share = safe_divide(off[start], both, both > 0)
    height = above[start] + share * (above[end] - above[start])
    side = membrane.vertices[end] - membrane.vertices[start]
    crossing = membrane.vertices[start] + share[:, None] * side

    points = jnp.concatenate([membrane.vertices, crossing]) - middle[None, :]
    real = jnp.concatenate([membrane.vertex_alive, membrane.edge_alive])
    weight = raisedness(jnp.concatenate([above, height]))
    along = _directions(axis) @ (weight[:, None] * points).T
    # pairs of points and a direction are the candidates
    count = jnp.sum(real.astype(above.dtype))
    warmth = temperature(smoothing, DIRECTIONS * count**2)
    extent = largest(along, real[None, :], warmth)
    extent += largest(-along, real[None, :], warmth)
    return largest(extent, jnp.ones(DIRECTIONS, bool), warmth)


def _directions(axis: Float[Array, "3"]) -> Float[Array, "d 3"]:
    """Return unit vectors across the axis."""
    away = jnp.eye(3, dtype=axis.dtype)[jnp.argmin(jnp.abs(axis))]
    first = jnp.cross(axis, away)
    first = first / safe_norm(first)
    second = jnp.cross(axis, first)
    angle = jnp.pi * jnp.arange(DIRECTIONS, dtype=axis.dtype) / DIRECTIONS
    turn = jnp.stack([jnp.cos(angle), jnp.sin(angle)], axis=1)
    return turn @ jnp.stack([first, second])

r"""Base ring of a lesion, and the body of tissue that it closes off.

The ring is the line on the membrane at the height `RAISED` above the former surface:
there the lesion's surface leaves the former one. With the fan of triangles from the
ring's centre to its pieces, the raised surface is the closed surface of a body. For its
volume V and area A, :math:`\pi^{1/3} (6 V)^{2/3} \le A` holds whatever its shape.
"""

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Float

from jaxgrow.metrics.elevation import RAISED
from jaxgrow.metrics.field import Patches
from jaxgrow.metrics.sections import share_above
from jaxgrow.numerics.guards import safe_divide, safe_norm
from jaxgrow.state import Membrane


_BAND = 2.0
"""Heights above the ring, in r0, in which the lesion's surface meets the former one."""

_FLAT_BAND = 0.05
"""Spread of heights, in r0, below which their trend does not count."""


class Ring(eqx.Module):
    """Base ring of a lesion and what it closes off; lengths in r0.

    Attributes:
        centre: mean of its points, by length; the site if nothing is raised.
        vector: area of a surface that it bounds, along that surface's normal.
        area: of the raised surface.
        volume: of the body, closed by the fan.
        closing_area: of the fan.
    """

    centre: Float[Array, "3"]
    vector: Float[Array, "3"]
    area: Float[Array, ""]
    volume: Float[Array, ""]
    closing_area: Float[Array, ""]

    @property
    def sphericity(self) -> Float[Array, ""]:
        """π^⅓ (6 V)^⅔ over the area of the body; 0 if there is none."""
        surface = self.area + self.closing_area
        some = (self.volume > 0) & (surface > 0)
        ball = jnp.pi ** (1 / 3) * (6 * jnp.where(some, self.volume, 1)) ** (2 / 3)
        return safe_divide(jnp.where(some, ball, 0), surface, some)


def ring_of(membrane: Membrane, patches: Patches, above: Float[Array, " m"]) -> Ring:
    """Compute the base ring.

    Args:
        membrane: in r0.
        patches: its triangles' areas.
        above: height of each vertex above the former surface.
    """
    corners, heights = membrane.vertices[membrane.faces], above[membrane.faces]
    level = jnp.asarray(RAISED, above.dtype)
    start, end = _crossings(corners, heights, level)
    crossed = jnp.min(heights, axis=1) < level
    crossed &= (jnp.max(heights, axis=1) > level) & membrane.face_alive
    length = jnp.where(crossed, safe_norm(end - start), 0)
    total = jnp.sum(length)
    share = safe_divide(length, jnp.full_like(length, total), length > 0)
    centre = share @ (start + end) / 2
    fan = safe_norm(jnp.cross(start - centre[None], end - centre[None])) / 2

    raised = share_above(heights, level)
    cone = jnp.sum(patches.vector * (corners[:, 0] - centre[None]), axis=1) / 3
    return Ring(
        centre=centre,
        vector=raised @ patches.vector,
        area=jnp.sum(raised * patches.area),
        volume=jnp.sum(raised * cone),
        closing_area=jnp.sum(jnp.where(crossed, fan, 0)),
    )


def _crossings(
    corners: Float[Array, "f 3 3"],
    heights: Float[Array, "f 3"],
    level: Float[Array, ""],
) -> tuple[Float[Array, "f 3"], Float[Array, "f 3"]]:
    """Compute both ends of a level line in each triangle that it crosses."""
    order = jnp.argsort(heights, axis=1)
    low, middle, high = jnp.moveaxis(
        jnp.take_along_axis(corners, order[:, :, None], axis=1), 1, 0
    )
    z_low, z_middle, z_high = jnp.take_along_axis(heights, order, axis=1).T

    def between(
        a: Float[Array, "f 3"],
        b: Float[Array, "f 3"],
        z_a: Float[Array, " f"],
        z_b: Float[Array, " f"],
    ) -> Float[Array, "f 3"]:
        share = safe_divide(level - z_a, z_b - z_a, z_b > z_a)
        return a + share[:, None] * (b - a)

    lower = (level < z_middle)[:, None]
    other = jnp.where(
        lower,
        between(low, middle, z_low, z_middle),
        between(middle, high, z_middle, z_high),
    )
    return between(low, high, z_low, z_high), other


def contact_angle(
    membrane: Membrane,
    patches: Patches,
    above: Float[Array, " m"],
    direction: Float[Array, "m 3"],
) -> Float[Array, ""]:
    r"""Compute the angle between lesion and former surface, in degrees.

    Its cosine is :math:`-n \cdot g` with the normal n of the lesion's surface and the
    gradient g of the height above the former one. On a sphere that is linear in the
    height; so the trend over the first two r0 above the base ring is followed down to
    height 0. 180 if nothing is raised.

    Args:
        membrane: in r0.
        patches: its triangles' areas.
        above: height of each vertex above the former surface.
        direction: gradient of that height.
    """
    height = jnp.mean(above[membrane.faces], axis=1)
    gradient = jnp.mean(direction[membrane.faces], axis=1)
    size = safe_norm(gradient) * patches.area
    along = jnp.sum(patches.vector * gradient, axis=1)
    cosine = -safe_divide(along, size, size > 0)
    share = (height - RAISED) / _BAND
    inside = (share > 0) & (share < 1)
    weight = jnp.where(inside, patches.area * share * (1 - share), 0)
    total = jnp.sum(weight)
    some = total > 0
    weight = safe_divide(weight, jnp.full_like(weight, total), weight > 0)
    mean_height, mean_cosine = weight @ height, weight @ cosine
    off = height - mean_height
    spread = weight @ off**2 + _FLAT_BAND**2
    slope = weight @ (off * (cosine - mean_cosine)) / spread
    at_foot = jnp.where(some, mean_cosine - slope * mean_height, -1)
    return jnp.degrees(jnp.arccos(jnp.clip(at_foot, -1 + 1e-9, 1 - 1e-9)))

r"""Cross-sections of a lesion by planes across its axis.

The area of the section by a plane with the normal t is the flux of t through the
surface on its far side, :math:`\sum_f \int_{f,\, z > 0} n \cdot t \, dA` with the
distance z from the plane. It is exact for triangles, needs no contour, and is
continuously differentiable.

What is not raised lies on the near side of every plane. So a plane that runs into the
base is continued along the base ring; the projection of that line on the plane is what
bounds the area.
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from jaxgrow.metrics.axis import Axis
from jaxgrow.metrics.elevation import RAISED
from jaxgrow.metrics.field import Patches
from jaxgrow.state import Membrane


LEVELS = 48
"""Number of sections, evenly spaced from the base ring to the tip. The error of a
narrowest section between two of them is of second order: for a neck with a hollow of
radius a, the square of half their distance over a."""


def share_above(z: Float[Array, "f 3"], level: Float[Array, ""]) -> Float[Array, " f"]:
    """Compute the share of each triangle's area above a level.

    The triangle is given by its corners' heights.
    """
    a, b, c = z.T
    less, more = jnp.minimum(a, b), jnp.maximum(a, b)
    low, high = jnp.minimum(less, c), jnp.maximum(more, c)
    middle = jnp.maximum(less, jnp.minimum(more, c))
    below = (level - low) ** 2 / _positive((middle - low) * (high - low))
    top = (high - level) ** 2 / _positive((high - middle) * (high - low))
    share = jnp.where(level < middle, 1 - below, top)
    return jnp.where(level <= low, 1, jnp.where(level >= high, 0, share))


class Sections(NamedTuple):
    """Cross-sections of a lesion; lengths in r0.

    Attributes:
        level: lengths along the axis from the base ring.
        diameter: of circles with their areas.
        distance: of each vertex from each plane.
    """

    level: Float[Array, " h"]
    diameter: Float[Array, " h"]
    distance: Float[Array, "h m"]


def sections_of(
    membrane: Membrane,
    patches: Patches,
    axis: Axis,
    above: Float[Array, " m"],
    raised: Float[Array, " m"],
) -> Sections:
    """Compute the sections of a lesion.

    Args:
        membrane: in r0.
        patches: its triangles' areas.
        axis: of the lesion.
        above: height of each vertex above the former surface.
        raised: raisedness of each vertex.
    """
    level = axis.length * jnp.arange(LEVELS, dtype=above.dtype) / LEVELS
    _, tangent = axis.at(level)
    distance = axis.distances(membrane.vertices, level)
    below = above - RAISED  # negative wherever the surface is raised in part only

    def area(
        distance: Float[Array, " m"], tangent: Float[Array, "3"]
    ) -> Float[Array, ""]:
        z = distance - (1 - raised) * jnp.maximum(distance - below, 0)
        share = share_above(z[membrane.faces], jnp.zeros((), z.dtype))
        return jnp.sum(share * (patches.vector @ tangent))

    return Sections(level, diameters(jax.vmap(area)(distance, tangent)), distance)


def diameters(area: Float[Array, "*h"]) -> Float[Array, "*h"]:
    """Return the diameters of circles with these areas; 0 for none."""
    some = area > 0
    return jnp.where(some, 2 * jnp.sqrt(jnp.where(some, area, 1) / jnp.pi), 0)


def _positive(value: Float[Array, " f"]) -> Float[Array, " f"]:
    """Bound denominators of level triangles, whose share is 0 or 1 anyway."""
    return jnp.maximum(value, 1e-12)

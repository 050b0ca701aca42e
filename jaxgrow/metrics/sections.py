r"""Cross-sections of a lesion across its axis, with the neck.

The area of the section at a height h is the flux of the axis through the raised
surface above h, :math:`A(h) = \sum_t \int_{t,\, z > h} n \cdot a \, dA`. It is exact
for triangles, needs no contour, and is continuously differentiable.

In a hollow organ the surroundings of a lesion rise with the distance from its site. For
sections their height is therefore at most that above the former surface, and only
raised parts have their height over the site (`section_heights`). Over a flat surface
both are the same.
"""

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from jaxgrow.metrics.elevation import raisedness
from jaxgrow.metrics.extremes import largest, smallest, temperature
from jaxgrow.runtime.types import Scalar


LEVELS = 48
"""Number of sections, evenly spaced from half an r0 to the tip. The error of a
narrowest section between two of them is of second order: for a neck with a hollow of
radius a, the square of half their distance over a."""


def section_heights(
    z: Float[Array, " m"], above: Float[Array, " m"]
) -> Float[Array, " m"]:
    """Return the height of each vertex for sections, in r0.

    Args:
        z: height over the site, along the axis.
        above: height above the former surface.
    """
    return z - (1 - raisedness(above)) * jnp.maximum(z - above, 0)


def share_above(z: Float[Array, "f 3"], level: Float[Array, ""]) -> Float[Array, " f"]:
    """Compute the share of each triangle's area above a level.

    The triangle is given by its corners' heights.
    """
    low, middle, high = jnp.sort(z, axis=1).T
    below = (level - low) ** 2 / _positive((middle - low) * (high - low))
    top = (high - level) ** 2 / _positive((high - middle) * (high - low))
    share = jnp.where(level < middle, 1 - below, top)
    return jnp.where(level <= low, 1, jnp.where(level >= high, 0, share))


def mean_above(z: Float[Array, "f 3"], level: Float[Array, ""]) -> Float[Array, " f"]:
    """Compute the mean of max(0, z - level) over each triangle.

    It is the integral of `share_above`.
    """
    low, middle, high = jnp.sort(z, axis=1).T
    whole = (low + middle + high) / 3 - level
    below = (level - low) ** 3 / _positive(3 * (middle - low) * (high - low))
    top = (high - level) ** 3 / _positive(3 * (high - middle) * (high - low))
    mean = jnp.where(level < middle, whole + below, top)
    return jnp.where(level <= low, whole, jnp.where(level >= high, 0, mean))


def section_areas(
    z: Float[Array, "f 3"], flux: Float[Array, " f"], levels: Float[Array, " h"]
) -> Float[Array, " h"]:
    """Compute the area of the section at each level.

    Args:
        z: height of the corners of each triangle.
        flux: of the axis through each triangle: its area projected along the axis.
        levels: heights.
    """
    return jax.vmap(lambda level: jnp.sum(share_above(z, level) * flux))(levels)


def diameters(area: Float[Array, " h"]) -> Float[Array, " h"]:
    """Return the diameters of circles with these areas; 0 for none."""
    some = area > 0
    return jnp.where(some, 2 * jnp.sqrt(jnp.where(some, area, 1) / jnp.pi), 0)


def necks(
    diameter: Float[Array, " h"], smoothing: Scalar | None
) -> tuple[Float[Array, " h"], Float[Array, ""]]:
    r"""Compute the diameter by which each section counts as the neck.

    The least of them is returned too.

    .. math:: c_i = d_i + 2 \, (\max_j d_j - \max_{j \ge i} d_j)

    Up to the widest section that is its diameter :math:`d_i`; above it the difference
    to the widest is added twice, so that the neck is the narrowest section below the
    widest one, and is continuous when another section becomes the widest. Without a
    section narrower than one above it the neck is the base.

    Args:
        diameter: of the sections, from the base upwards.
        smoothing: largest error of the least; None for exact maxima and minima.
    """
    levels = diameter.shape[0]
    # three extremes, with an error of at most two bounds to either side, and one up
    warmth = temperature(None if smoothing is None else smoothing / 3, levels)
    upwards = jnp.tri(levels, dtype=bool).T
    from_here = largest(jnp.broadcast_to(diameter, upwards.shape), upwards, warmth)
    counted = diameter + 2 * (from_here[0] - from_here)
    return counted, smallest(counted, warmth)


def _positive(value: Float[Array, " f"]) -> Float[Array, " f"]:
    """Bound denominators of level triangles, whose share is 0 or 1 anyway."""
    return jnp.maximum(value, 1e-12)

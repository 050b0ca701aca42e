"""Height of a lesion over its site."""

import jax.numpy as jnp
from jaxtyping import Array, Float

from jaxgrow.metrics.elevation import raisedness
from jaxgrow.metrics.extremes import largest, temperature
from jaxgrow.runtime.types import Scalar
from jaxgrow.state import Membrane


def height_of(
    membrane: Membrane,
    above: Float[Array, " m"],
    normal: Float[Array, "3"],
    smoothing: Scalar | None,
) -> Float[Array, ""]:
    """Compute the height in r0 of the highest vertex over the site.

    Each vertex's height is multiplied by its raisedness.

    Args:
        membrane: its vertices are relative to the site.
        above: height of each vertex above the former surface.
        normal: unit normal of the former surface at the site.
        smoothing: largest error in r0; None for the exact maximum.
    """
    alive = membrane.vertex_alive
    count = jnp.sum(alive.astype(above.dtype))
    heights = raisedness(above) * (membrane.vertices @ normal)
    return largest(heights, alive, temperature(smoothing, count))

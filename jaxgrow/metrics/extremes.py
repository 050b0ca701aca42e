r"""Maximum and minimum of several values, exact or smooth with known error.

With the temperature :math:`\tau` the smooth maximum of n values is

.. math:: \tau \log \sum_{i=1}^n e^{x_i / \tau},

from 0 to :math:`\tau \log n` above the exact one. Candidates within about :math:`\tau`
of the maximum share its derivative, so that it has no kink where the maximum changes
places. The smooth minimum is also from 0 to :math:`\tau \log n` above the exact one, so
that it is positive where the values are.
"""

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float

from jaxgrow.runtime.types import Scalar


def temperature(bound: Scalar | None, count: Scalar) -> Float[Array, ""] | None:
    """Return the temperature at which n values have at most this error.

    None is exact.
    """
    return None if bound is None else bound / jnp.log(jnp.maximum(count, 2))


def largest(
    values: Float[Array, "*shape n"],
    real: Bool[Array, "*#shape n"],
    warmth: Float[Array, ""] | None,
) -> Float[Array, "*shape"]:
    """Return the maximum over the last axis, exact or smooth.

    Args:
        values: in any unit.
        real: False for values that do not count; some must.
        warmth: temperature in the unit of the values; None for the exact maximum.
    """
    values = jnp.where(real, values, -jnp.inf)
    if warmth is None:
        return jnp.max(values, axis=-1)
    return warmth * jax.nn.logsumexp(values / warmth, axis=-1)


def smallest(
    values: Float[Array, " n"], warmth: Float[Array, ""] | None
) -> Float[Array, ""]:
    """Return the minimum, exact or smooth; arguments as in `largest`."""
    least = -largest(-values, jnp.ones_like(values, bool), warmth)
    return least if warmth is None else least + warmth * jnp.log(values.shape[0])

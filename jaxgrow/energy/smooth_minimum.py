r"""Smooth minimum of distances, for contact with a triangulated surface.

The exact distance to a surface, :math:`\min_t d_t` over its triangles, has kinks on the
medial axis, and inside a fold or under a tip a particle is pushed precisely there, so
that equilibria are not smooth and relaxation does not converge. With q half of the
sharpness p, the reach R, and all distances :math:`u_t` in units of a range,

.. math::
    u = \left( \Big( \sum_t a_t^2 \Big)^{1/2} + R^{-q} \right)^{-1/q}, \qquad
    a_t = \max(0, u_t^{-q} - R^{-q})

- one triangle gives exactly :math:`\min(u_t, R)`, and more never overestimate it;
- the error is relative: n triangles equally far give a factor of at least
  :math:`n^{-1/p}`, so u vanishes only where the exact distance does, and a barrier
  stays meaningful (a log-sum-exp, with its absolute error, turns negative under a
  vertex of the membrane);
- it tends to :math:`\min_t u_t` as p grows;
- it is continuously differentiable below R (for a force that is 0 at R), and triangles
  beyond the reach do not count at all, so that a list of the near ones is exact.
"""

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int

from jaxgrow.numerics.guards import smallest_distance
from jaxgrow.runtime.types import Scalar


def smooth_minimum(
    u: Float[Array, " p"],
    owner: Int[Array, " p"],
    real: Bool[Array, " p"],
    count: int,
    *,
    sharpness: Scalar,
    reach: float,
) -> Float[Array, " n"]:
    """Return the smooth minimum of the values of each owner.

    Args:
        u: values, not negative.
        owner: of each value, ascending.
        real: False for values that do not count.
        count: number of owners n.
        sharpness: exponent p.
        reach: R, from which on values do not count.

    Returns:
        u as in the module's formula; the reach where no value is below it.
    """
    u = jnp.where(real, u, reach)
    half = sharpness / 2
    nearest = jax.ops.segment_min(u, owner, count, indices_are_sorted=True)
    # the formula is homogeneous: measured in the nearest distance nothing overflows
    least = smallest_distance(u.dtype)
    unit = jax.lax.stop_gradient(jnp.clip(nearest, least, reach))
    unit_of_pair = unit[owner]
    far = _power(unit / reach, half)
    positive = jnp.maximum(u, least)
    excess = _power(unit_of_pair / positive, half) - far[owner]
    square = jnp.where(real, jnp.maximum(excess, 0) ** 2, 0)
    total = jax.ops.segment_sum(square, owner, count, indices_are_sorted=True)
    some = total > 0
    norm = jnp.where(some, jnp.sqrt(jnp.where(some, total, 1)), 0)
    inner = jnp.where(some, norm + far, 1)
    return jnp.where(some, unit * _power(inner, -1 / half), reach)


def _power(base: Float[Array, "*p"], exponent: Scalar) -> Float[Array, "*p"]:
    """Raise a positive base to a power; on a CPU faster than the operator."""
    return jnp.exp(exponent * jnp.log(base))

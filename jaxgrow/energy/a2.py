r"""A2 force profile, shared by all particle interactions of the model.

In the distance :math:`u = r/r_0` the paper (§3, function A2) prints

.. math::
    F(u) = 1 - u^2 \;(u < 1/2), \quad
    F(u) = (1 - u)(2 - u)/2 \;(1/2 \le u \le 3/2), \quad
    F(u) = 0 \;(u > 3/2),

the interpolation kernel :math:`\Lambda_2` of Cottet and Koumoutsakos, *Vortex
Methods* (2000). Force and energy are in units of :math:`F(0)` and
:math:`F(0) r_0`; positive force repels.

Two numbers extend it:

*adhesion* :math:`\alpha` scales the attractive branch :math:`u > 1`. The printed law
(:math:`\alpha = 1`) is not H-stable in three dimensions: the virial integral
:math:`\int F u^3 du` is 149/3840 over the repulsive branch and
:math:`-371/3840` over the attractive one, so above
:math:`\alpha^* = 149/371 \approx 0.40` the energy per particle has no lower bound and a
cluster that is relaxed after every division collapses into itself.

*smoothing* :math:`\epsilon` removes the two jumps of the force. Over
:math:`1/2 \pm \epsilon` the two printed branches are blended with a weight that is
linear in u; over :math:`[3/2 - \epsilon, 3/2]` the force is tapered linearly to 0.
Without it equilibria are not smooth: pairs settle exactly on the kink of the energy at
u = 1/2. :math:`\epsilon = 0` is the printed law, to the last digit.
"""

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from jaxgrow.runtime.types import Scalar


CUTOFF = 1.5
"""Distance, in r0, from which on particles do not interact."""

STABLE_ADHESION = 149 / 371
"""Largest adhesion for which the energy per particle is bounded below in 3-D."""


def _near_integral(u: Float[Array, "..."]) -> Float[Array, "..."]:
    """Return the antiderivative of 1 - u²."""
    return u - u**3 / 3


def _far_integral(u: Float[Array, "..."]) -> Float[Array, "..."]:
    """Return the antiderivative of (1 - u)(2 - u)/2."""
    return u - 0.75 * u**2 + u**3 / 6


class A2(eqx.Module):
    """A2 force profile with adhesion and smoothing; by default as printed.

    Attributes:
        adhesion: factor of the attractive branch (u > 1), dimensionless.
        smoothing: half width of the blend at u = 1/2 and width of the taper below
            u = 3/2, in r0; from 0 to 1/2.
    """

    adhesion: Float[Array, "..."] | float = 1.0
    smoothing: Scalar = 0.0

    def force(self, u: Float[Array, "*shape"]) -> Float[Array, "*shape"]:
        """Return the force at distance u (in r0), in F(0); positive repels."""
        width, some = _width(u, self.smoothing)
        near = 1 - u**2
        far = (1 - u) * (2 - u) / 2
        share = jnp.clip((u - (0.5 - width)) / (2 * some), 0, 1)
        share = jnp.where(width > 0, share, jnp.where(u < 0.5, 0, 1))
        taper = jnp.clip((CUTOFF - u) / some, 0, 1)
        taper = jnp.where(width > 0, taper, jnp.where(u <= CUTOFF, 1, 0))
        scale = jnp.where(u > 1, self.adhesion, 1) * taper
        return near * (1 - share) + far * share * scale

    def energy(self, u: Float[Array, "*shape"]) -> Float[Array, "*shape"]:
        r"""Return :math:`U(u) = \int_u^{3/2} F` in units of F(0) r0; U(3/2) = 0.

        Its derivative in u is minus `force`, not that of the integrated formula, which
        is the same but for rounding.
        """
        law = jax.tree.map(lambda number: jnp.asarray(number, u.dtype), self)
        return _energy(law, u)


def _width(
    u: Float[Array, "..."], smoothing: Scalar
) -> tuple[Float[Array, ""], Float[Array, ""]]:
    """Return the smoothing in u's precision, and a copy safe to divide by."""
    width = jnp.asarray(smoothing, u.dtype)
    return width, jnp.where(width > 0, width, 1)


def _integral(law: A2, u: Float[Array, "*shape"]) -> Float[Array, "*shape"]:
    """Return the integral of the force beyond u.

    Each branch is a polynomial and is integrated exactly; the sum over the branches of
    the integral over their part beyond u is continuous by construction.
    """
    width, some = _width(u, law.smoothing)
    start, stop = 0.5 - width, 0.5 + width

    def beyond(
        integral: Float[Array, "*shape"], end: Float[Array, ""]
    ) -> Float[Array, "*shape"]:
        return end - integral

    inner = jnp.minimum(u, start)
    value = beyond(_near_integral(inner), _near_integral(start))

    blend = jnp.clip(u, start, stop)
    value += beyond(_near_integral(blend), _near_integral(stop))

    def blend_integral(v: Float[Array, "..."]) -> Float[Array, "..."]:
        # weight (v - start) / 2ε times the difference 3/2 (v² - v) of the branches
        return 0.75 / some * (v**4 / 4 - (1 + start) * v**3 / 3 + start * v**2 / 2)

    value += jnp.where(
        width > 0, beyond(blend_integral(blend), blend_integral(stop)), 0
    )

    one = jnp.ones_like(width)
    value += beyond(_far_integral(jnp.clip(u, stop, one)), _far_integral(one))

    edge = CUTOFF - width
    attraction = beyond(_far_integral(jnp.clip(u, one, edge)), _far_integral(edge))

    def taper_integral(v: Float[Array, "..."]) -> Float[Array, "..."]:
        return (3 * v - 3.25 * v**2 + 1.5 * v**3 - v**4 / 4) / (2 * some)

    tail = jnp.clip(u, edge, CUTOFF)
    end = jnp.full_like(width, CUTOFF)
    attraction += jnp.where(
        width > 0, beyond(taper_integral(tail), taper_integral(end)), 0
    )
    return value + law.adhesion * attraction


@jax.custom_jvp
def _energy(law: A2, u: Float[Array, "*shape"]) -> Float[Array, "*shape"]:
    return _integral(law, u)


@_energy.defjvp
def _energy_jvp(
    primals: tuple[A2, Array], tangents: tuple[A2, Array]
) -> tuple[Array, Array]:
    law, u = primals
    value, varied = jax.jvp(lambda of: _integral(of, u), (law,), (tangents[0],))
    return value, varied - law.force(u) * tangents[1]

r"""Unconstrained coordinates of parameters between bounds.

With the share :math:`s = 1/(1 + e^{-u})` of the way from the lower bound a to the upper
one b,

.. math:: p = a (b/a)^s \quad (a > 0), \qquad p = a + (b - a)\, s \quad (a \le 0),

so every u maps to a value between the bounds. A parameter whose value (or its
logarithm, if a > 0) is uniform between them has a logistic density in u, with variance
:math:`\pi^2/3`.
"""

import math
from collections.abc import Iterable

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float

from jaxgrow.calibration.spec import Bounds


PRIOR_VARIANCE = math.pi**2 / 3
"""Variance of a coordinate of which only the bounds are known."""


class Coordinates(eqx.Module):
    """Bijection of unconstrained coordinates and parameters, in 64 bits.

    Attributes:
        low: lower bounds.
        high: upper bounds.
        logarithmic: whether a parameter is sought on a logarithmic scale.
    """

    low: Float[Array, " p"]
    high: Float[Array, " p"]
    logarithmic: Bool[Array, " p"]

    @classmethod
    def between(cls, bounds: Iterable[Bounds]) -> "Coordinates":
        """Return the coordinates between these bounds."""
        bounds = list(bounds)
        low = jnp.asarray([b.low for b in bounds], float)
        high = jnp.asarray([b.high for b in bounds], float)
        return cls(low, high, low > 0)

    def parameters(self, u: Float[Array, " p"]) -> Float[Array, " p"]:
        """Map coordinates to parameters."""
        low, high = self._scaled(self.low), self._scaled(self.high)
        value = low + (high - low) * jax.nn.sigmoid(u)
        power = jnp.exp(jnp.where(self.logarithmic, value, 0))
        # rounding must not leave the bounds
        return jnp.clip(jnp.where(self.logarithmic, power, value), self.low, self.high)

    def coordinates(self, values: Float[Array, " p"]) -> Float[Array, " p"]:
        """Map parameters between the bounds to coordinates."""
        low, high = self._scaled(self.low), self._scaled(self.high)
        share = (self._scaled(values) - low) / (high - low)
        return jax.scipy.special.logit(share)

    def slopes(self, u: Float[Array, " p"]) -> Float[Array, " p"]:
        """Return the derivative of every parameter in its own coordinate."""
        return jax.jvp(self.parameters, (u,), (jnp.ones_like(u),))[1]

    def _scaled(self, values: Float[Array, " p"]) -> Float[Array, " p"]:
        logarithm = jnp.log(jnp.where(self.logarithmic, values, 1))
        return jnp.where(self.logarithmic, logarithm, values)

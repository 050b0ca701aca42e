r"""Unconstrained coordinates of parameters between bounds.

With the share :math:`s = 1/(1 + e^{-u})` of the way from the lower bound a to the upper
one b,

.. math:: p = a (b/a)^s \quad (a > 0), \qquad p = a + (b - a)\, s \quad (a \le 0),

so every u stands for a value between the bounds. A parameter that may be anything
between them, all (logarithms of) values being equally likely, has a logistic density
in u, with variance :math:`\pi^2/3`.
"""

import math
from collections.abc import Iterable

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float

from jaxgrow.calibration.spec import Bounds


PRIOR_VARIANCE = math.pi**2 / 3
"""Of a coordinate of which nothing is known but the bounds."""


class Coordinates(eqx.Module):
    """The map between coordinates and parameters, in 64 bits.

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
        """The coordinates between these bounds."""
        bounds = list(bounds)
        low = jnp.asarray([b.low for b in bounds], float)
        high = jnp.asarray([b.high for b in bounds], float)
        return cls(low, high, low > 0)

    def parameters(self, u: Float[Array, " p"]) -> Float[Array, " p"]:
        """The parameters at these coordinates."""
        low, high = self._scaled(self.low), self._scaled(self.high)
        value = low + (high - low) * jax.nn.sigmoid(u)
        power = jnp.exp(jnp.where(self.logarithmic, value, 0))
        # rounding must not leave the bounds
        return jnp.clip(jnp.where(self.logarithmic, power, value), self.low, self.high)

    def coordinates(self, values: Float[Array, " p"]) -> Float[Array, " p"]:
        """The coordinates of parameters between the bounds."""
        low, high = self._scaled(self.low), self._scaled(self.high)
        share = (self._scaled(values) - low) / (high - low)
        return jax.scipy.special.logit(share)

    def slopes(self, u: Float[Array, " p"]) -> Float[Array, " p"]:
        """The derivative of every parameter in its own coordinate."""
        return jax.jvp(self.parameters, (u,), (jnp.ones_like(u),))[1]

    def _scaled(self, values: Float[Array, " p"]) -> Float[Array, " p"]:
        logarithm = jnp.log(jnp.where(self.logarithmic, values, 1))
        return jnp.where(self.logarithmic, logarithm, values)

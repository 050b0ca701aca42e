"""Relaxation by the paper's eq. 1 with all positions updated at once."""

import equinox as eqx
from jaxtyping import Array, Bool, Float

from jaxgrow.runtime.types import Scalar


class Euler(eqx.Module):
    r"""Steepest descent :math:`x \leftarrow x + \frac{h^2}{m} F`.

    "The time step h has to be selected small enough to prevent particles from
    outrunning each other": it diverges from :math:`2/\lambda` on, with λ the largest
    eigenvalue of the Hessian, about 18 F(0)/r0 in a dense cluster with the default
    adhesion.

    Attributes:
        rate: h²/m, in r0/F(0).
    """

    rate: Scalar = 0.09

    def init(self, force: Float[Array, "d 3"]) -> None:
        """Return None: the method has no memory."""
        del force

    def propose(
        self, memory: None, force: Float[Array, "d 3"]
    ) -> tuple[Float[Array, "d 3"], None]:
        """Return the displacement along the force."""
        del memory
        return self.rate * force, None

    def learn(
        self,
        memory: None,
        displacement: Float[Array, "d 3"],
        before: Float[Array, "d 3"],
        after: Float[Array, "d 3"],
        made: Bool[Array, ""],
    ) -> None:
        """Return None: the method has no memory."""
        del memory, displacement, before, after, made

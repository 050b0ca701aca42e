r"""Energy of the springs on the membrane's edges (paper §3).

.. math::
    E = \sum_e \tfrac12 k (\ell_e - (1 - \tau) \ell^0_e)^2

with the spring stiffness k in F(0)/r0 and lengths in r0; :math:`\ell^0` is the length
of the edge when the springs were last reset.

The pretension :math:`\tau` is ours; the paper resets to :math:`\ell^0` itself. With
:math:`\tau = 0` a membrane has no linear stiffness out of its plane right after each
reset, so it dives into every gap between the particles that it adheres to, and crumples
at the base of a lesion. The paper asks for "a small tension in the surface" that acts
"as a smoothing factor"; :math:`\tau` is that tension. Its force :math:`k \tau \ell` per
edge, proportional to the length, also draws every vertex towards the mean of its
neighbours, which keeps triangles even.
"""

from typing import Any

from jaxtyping import Array, Bool, Int

from jaxgrow.energy.term import MembraneTerm
from jaxgrow.energy.vectors import minus, norm
from jaxgrow.runtime.types import Columns
from jaxgrow.state import Membrane


class Springs(MembraneTerm):
    """Springs on the edges; rest data: the length of the edge."""

    name = "springs"
    size = 2
    parameters = ("spring_stiffness", "pretension")
    modulus = "spring_stiffness"
    per = "edge"

    def energy(self, x: tuple[Columns, ...], rest: Columns, p: Any) -> Array:
        """Return k (ℓ − (1 − τ) ℓ⁰)² / 2 of one edge, in F(0) r0."""
        stretch = norm(minus(x[1], x[0])) - (1 - p.pretension) * rest[0]
        return 0.5 * p.spring_stiffness * stretch**2

    def rest(self, x: tuple[Columns, ...]) -> Columns:
        """Return the length of the edge, in r0."""
        return (norm(minus(x[1], x[0])),)

    def stencil(
        self, membrane: Membrane
    ) -> tuple[Int[Array, "e 2"], Bool[Array, " e"]]:
        """Return the ends of each edge."""
        return membrane.edges, membrane.edge_alive

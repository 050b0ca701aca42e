r"""Elastic energy of healthy endometrium, by springs that are never reset.

.. math::
    E = \sum_e \tfrac12 k_h\, h_e\, (\ell_e - L_e)^2

over the edges, with the length :math:`L_e` in the reference positions
(`Membrane.reference`) and the healthy share :math:`h_e`, 0 where a vertex of the edge
is hyperplastic (`jaxgrow.energy.term.HealthyTerm`). The stiffness :math:`k_h` is in
F(0)/r0.

The springs of the paper are reset after every division, so the membrane flows, and a
lesion's base widens as it grows. Healthy endometrium does not grow: round a focus of
hyperplasia (`jaxgrow.lesions.focus`) it is a ring of nearly fixed length, which becomes
the lesion's neck. A lattice of springs of stiffness k on equilateral triangles has, for
small strains, the Young's modulus :math:`2 k / \sqrt 3` times thickness and Poisson's
ratio 1/3.
"""

from typing import Any

from jaxtyping import Array, Bool, Int

from jaxgrow.energy.term import HealthyTerm
from jaxgrow.energy.vectors import minus, norm
from jaxgrow.runtime.types import Columns
from jaxgrow.state import Membrane


class HealthySprings(HealthyTerm):
    """Springs of healthy endometrium; rest data: length, healthy share."""

    name = "healthy"
    size = 2
    parameters = ("healthy_stiffness",)
    modulus = "healthy_stiffness"
    per = "edge"

    def energy(self, x: tuple[Columns, ...], rest: Columns, p: Any) -> Array:
        """Return k_h h (ℓ − L)² / 2 of one edge, in F(0) r0."""
        stretch = norm(minus(x[1], x[0])) - rest[0]
        return 0.5 * p.healthy_stiffness * rest[1] * stretch**2

    def rest(self, x: tuple[Columns, ...]) -> Columns:
        """Return the length of the edge, in r0."""
        return (norm(minus(x[1], x[0])),)

    def stencil(
        self, membrane: Membrane
    ) -> tuple[Int[Array, "e 2"], Bool[Array, " e"]]:
        """Return the ends of each edge."""
        return membrane.edges, membrane.edge_alive

r"""Surface tension of the membrane: an energy of its area.

.. math::
    E = \sigma \sum_f A_f

over the triangles, with the tension :math:`\sigma` in F(0)/r0. Its forces are those of
a soap film: they flatten the surface, and a film of radius R resists a pressure
:math:`p = 2 \sigma / R` (Laplace).

It is another way to the paper's "small tension in the surface" than the pretension
:math:`\tau` of the springs (`jaxgrow.energy.springs`), which is renewed at every reset.
This one has nothing to reset, and so a reset disturbs nothing where nothing moved. On
equilateral triangles springs of stiffness k with the pretension :math:`\tau` have the
tension :math:`\sigma = \sqrt 3\, k \tau` right after their reset. A film has no
stiffness along itself: nothing keeps its triangles even, which springs do.
"""

from typing import Any

from jaxtyping import Array, Bool, Int

from jaxgrow.energy.area import triangle_area
from jaxgrow.energy.term import MembraneTerm
from jaxgrow.runtime.types import Columns
from jaxgrow.state import Membrane


class Tension(MembraneTerm):
    """Tension of the triangles; it has no rest data."""

    name = "tension"
    size = 3
    parameters = ("surface_tension",)
    modulus = "surface_tension"
    per = "face"

    def energy(self, x: tuple[Columns, ...], rest: Columns, p: Any) -> Array:
        """Return σ A of one triangle, in F(0) r0."""
        del rest  # there are none
        return p.surface_tension * triangle_area(x)

    def rest(self, x: tuple[Columns, ...]) -> Columns:
        """Return nothing: no state is one of rest."""
        del x
        return ()

    def stencil(
        self, membrane: Membrane
    ) -> tuple[Int[Array, "f 3"], Bool[Array, " f"]]:
        """Return the vertices of each triangle."""
        return membrane.faces, membrane.face_alive

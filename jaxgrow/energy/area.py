r"""Energy that keeps triangles from collapsing.

.. math::
    E = \sum_t \mu A^0_t \left( J_t - 1 - \ln J_t \right), \qquad J_t = A_t / A^0_t

over the triangles, with their area :math:`A^0` when the membrane was last reset. The
modulus :math:`\mu` is in F(0)/r0. The tension of a triangle is
:math:`\mu (1 - 1/J)`: none at rest, at most :math:`\mu` under growth, and without bound
as the area vanishes. The term is the volumetric part of a compressible neo-Hookean
membrane whose bulk and shear moduli are equal (Bonet and Wood, *Nonlinear continuum
mechanics for finite element analysis*, 2008).

Soft springs alone do not resist it when particles pull two vertices of a triangle over
each other; the hinges of a collapsed triangle are then infinitely stiff, and no
equilibrium is found. The paper has no such term; :math:`\mu = 0` is its model.
"""

from typing import Any

import jax.numpy as jnp
from jaxtyping import Array, Bool, Int

from jaxgrow.energy.term import MembraneTerm
from jaxgrow.energy.vectors import cross, minus, norm
from jaxgrow.runtime.types import Columns
from jaxgrow.state import Membrane


class Area(MembraneTerm):
    """Resistance of triangles to a change of area; rest data: the area."""

    name = "area"
    size = 3
    parameters = ("area_modulus",)
    modulus = "area_modulus"
    per = "face"

    def energy(self, x: tuple[Columns, ...], rest: Columns, p: Any) -> Array:
        """Return μ A⁰ (J − 1 − ln J) of one triangle, in F(0) r0."""
        some = rest[0] > 0
        ratio = triangle_area(x) / jnp.where(some, rest[0], 1)
        # far below any triangle of a valid surface, and never NaN
        ratio = jnp.maximum(ratio, 1e-12)
        return p.area_modulus * rest[0] * (ratio - 1 - jnp.log(ratio))

    def rest(self, x: tuple[Columns, ...]) -> Columns:
        """Return the area, in r0²."""
        return (triangle_area(x),)

    def stencil(
        self, membrane: Membrane
    ) -> tuple[Int[Array, "f 3"], Bool[Array, " f"]]:
        """Return the corners of each face."""
        return membrane.faces, membrane.face_alive


def triangle_area(x: tuple[Columns, ...]) -> Array:
    """Return the area of a triangle.

    Args:
        x: its corners.
    """
    return 0.5 * norm(cross(minus(x[1], x[0]), minus(x[2], x[0])))

r"""Bending energy of the membrane, by hinges at its edges.

.. math::
    E = \sum_e \tfrac12 \kappa\, w_e\, (\theta_e - \theta^0_e)^2, \qquad
    w_e = \frac{3 \ell_e^2}{A_e}

over the edges between two triangles (hinges), with the angle :math:`\theta_e` between
their normals, positive where the surface is convex, the length :math:`\ell_e` of the
edge, and the area :math:`A_e` of the two triangles together (Grinspun, Hirani, Desbrun
and Schröder, *Discrete shells*, 2003). The weights make the bending modulus
:math:`\kappa`, in F(0) r0, independent of the triangulation: on a cylinder of radius R
whose mesh has edges along the axis the energy per area tends to
:math:`\tfrac32 \kappa / R^2`.

Springs alone have no stiffness against bending, so that a membrane follows every
particle beneath it and folds at the foot of a lesion. The paper has no such term;
:math:`\kappa = 0` is its model. Lengths and areas are those of when the springs were
last reset. The rest angle :math:`\theta^0` is 0: a flat surface has no energy. (With an
angle that is reset too, a polyp is as creased as without bending:
``experiments/studies/creases.py``.)

The angle's derivative is the inverse of the triangles' heights, so a sliver's hinge
would be stiffer than all others by orders of magnitude. Weights of hinges whose
triangles are lower than a tenth of the edge therefore fade with the third power of that
height.
"""

from typing import Any

import jax.numpy as jnp
from jaxtyping import Array, Bool, Int

from jaxgrow.energy.term import MembraneTerm
from jaxgrow.energy.vectors import cross, dot, minus, norm
from jaxgrow.runtime.types import Columns
from jaxgrow.state import Membrane


FLAT = 0.1
"""Ratio of a triangle's height to its edge below which the hinge fades."""


class Bending(MembraneTerm):
    """Bending stiffness of hinges; rest data: the angle and 3 ℓ²/area.

    Nodes of a hinge are the ends of the edge, then the vertex of the triangle that has
    the edge in this direction, then the vertex of the other triangle.
    """

    name = "bending"
    size = 4
    parameters = ("bending_stiffness",)
    modulus = "bending_stiffness"
    per = "edge"
    edges = 2

    def energy(self, x: tuple[Columns, ...], rest: Columns, p: Any) -> Array:
        """Return κ w (θ − θ⁰)² / 2 of one hinge, in F(0) r0."""
        return 0.5 * p.bending_stiffness * rest[1] * (hinge_angle(x) - rest[0]) ** 2

    def rest(self, x: tuple[Columns, ...]) -> Columns:
        """Return the rest angle 0 and the weight 3 ℓ²/A, both dimensionless."""
        edge = minus(x[1], x[0])
        square = dot(edge, edge)
        one = norm(cross(edge, minus(x[2], x[0])))
        other = norm(cross(edge, minus(x[3], x[0])))
        least = jnp.minimum(one, other) / jnp.where(square > 0, square, 1)
        area = 0.5 * (one + other)
        weight = 3 * square / jnp.where(least > 0, area, 1)
        fading = jnp.minimum(least / FLAT, 1) ** 3
        return jnp.zeros_like(weight), jnp.where(least > 0, fading * weight, 0)

    def stencil(
        self, membrane: Membrane
    ) -> tuple[Int[Array, "e 4"], Bool[Array, " e"]]:
        """Return the nodes of the hinge at each edge that has two triangles."""
        opposite = membrane.opposite
        inner = membrane.edge_alive & jnp.all(opposite >= 0, axis=1)
        nodes = jnp.concatenate([membrane.edges, jnp.maximum(opposite, 0)], axis=1)
        return nodes, inner


def hinge_angle(x: tuple[Columns, ...]) -> Array:
    """Return the angle between the normals of two triangles at their edge.

    Args:
        x: ends of the edge, the corner of the triangle that lies to the left of it
            (seen against the normals), and the corner of the other.

    Returns:
        From -π to π; 0 where a triangle has no area. Positive where the triangles bend
        away from the normals' side.
    """
    edge = minus(x[1], x[0])
    one = cross(edge, minus(x[2], x[0]))
    other = cross(minus(x[3], x[0]), edge)
    cosine = dot(one, other)
    length = norm(edge)
    # the vector product of the normals is along the edge
    sine = dot(cross(one, other), edge) / jnp.where(length > 0, length, 1)
    some = (sine != 0) | (cosine != 0)
    return jnp.arctan2(jnp.where(some, sine, 0), jnp.where(some, cosine, 1))

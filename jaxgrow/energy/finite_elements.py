r"""Elastic energy of the membrane as a continuum, by finite elements.

.. math::
    E = \sum_f h_f A_f\, W(C_f), \qquad C = G^{-1} g,

over the triangles, each of uniform strain, with the metrics g of its two edges now and
G of the same edges at rest, the area :math:`A_f` at rest, and the healthy share
:math:`h_f` (`jaxgrow.energy.term.HealthyTerm`). W is an energy per area of a sheet in
plane stress, of Young's modulus times thickness Y, in F(0)/r0, and Poisson's ratio
:math:`\nu`; :math:`\mu = Y / 2(1 + \nu)`.

*Neo-Hookean* (Blatz and Ko 1962, in Ogden's form), with :math:`m = \nu / (1 - \nu)`:

.. math::
    W = \frac{\mu}{2} \left( \operatorname{tr} C - 2
        + \frac{(\det C)^{-m} - 1}{m} \right).

The thickness is eliminated exactly: normal stress vanishes where it is stretched by
:math:`(\det C)^{-m/2}`. A strip that is stretched by :math:`\lambda` narrows to
:math:`\lambda^{-\nu}`. The energy rises ever steeper as a triangle loses its area, down
to a tenth of it; from there on :math:`\log \det C` is continued by its second-order
expansion, so that energy and forces are finite for every position.

*Saint Venant and Kirchhoff*, with Green's strain :math:`2 \varepsilon = C - 1`:

.. math::
    W = \frac{Y}{2 (1 - \nu^2)} \left( (1 - \nu) \operatorname{tr} \varepsilon^2
        + \nu (\operatorname{tr} \varepsilon)^2 \right).

It is the same for small strains, and gives way under strong compression: use it to
compare with.

A lattice of springs of stiffness k on equilateral triangles is, for small strains, such
a sheet with :math:`Y = 2 k / \sqrt 3` and :math:`\nu = 1/3`; on other triangles its
stiffness depends on their shapes, that of elements does not.

Triangles that are flatter at rest than a tenth of their longest edge fade with the
third power of that ratio, as the stiffness of a sliver is the inverse of its height.
"""

import math
from typing import Any, NamedTuple

import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int

from jaxgrow.energy.term import HealthyTerm, MembraneTerm
from jaxgrow.energy.vectors import cross, dot, minus
from jaxgrow.numerics.guards import safe_root
from jaxgrow.runtime.types import Columns
from jaxgrow.state import Membrane


FLAT = 0.1
"""Ratio of height to longest edge at rest below which a triangle fades."""

LINE = 1e-6
"""That ratio up to which a triangle is a line, and has no stiffness."""

CRUSHED = 0.01
"""Determinant of C below which its logarithm is continued."""

SMALL = 1e-3
"""Exponent m below which its quotients are summed as a series."""


class Strain(NamedTuple):
    """Strain of one triangle.

    Attributes:
        excess: the four entries of C - 1, by rows.
        determinant: of C.
    """

    excess: tuple[Array, Array, Array, Array]
    determinant: Array


def rest_metric(x: tuple[Columns, ...]) -> Columns:
    """Return the entries 11, 12, 22 of the inverse metric, and the area.

    The area, in r0², is that with which the triangle counts: see the module.
    """
    one, other = minus(x[1], x[0]), minus(x[2], x[0])
    third = minus(x[2], x[1])
    a, b, c = dot(one, one), dot(one, other), dot(other, other)
    normal = cross(one, other)
    square = dot(normal, normal)
    longest = jnp.maximum(jnp.maximum(a, c), dot(third, third))
    double = safe_root(square)
    height = double / jnp.where(longest > 0, longest, 1)
    real = height > LINE
    inverse = 1 / jnp.where(real, square, 1)
    area = 0.5 * double * jnp.minimum(height / FLAT, 1) ** 3
    return (
        jnp.where(real, c * inverse, 1),
        jnp.where(real, -b * inverse, 0),
        jnp.where(real, a * inverse, 1),
        jnp.where(real, area, 0),
    )


def strain_of(x: tuple[Columns, ...], rest: Columns) -> Strain:
    """Return the strain of one triangle against its rest metric."""
    one, other = minus(x[1], x[0]), minus(x[2], x[0])
    a, b, c = dot(one, one), dot(one, other), dot(other, other)
    normal = cross(one, other)
    p, q, r = rest[:3]
    excess = (p * a + q * b - 1, p * b + q * c, q * a + r * b, q * b + r * c - 1)
    return Strain(excess, dot(normal, normal) * (p * r - q * q))


def neo_hookean(strain: Strain, modulus: Any, poisson: Any) -> Array:
    """Return the neo-Hookean energy per area, in F(0)/r0 for such a modulus."""
    exponent = poisson / (1 - poisson)
    logarithm = _logarithm(strain.determinant)
    few = exponent < SMALL
    x = exponent * logarithm
    series = 1 - x / 2 * (1 - x / 3 * (1 - x / 4 * (1 - x / 5)))
    quotient = jnp.expm1(-x) / jnp.where(few, 1, exponent)
    widening = jnp.where(few, -logarithm * series, quotient)
    trace = strain.excess[0] + strain.excess[3]
    return 0.25 * modulus / (1 + poisson) * (trace + widening)


def _logarithm(determinant: Array) -> Float[Array, "*p"]:
    """Return log det C, continued to 0 and below to second order."""
    regular = determinant > CRUSHED
    less = determinant / CRUSHED - 1
    continued = math.log(CRUSHED) + less - 0.5 * less * less
    return jnp.where(regular, jnp.log(jnp.where(regular, determinant, 1)), continued)


def kirchhoff(strain: Strain, modulus: Any, poisson: Any) -> Array:
    """Return Saint Venant's and Kirchhoff's energy per area, as `neo_hookean`."""
    a, b, c, d = strain.excess
    trace, square = 0.5 * (a + d), 0.25 * (a * a + 2 * b * c + d * d)
    both = (1 - poisson) * square + poisson * trace * trace
    return 0.5 * modulus / (1 - poisson * poisson) * both


class _Triangles(MembraneTerm):
    """Term of triangles that remember their metric."""

    size = 3
    per = "face"

    def rest(self, x: tuple[Columns, ...]) -> Columns:
        """Return inverse metric and area, see `rest_metric`."""
        return rest_metric(x)

    def stencil(
        self, membrane: Membrane
    ) -> tuple[Int[Array, "f 3"], Bool[Array, " f"]]:
        """Return the vertices of each triangle."""
        return membrane.faces, membrane.face_alive


class NeoHookean(_Triangles, HealthyTerm):
    """Neo-Hookean sheet of healthy endometrium, never reset."""

    name = "neo_hookean"
    parameters = ("membrane_modulus", "membrane_poisson")
    modulus = "membrane_modulus"

    def energy(self, x: tuple[Columns, ...], rest: Columns, p: Any) -> Array:
        """Return h A W of one triangle, in F(0) r0."""
        given = p.membrane_modulus, p.membrane_poisson
        return rest[4] * rest[3] * neo_hookean(strain_of(x, rest), *given)


class Kirchhoff(_Triangles, HealthyTerm):
    """Saint Venant–Kirchhoff sheet of healthy endometrium, never reset."""

    name = "kirchhoff"
    parameters = ("kirchhoff_modulus", "membrane_poisson")
    modulus = "kirchhoff_modulus"

    def energy(self, x: tuple[Columns, ...], rest: Columns, p: Any) -> Array:
        """Return h A W of one triangle, in F(0) r0."""
        given = p.kirchhoff_modulus, p.membrane_poisson
        return rest[4] * rest[3] * kirchhoff(strain_of(x, rest), *given)


class FlowingSheet(_Triangles):
    """Neo-Hookean sheet of all endometrium, reset after every division."""

    name = "flowing"
    parameters = ("flowing_modulus", "membrane_poisson")
    modulus = "flowing_modulus"

    def energy(self, x: tuple[Columns, ...], rest: Columns, p: Any) -> Array:
        """Return A W of one triangle, in F(0) r0."""
        given = p.flowing_modulus, p.membrane_poisson
        return rest[3] * neo_hookean(strain_of(x, rest), *given)

r"""Energy of the interaction between particles (paper §3 and eq. 2).

.. math::
    E = \sum_{i<j} s_{ij}\, U_{\alpha}(|x_i - x_j|)

over all pairs of particles alive, with :math:`U` of `A2` and the stiffness :math:`s` of
`Parameters` between two tumour particles (1 for all other pairs). Lengths in r0. With
s > 1 the tumour coheres more than it adheres to the tissue, so the interface has a
tension (differential adhesion) and a myoma stays a ball; with the mean
:math:`(1 + s)/2` for mixed pairs there is none, and it scatters through the tissue.

The derivative in the positions is written by hand: differentiating the sum over a
neighbour list turns its gathers into scatters, which is 14 to 20 times slower on a CPU.
A test holds it equal to the derivative of the plain sum.
"""

from typing import TypeAlias

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float, Int

from jaxgrow.energy.a2 import A2
from jaxgrow.numerics import safe_divide
from jaxgrow.parameters import Parameters
from jaxgrow.state import Particles, Species


Columns: TypeAlias = tuple[Float[Array, " n"], ...]
"""x, y and z of every particle: (n, 3) intermediates are slow."""


def _pairs(
    particles: Particles, other: Int[Array, " n"], parameters: Parameters
) -> tuple[Columns, Float[Array, " n"], Float[Array, " n"]]:
    """x_i - x_j, its length and the stiffness of the pair, for one j of each i."""
    count = particles.position.shape[0]
    real = (other < count) & particles.alive
    other = jnp.minimum(other, count - 1)
    components = tuple(column - column[other] for column in particles.position.T)
    square = sum(c**2 for c in components)
    apart = square != 0
    length = jnp.where(apart, jnp.sqrt(jnp.where(apart, square, 1)), 0)
    tumour = particles.species == Species.TUMOUR
    both = tumour & tumour[other]
    stiffness = jnp.where(both, parameters.tumour_stiffness, 1.0)
    return components, length, jnp.where(real & particles.alive[other], stiffness, 0)


def _pair_sum(
    particles: Particles, listed: Int[Array, "k n"], parameters: Parameters
) -> Float[Array, ""]:
    """The energy as a plain sum; every pair is listed from both sides."""
    law = A2(parameters.adhesion, parameters.smoothing)

    def add(total: Array, other: Int[Array, " n"]) -> tuple[Array, None]:
        _, length, stiffness = _pairs(particles, other, parameters)
        return total + jnp.sum(stiffness * law.energy(length)), None

    total, _ = jax.lax.scan(add, jnp.zeros((), particles.position.dtype), listed)
    return 0.5 * total


def pair_force(
    particles: Particles, listed: Int[Array, "k n"], parameters: Parameters
) -> Float[Array, "n 3"]:
    """Force on every particle, in F(0); 0 between particles at the same point.

    Neighbour after neighbour, so that nothing of the size of the list is stored: twice
    as fast as all at once on a CPU, and several times where the list is large.

    Args:
        particles: positions in r0.
        listed: neighbours of each particle, every pair from both sides; entries that
            hold n, and pairs beyond 3/2 r0, contribute nothing.
        parameters: adhesion, smoothing and tumour stiffness are used.
    """
    law = A2(parameters.adhesion, parameters.smoothing)

    def add(total: Columns, other: Int[Array, " n"]) -> tuple[Columns, None]:
        components, length, stiffness = _pairs(particles, other, parameters)
        ratio = safe_divide(stiffness * law.force(length), length, length > 0)
        added = (t + ratio * c for t, c in zip(total, components, strict=True))
        return tuple(added), None

    start = tuple(jnp.zeros_like(column) for column in particles.position.T)
    total, _ = jax.lax.scan(add, start, listed)
    return jnp.stack(total, axis=1)


@jax.custom_jvp
def pair_energy(
    particles: Particles, listed: Int[Array, "k n"], parameters: Parameters
) -> Float[Array, ""]:
    """Energy in F(0) r0. Arguments as for `pair_force`."""
    return _pair_sum(particles, listed, parameters)


@pair_energy.defjvp
def _pair_energy_jvp(
    primals: tuple[Particles, Array, Parameters],
    tangents: tuple[Particles, Array, Parameters],
) -> tuple[Float[Array, ""], Float[Array, ""]]:
    particles, listed, parameters = primals
    moved, _, varied = tangents
    value, from_parameters = jax.jvp(
        lambda p: _pair_sum(particles, listed, p), (parameters,), (varied,)
    )
    force = pair_force(particles, listed, parameters)
    return value, from_parameters - jnp.sum(force * moved.position)

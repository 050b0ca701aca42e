r"""Energy of the interaction between particles (paper §3 and eq. 2).

.. math::
    E = \sum_{i<j} s_{ij}\, U_{\alpha_{ij}}(|x_i - x_j|)

over all pairs of particles alive, with :math:`U` of `A2`. The stiffness :math:`s` of
`Parameters` acts between two tumour particles; all other pairs have 1. With
s > 1 the tumour coheres more than it adheres to the tissue, so the interface has a
tension (differential adhesion) and a myoma stays a ball; with the mean
:math:`(1 + s)/2` for mixed pairs there is none, and it scatters through the tissue.
The attraction of a tumour particle and one of the tissue is
:math:`\alpha_{ij} = c\,\alpha` with the mixed adhesion c; 1 is the paper's law.
Lengths in r0.

Every pair is listed from both sides, so that the force on a particle is a sum over its
own entries: nothing is scattered.
"""

from typing import Any, ClassVar

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float, Int

from jaxgrow.energy.a2 import A2, CUTOFF
from jaxgrow.energy.parameters import Parameters
from jaxgrow.energy.term import values_of
from jaxgrow.numerics.guards import safe_divide, safe_root
from jaxgrow.runtime.types import Columns
from jaxgrow.state import Particles, Species


class Pairs(eqx.Module):
    """Pair potential of two particles.

    Class attributes:
        name: of the term.
        parameters: the fields of `Parameters` that it uses.
        cutoff: distance, in r0, from which on particles do not interact.
    """

    name: ClassVar[str] = "pair"
    parameters: ClassVar[tuple[str, ...]] = (
        *("adhesion", "smoothing", "tumour_stiffness", "mixed_adhesion"),
    )
    cutoff: ClassVar[float] = CUTOFF

    def energy(self, u: Array, one: Array, other: Array, p: Any) -> Array:
        """Return s U(u) of one pair, in F(0) r0.

        Args:
            u: distance, in r0.
            one: 1 if the one is of the tumour, else 0.
            other: the same of the other.
            p: has the `parameters` by name.
        """
        both = one * other
        differ = one + other - 2 * both
        law = A2(p.adhesion * (1 + differ * (p.mixed_adhesion - 1)), p.smoothing)
        return (1 + both * (p.tumour_stiffness - 1)) * law.energy(u)


PAIRS = Pairs()


def _columns(
    particles: Particles, listed: Int[Array, "k n"]
) -> tuple[Columns, Float[Array, "k n"], Float[Array, "k n"], Float[Array, "k n"]]:
    """Return x_i - x_j of every entry, its length, and both species.

    Empty entries are beyond the cutoff.
    """
    position, count = particles.position, particles.position.shape[0]
    real = (listed < count) & particles.alive[None, :]
    other = jnp.where(real, listed, 0)
    real &= particles.alive[other]
    columns = tuple(
        jnp.where(real, column[None, :] - column[other], PAIRS.cutoff)
        for column in position.T
    )
    x, y, z = columns
    tumour = (particles.species == Species.TUMOUR).astype(position.dtype)
    own = jnp.broadcast_to(tumour[None, :], listed.shape)
    return columns, safe_root(x**2 + y**2 + z**2), own, tumour[other]


def _slope(
    length: Array, one: Array, other: Array, parameters: Parameters
) -> Float[Array, "..."]:
    """Return the derivative of each pair's energy in its distance."""
    p = values_of(PAIRS, parameters)
    total = jax.grad(lambda u: jnp.sum(PAIRS.energy(u, one, other, p)))
    return total(length)


def pair_force(
    particles: Particles, listed: Int[Array, "k n"], parameters: Parameters
) -> Float[Array, "n 3"]:
    """Return the force on every particle, in F(0); 0 between coincident ones.

    Args:
        particles: positions in r0.
        listed: neighbours of each particle, every pair from both sides; entries that
            hold n, and pairs beyond 3/2 r0, contribute nothing.
        parameters: of all terms.
    """
    columns, length, one, other = _columns(particles, listed)
    slope = _slope(length, one, other, parameters)
    ratio = safe_divide(-slope, length, length > 0)
    return jnp.stack([jnp.sum(ratio * column, axis=0) for column in columns], axis=1)


def force_on(
    index: Int[Array, ""],
    particles: Particles,
    listed: Int[Array, "k n"],
    parameters: Parameters,
) -> Float[Array, "3"]:
    """Return the force on one particle alone, in F(0); see `pair_force`."""
    entries = listed[:, index]
    count = particles.position.shape[0]
    real = (entries < count) & particles.alive[index]
    others = jnp.where(real, entries, 0)
    real &= particles.alive[others]
    apart = particles.position[index][None, :] - particles.position[others]
    apart = jnp.where(real[:, None], apart, PAIRS.cutoff)
    length = safe_root(jnp.sum(apart**2, axis=1))
    tumour = (particles.species == Species.TUMOUR).astype(length.dtype)
    one = jnp.broadcast_to(tumour[index], length.shape)
    ratio = -_slope(length, one, tumour[others], parameters)
    ratio = safe_divide(ratio, length, length > 0)
    return jnp.sum(ratio[:, None] * apart, axis=0)


@jax.custom_jvp
def pair_energy(
    particles: Particles, listed: Int[Array, "k n"], parameters: Parameters
) -> Float[Array, ""]:
    """Return the pair energy, in F(0) r0; arguments as for `pair_force`."""
    _, length, one, other = _columns(particles, listed)
    each = PAIRS.energy(length, one, other, values_of(PAIRS, parameters))
    return 0.5 * jnp.sum(each)


@pair_energy.defjvp
def _pair_energy_jvp(
    primals: tuple[Particles, Array, Parameters],
    tangents: tuple[Particles, Array, Parameters],
) -> tuple[Float[Array, ""], Float[Array, ""]]:
    """Apply the JVP rule: minus the force in positions, which gathers."""
    particles, listed, parameters = primals
    moved, _, varied = tangents
    _, length, one, other = _columns(particles, listed)

    def total(law: Parameters) -> Float[Array, ""]:
        return 0.5 * jnp.sum(PAIRS.energy(length, one, other, values_of(PAIRS, law)))

    value, from_parameters = jax.jvp(total, (parameters,), (varied,))
    force = pair_force(particles, listed, parameters)
    return value, from_parameters - jnp.sum(force * moved.position)

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

from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
from jax.typing import DTypeLike
from jaxtyping import Array, Bool, Float, Int

from jaxgrow.energy.a2 import A2, CUTOFF
from jaxgrow.kernels.ffi import registered, target
from jaxgrow.numerics import safe_divide, safe_root
from jaxgrow.parameters import Parameters
from jaxgrow.state import Particles, Species
from jaxgrow.types import Columns


_BLOCK = 4
"""Neighbours of each particle that are taken at once: more at once leave the cache,
fewer are more small loops."""

_AWAY = 1e9
"""Distance, in r0, at which dead particles and empty entries are put: nothing has to
be looked up to know that they do not interact."""


class Crowd(NamedTuple):
    """Particles as the sums need them; the last row stands for empty entries."""

    columns: Columns
    tumour: Bool[Array, " n+1"]


def crowd_of(particles: Particles) -> Crowd:
    """The particles, dead ones far away."""
    count = particles.position.shape[0]
    away = _AWAY * (1 + jnp.arange(count + 1, dtype=particles.position.dtype) / count)
    columns = tuple(
        jnp.concatenate([jnp.where(particles.alive, column, away[:-1]), away[-1:]])
        for column in particles.position.T
    )
    tumour = jnp.pad(particles.species == Species.TUMOUR, (0, 1))
    return Crowd(columns, tumour)


def _blocks(listed: Int[Array, "k n"]) -> Int[Array, "c b n"]:
    count, particles = listed.shape
    rows = -(-count // _BLOCK) * _BLOCK
    whole = jnp.pad(listed, ((0, rows - count), (0, 0)), constant_values=particles)
    return whole.reshape(-1, _BLOCK, particles)


def _pairs(
    crowd: Crowd, other: Int[Array, "b n"], parameters: Parameters
) -> tuple[Columns, Float[Array, "b n"], Float[Array, "b n"]]:
    """x_i - x_j, its length and the stiffness of the pair, for some j of each i."""

    def look_up(column: Array) -> Array:
        return column.at[other].get(mode="promise_in_bounds")

    components = tuple(c[None, :-1] - look_up(c) for c in crowd.columns)
    x, y, z = components
    length = safe_root(x**2 + y**2 + z**2)
    both = crowd.tumour[None, :-1] & look_up(crowd.tumour)
    return components, length, jnp.where(both, parameters.tumour_stiffness, 1.0)


def force_on(
    index: Int[Array, ""],
    crowd: Crowd,
    listed: Int[Array, "k n"],
    parameters: Parameters,
) -> Float[Array, "3"]:
    """Force on one particle alone, in F(0); see `pair_force`."""
    law = A2(parameters.adhesion, parameters.smoothing)
    other = listed[:, index]
    apart = jnp.stack([column[index] - column[other] for column in crowd.columns])
    length = safe_root(jnp.sum(apart**2, axis=0))
    both = crowd.tumour[index] & crowd.tumour[other]
    force = jnp.where(both, parameters.tumour_stiffness, 1.0) * law.force(length)
    return jnp.sum(safe_divide(force, length, length > 0)[None, :] * apart, axis=1)


def _pair_sum(
    particles: Particles, listed: Int[Array, "k n"], parameters: Parameters
) -> Float[Array, ""]:
    """The energy as a plain sum; every pair is listed from both sides."""
    law = A2(parameters.adhesion, parameters.smoothing)
    crowd = crowd_of(particles)

    def add(total: Array, other: Int[Array, "b n"]) -> tuple[Array, None]:
        _, length, stiffness = _pairs(crowd, other, parameters)
        return total + jnp.sum(stiffness * law.energy(length)), None

    start = jnp.zeros((), particles.position.dtype)
    total, _ = jax.lax.scan(add, start, _blocks(listed))
    return 0.5 * total


@jax.custom_jvp
def pair_force(
    particles: Particles, listed: Int[Array, "k n"], parameters: Parameters
) -> Float[Array, "n 3"]:
    """Force on every particle, in F(0); 0 between particles at the same point.

    On a processor by a loop, where there is one (see `jaxgrow.kernels`).

    Args:
        particles: positions in r0.
        listed: neighbours of each particle, every pair from both sides; entries that
            hold n, and pairs beyond 3/2 r0, contribute nothing.
        parameters: adhesion, smoothing and tumour stiffness are used.
    """
    exact = particles.position.dtype == jnp.float64 and listed.dtype == jnp.int32
    if not (exact and registered("pair")):
        return _force_by_blocks(particles, listed, parameters)
    given = particles, listed, parameters
    return jax.lax.platform_dependent(
        *given, cpu=_force_by_loop, default=_force_by_blocks
    )


@pair_force.defjvp
def _pair_force_jvp(
    primals: tuple[Particles, Array, Parameters],
    tangents: tuple[Particles, Array, Parameters],
) -> tuple[Float[Array, "n 3"], Float[Array, "n 3"]]:
    particles, listed, parameters = primals
    moved, _, varied = tangents

    def force(position: Float[Array, "n 3"], law: Parameters) -> Float[Array, "n 3"]:
        there = eqx.tree_at(lambda p: p.position, particles, position)
        return _force_by_blocks(there, listed, law)

    given = particles.position, parameters
    return jax.jvp(force, given, (moved.position, varied))


def numbers_of_pair(parameters: Parameters, dtype: DTypeLike) -> Float[Array, "4"]:
    """The law as its loop takes it, see `jaxgrow.kernels.pair`."""
    law = parameters.adhesion, parameters.smoothing, parameters.tumour_stiffness, CUTOFF
    return jnp.stack([jnp.asarray(number, dtype) for number in law])


def _force_by_loop(
    particles: Particles, listed: Int[Array, "k n"], parameters: Parameters
) -> Float[Array, "n 3"]:
    position = particles.position
    count = position.shape[0]
    away = _AWAY * (1 + jnp.arange(count, dtype=position.dtype) / count)
    position = jnp.where(particles.alive[:, None], position, away[:, None])
    call = jax.ffi.ffi_call(
        target("pair"),
        jax.ShapeDtypeStruct(position.shape, position.dtype),
        vmap_method="sequential",
    )
    return call(
        position,
        particles.species == Species.TUMOUR,
        listed,
        numbers_of_pair(parameters, position.dtype),
    )


def _force_by_blocks(
    particles: Particles, listed: Int[Array, "k n"], parameters: Parameters
) -> Float[Array, "n 3"]:
    """A few neighbours of all particles after the other.

    So that nothing of the size of the list is stored: several times as fast as all at
    once on a processor.
    """
    law = A2(parameters.adhesion, parameters.smoothing)
    crowd = crowd_of(particles)

    def add(total: Columns, other: Int[Array, "b n"]) -> tuple[Columns, None]:
        components, length, stiffness = _pairs(crowd, other, parameters)
        ratio = safe_divide(stiffness * law.force(length), length, length > 0)
        added = zip(total, components, strict=True)
        return tuple(t + jnp.sum(ratio * c, axis=0) for t, c in added), None

    start = tuple(jnp.zeros_like(column) for column in particles.position.T)
    total, _ = jax.lax.scan(add, start, _blocks(listed))
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

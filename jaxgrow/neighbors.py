"""Neighbour lists of particles.

Two lists: a wide one by jax-md's cells, and what of it is near, which forces are
computed from. The near one is short (empty and distant entries cost as much as others)
and so holds for short moves only, but finding it in the wide one costs no more than a
force evaluation; the wide one, ten times as dear, holds for long moves.

`allocate` runs on the host and decides capacities; `update` runs in compiled code. An
update that does not fit sets a flag that stays set, and forces computed from such a
list are wrong: `relax` rolls back and allocates anew.
"""

import functools
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int

from jaxgrow import cells
from jaxgrow.energy.a2 import CUTOFF
from jaxgrow.numerics import farthest_two


SKIN = 0.2
"""Extra radius of the near list, in r0: it holds until the farthest moves of two
particles exceed it together."""

WIDE_SKIN = 0.9
_WIDE_SKIN_OF_MANY = 0.5
"""Extra radius of the wide list of few and of many particles: jax-md stores all pairs
of adjacent cells when it makes one, which of many particles should not be too many."""

_FEW = 4096

_LEAST_OCCUPANCY = 32
_OCCUPANCY_STEP = 8
"""Room for neighbours comes in multiples of it, since every size is a compilation."""


class Neighbors(eqx.Module):
    """Who is near whom.

    Attributes:
        listed: indices of the neighbours, neighbour-major; an empty entry holds n.
        reference: positions when they were listed, in r0.
        full: whether a particle ever had more neighbours than the list has room for.
        wide: a `jax_md.partition.NeighborList`: its type would import jax-md.
    """

    listed: Int[Array, "k n"]
    reference: Float[Array, "n 3"]
    full: Bool[Array, ""]
    wide: Any

    @property
    def overflow(self) -> Bool[Array, ""]:
        """Whether an update did not fit, so that the list must not be used."""
        return self.full | (self.wide.error.code != 0)


def _skin(count: int) -> float:
    return WIDE_SKIN if count <= _FEW else _WIDE_SKIN_OF_MANY


def allocate(
    position: Float[Array, "n 3"], before: Neighbors | None = None
) -> Neighbors:
    """A list for these positions, with room for no fewer neighbours than before.

    Args:
        position: in r0; every slot, padding included (parked apart).
        before: a list that is to be replaced.
    """
    count = position.shape[0]
    of = cells.Hash.of(count, CUTOFF + _skin(count))
    wide = cells.make(position, of, None if before is None else before.wide)
    most, least = cells.most_neighbors(position, CUTOFF + SKIN), _LEAST_OCCUPANCY
    if before is not None:
        # of positions that were given up since, for lack of room, nothing else is known
        least = before.listed.shape[0] + _OCCUPANCY_STEP * bool(before.full)
    room = max(_OCCUPANCY_STEP * -(-most // _OCCUPANCY_STEP), least)
    return _filled(position, wide, room)


@functools.partial(jax.jit, static_argnums=2)
def _filled(position: Float[Array, "n 3"], wide: Any, room: int) -> Neighbors:
    wide = cells.relist(wide, position)
    listed, most = _near(position, wide.idx, room)
    return Neighbors(listed, position, most > room, wide)


def outgrown(neighbors: Neighbors, position: Float[Array, "n 3"]) -> Bool[Array, ""]:
    """Whether the near list may lack a pair at these positions."""
    return farthest_two(position - neighbors.reference) > SKIN


def rebuilt(
    neighbors: Neighbors, position: Float[Array, "n 3"], anew: Bool[Array, ""]
) -> Neighbors:
    """The list for these positions if it is to be made anew, else as it is."""
    skin = _skin(position.shape[0])

    def make() -> Neighbors:
        wide = jax.lax.cond(
            farthest_two(cells.moved(neighbors.wide, position)) > skin - SKIN,
            lambda: cells.relist(neighbors.wide, position),
            lambda: neighbors.wide,
        )
        room = neighbors.listed.shape[0]
        listed, most = _near(position, wide.idx, room)
        return Neighbors(listed, position, neighbors.full | (most > room), wide)

    return jax.lax.cond(anew, make, lambda: neighbors)


def update(neighbors: Neighbors, position: Float[Array, "n 3"]) -> Neighbors:
    """The list for new positions; made anew only when someone moved too far."""
    return rebuilt(neighbors, position, outgrown(neighbors, position))


def _near(
    position: Float[Array, "n 3"], wide: Int[Array, "n w"], room: int
) -> tuple[Int[Array, "k n"], Int[Array, ""]]:
    """Those of the wide list within the near one's radius, and the most of a particle.

    Entry after entry of all particles: no array of pairs is stored.
    """
    count = position.shape[0]
    own = jnp.arange(count, dtype=wide.dtype)
    columns = position.T
    empty = jnp.full((room, count), count, wide.dtype)

    def add(
        state: tuple[Array, Array], other: Int[Array, " n"]
    ) -> tuple[tuple[Array, Array], None]:
        listed, found = state
        safe = jnp.minimum(other, count - 1)
        square = sum((column - column[safe]) ** 2 for column in columns)
        near = (other < count) & (square < (CUTOFF + SKIN) ** 2)
        row = jnp.where(near, found, room)
        listed = listed.at[row, own].set(other, mode="drop")
        return (listed, found + near.astype(found.dtype)), None

    start = empty, jnp.zeros(count, wide.dtype)
    (listed, found), _ = jax.lax.scan(add, start, wide.T)
    return listed, jnp.max(found)

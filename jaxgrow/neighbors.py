"""Neighbour lists of particles: the only module that imports jax-md, and lazily.

Two lists: a wide one by jax-md's cells, and what of it is near, which forces are
computed from. The near one is short (empty and distant entries cost as much as others)
and so holds for short moves only, but finding it in the wide one costs no more than a
force evaluation; the wide one, ten times as dear, holds for long moves.

Importing jax-md takes seconds and initialises the XLA backend, so it waits for the
first list. `allocate` runs on the host and decides capacities; `update` runs in
compiled code. An update that does not fit sets a flag that stays set, and forces
computed from such a list are wrong: `relax` rolls back and allocates anew.
"""

import contextlib
import dataclasses
import functools
import math
import warnings
from collections.abc import Iterator
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int

from jaxgrow.capacity import capacity_for
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

_HEADROOM = 1.25
_LEAST_OCCUPANCY = 32
_OCCUPANCY_STEP = 8
"""Room for neighbours comes in multiples of it, since every size is a compilation."""

_LEAST_WIDE = 48
_LEAST_IN_CELL = 16


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


@contextlib.contextmanager
def _permissive() -> Iterator[None]:
    """Let jax-md mix dtypes and ranks, which our tests forbid to our own code."""
    with (
        jax.numpy_dtype_promotion("standard"),
        jax.numpy_rank_promotion("allow"),
        warnings.catch_warnings(),
    ):
        # jax-md 0.2.29 writes int64 counts into int32 buffers under x64; both are
        # below 2**31. To be removed when jax-md casts them.
        warnings.filterwarnings("ignore", "scatter inputs have incompatible types")
        yield


_SHIFT = 512.0
"""Added to every coordinate, in r0: jax-md truncates a coordinate to its cell towards
zero, so the cells around 0 would be two cells wide and hold eight times as much."""

_cell_lists: dict[tuple[int, float], Any] = {}
"""The cell hash of each number of cells and skin, made once: a new one compiles
everything anew, and one of another skin has cells of another size."""


@functools.cache
def _functions(cells: int, skin: float) -> Any:
    """jax-md's allocate and update for a periodic hash of cells³ cells.

    Space is free and distances are exact; only the hash of the cells is periodic,
    which adds candidates and loses none. A new pair would make every compiled
    function that takes a list compile again, so there is one per size class.
    """
    with _permissive():
        from jax_md import partition, space

        displacement, _ = space.free()
        return partition.neighbor_list(
            displacement,
            box=jnp.asarray((CUTOFF + skin) * cells * 1.0001),
            r_cutoff=CUTOFF,
            dr_threshold=skin,
            capacity_multiplier=_HEADROOM,
            format=partition.NeighborListFormat.Dense,
        )


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
    cells = 12 if count <= _FEW else 2 * math.ceil((count / 1.2) ** (1 / 3) / 3)
    kind = cells, _skin(count)
    with _permissive():
        wide = _functions(*kind).allocate(position + _SHIFT)
    wanted, cell = wide.max_occupancy, wide.cell_list_capacity
    least_wide, least_in_cell, least = _LEAST_WIDE, _LEAST_IN_CELL, _LEAST_OCCUPANCY
    if before is not None:
        # of positions that were given up since, for lack of room, nothing else is known
        failed, full = bool(before.wide.error.code != 0), bool(before.full)
        least_wide = before.wide.max_occupancy
        least_in_cell = before.wide.cell_list_capacity
        wanted = max(wanted, least_wide + failed)
        cell = max(cell, least_in_cell + failed)
        least = before.listed.shape[0] + _OCCUPANCY_STEP * full
    room = capacity_for(wanted, least_wide)
    extra = room - wide.max_occupancy
    wide = dataclasses.replace(
        wide,
        idx=jnp.pad(wide.idx, ((0, 0), (0, extra)), constant_values=count),
        max_occupancy=room,
        cell_list_capacity=capacity_for(cell, least_in_cell),
        cell_list_fn=_cell_lists.setdefault(kind, wide.cell_list_fn),
    )
    most = int(_compiled_near(position, wide.idx, least)[1])
    most = max(_OCCUPANCY_STEP * -(-most // _OCCUPANCY_STEP), least)
    listed, most_found = _compiled_near(position, wide.idx, most)
    return Neighbors(listed, position, most_found > most, wide)


def outgrown(neighbors: Neighbors, position: Float[Array, "n 3"]) -> Bool[Array, ""]:
    """Whether the near list may lack a pair at these positions."""
    return farthest_two(position - neighbors.reference) > SKIN


def rebuilt(
    neighbors: Neighbors, position: Float[Array, "n 3"], anew: Bool[Array, ""]
) -> Neighbors:
    """The list for these positions if it is to be made anew, else as it is."""
    skin = _skin(position.shape[0])

    def from_cells() -> Any:
        far = neighbors.wide.reference_position + 1e6  # so that it is made anew surely
        unknown = dataclasses.replace(neighbors.wide, reference_position=far)
        with _permissive():
            return unknown.update(position + _SHIFT)

    def make() -> Neighbors:
        moved = position + _SHIFT - neighbors.wide.reference_position
        wide = jax.lax.cond(
            farthest_two(moved) > skin - SKIN, from_cells, lambda: neighbors.wide
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


_compiled_near = jax.jit(_near, static_argnums=2)

"""Verlet lists of particles, in two radii.

Two lists: a wide one by jax-md's cells, and its near part, which forces are computed
from. The near one is short (empty and distant entries cost as much as others) and so is
valid for short moves only, but extracting it from the wide one costs no more than a
force evaluation; the wide one costs ten times as much and is valid for long moves.

If only a few particles moved far, as after a division, only those are relisted
(`jaxgrow.neighbors.update_particle`), at a twentieth of the cost for hundreds of
particles and at a hundredth for very many.

`allocate` runs on the host and decides capacities; `update` runs in compiled code. An
update that does not fit sets a flag that stays set, and forces computed from such a
list are wrong: `relax` rolls back and allocates larger ones.
"""

import dataclasses
import functools
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int

from jaxgrow.energy.a2 import CUTOFF
from jaxgrow.kernels.ffi import call, registered
from jaxgrow.kernels.layout import NEAR_ARGUMENTS, NEAR_RESULTS
from jaxgrow.neighbors import cell_list as cells
from jaxgrow.neighbors.update_particle import Links, relink
from jaxgrow.numerics.guards import farthest_two, safe_norm


SKIN = 0.2
"""Extra radius of the near list, in r0: it holds until the farthest moves of two
particles exceed it together."""

WIDE_SKIN = 0.9
_WIDE_SKIN_OF_MANY = 0.7
"""Extra radius of the wide list for few and for many particles: a larger one stays
valid for longer moves, but takes longer to build, which matters for many particles."""

_SKIN_OF_PART = 0.35
"""Extra radius of the wide list of a subset, which is built for one relaxation."""

FEW = 4096

_STRAYS, _STRAYS_OF_FEW = 32, 8
"""Largest numbers of particles, for many and for few in all, that are relisted one by
one; if more moved far, the whole list is rebuilt."""

_LEAST_OCCUPANCY = 32
_OCCUPANCY_STEP = 8
"""Step of the capacity for neighbours, since every size is a compilation."""


class Neighbors(eqx.Module):
    """Verlet list of particles: the near and the wide list.

    Attributes:
        listed: indices of the neighbours, neighbour-major; an empty entry holds n.
        reference: positions when they were listed, in r0.
        full: whether a particle ever had more neighbours than the capacity.
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

    @property
    def wide_skin(self) -> float:
        """Extra radius of the wide list, in r0."""
        return self.wide.cell_size - CUTOFF


def _skin(count: int) -> float:
    return WIDE_SKIN if count <= FEW else _WIDE_SKIN_OF_MANY


def allocate(
    position: Float[Array, "n 3"], before: Neighbors | None = None
) -> Neighbors:
    """Allocate a list for these positions, no smaller than the one before.

    Args:
        position: in r0; every slot, padding included (parked apart).
        before: a list that is to be replaced.
    """
    count = position.shape[0]
    if before is not None and before.reference.shape == position.shape:
        made = before
        if bool(_only_near_is_full(before, position)):
            while bool(made.full):
                room = made.listed.shape[0] + _OCCUPANCY_STEP
                made = _filled(position, before.wide, room, relist=False)
            return made
    of = cells.Hash.of(count, CUTOFF + _skin(count))
    wide = cells.make(position, of, None if before is None else before.wide)
    most, least = cells.most_neighbors(position, CUTOFF + SKIN), _LEAST_OCCUPANCY
    if before is not None:
        # the positions at which it overflowed are lost: grow it by one step
        least = before.listed.shape[0] + _OCCUPANCY_STEP * bool(before.full)
    room = max(_OCCUPANCY_STEP * -(-most // _OCCUPANCY_STEP), least)
    return _filled(position, wide, room, relist=True)


@jax.jit
def _only_near_is_full(
    neighbors: Neighbors, position: Float[Array, "n 3"]
) -> Bool[Array, ""]:
    """Return whether the near list overflowed and the wide one is valid."""
    return (
        neighbors.full
        & (neighbors.wide.error.code == 0)
        & _wide_holds(neighbors, position)
    )


def _filled(
    position: Float[Array, "n 3"], wide: Any, room: int, *, relist: bool
) -> Neighbors:
    """Fill both lists for these positions."""
    made = cells.filled_on_host(wide, position, CUTOFF + SKIN, room, anew=relist)
    if made is None:
        return _filled_by_program(position, wide, room, relist=relist)
    wide, listed, most = made
    return Neighbors(listed, position, jax.device_put(most > room), wide)


@functools.partial(jax.jit, static_argnums=2, static_argnames="relist")
def _filled_by_program(
    position: Float[Array, "n 3"], wide: Any, room: int, *, relist: bool
) -> Neighbors:
    if relist:
        wide = cells.relist(wide, position)
    listed, most = find_near(position, wide.idx, room)
    return Neighbors(listed, position, most > room, wide)


def outgrown(neighbors: Neighbors, position: Float[Array, "n 3"]) -> Bool[Array, ""]:
    """Return whether the near list may lack a pair at these positions."""
    return ~(farthest_two(position - neighbors.reference) <= SKIN)  # NaN counts


def rebuilt(
    neighbors: Neighbors, position: Float[Array, "n 3"], anew: Bool[Array, ""]
) -> Neighbors:
    """Rebuild the list for these positions if `anew` holds."""

    def make(wide_holds: Bool[Array, ""]) -> Neighbors:
        wide = jax.lax.cond(
            wide_holds,
            lambda: neighbors.wide,
            lambda: cells.relist(neighbors.wide, position),
        )
        room = neighbors.listed.shape[0]
        listed, most = find_near(position, wide.idx, room)
        return Neighbors(listed, position, neighbors.full | (most > room), wide)

    def patch_or_make() -> Neighbors:
        _, strays = _far(neighbors, position)
        wide_holds = _wide_holds(neighbors, position)
        patch = strays <= most_strays(position.shape[0])
        if position.shape[0] <= FEW:  # then a search of the wide list costs less
            patch &= ~wide_holds
        return jax.lax.cond(
            patch, lambda: _patched(neighbors, position), lambda: make(wide_holds)
        )

    return jax.lax.cond(anew, patch_or_make, lambda: neighbors)


def _wide_holds(neighbors: Neighbors, position: Float[Array, "n 3"]) -> Bool[Array, ""]:
    """Return whether the wide list covers all near pairs here."""
    moved = farthest_two(cells.moved(neighbors.wide, position))
    return moved <= neighbors.wide_skin - SKIN


def most_strays(count: int) -> int:
    """Return the largest number of particles that are relisted one by one."""
    return min(_STRAYS if count > FEW else _STRAYS_OF_FEW, count)


def _far(
    neighbors: Neighbors, position: Float[Array, "n 3"]
) -> tuple[Float[Array, " n"], Int[Array, ""]]:
    """Return each particle's displacement, and how many moved far.

    Without those the near list stays valid for at least half of its skin.
    """
    moved = safe_norm(position - neighbors.reference)
    moved = jnp.where(jnp.isnan(moved), jnp.inf, moved)
    return moved, jnp.sum(moved > SKIN / 4)


def _patched(neighbors: Neighbors, position: Float[Array, "n 3"]) -> Neighbors:
    """Relist the particles that moved far, in both lists.

    Whether a pair is listed depends on the reference positions of both particles, which
    is what the skin bounds. So the other particles are taken at their reference
    positions.
    """
    moved, strays = _far(neighbors, position)
    count = position.shape[0]
    most = most_strays(count)
    _, farthest = jax.lax.top_k(moved, most)
    chosen = jnp.where(jnp.arange(most) < strays, farthest, count)
    reference = neighbors.reference.at[chosen].set(position[farthest], mode="drop")
    wide = cells.moved_to(neighbors.wide, chosen, position[farthest])

    def relist(number: Array, lists: tuple[Links, Links]) -> tuple[Links, Links]:
        one = farthest[number]

        def near(places: Float[Array, "n 3"], radius: float) -> Bool[Array, " n"]:
            square = sum((column - column[one]) ** 2 for column in places.T)
            return (square < radius**2) & (jnp.arange(count, dtype=one.dtype) != one)

        return (
            relink(lists[0], one, near(reference, CUTOFF + SKIN)),
            relink(lists[1], one, near(wide.reference_position, wide.cell_size)),
        )

    own = Links(neighbors.listed, neighbors.full)
    start = own, Links(wide.idx.T, neighbors.full)
    near, far = jax.lax.fori_loop(0, strays, relist, start)
    wide = dataclasses.replace(wide, idx=far.listed.T)
    return Neighbors(near.listed, reference, near.full | far.full, wide)


def of_part(
    position: Float[Array, "q 3"], still: Bool[Array, " q"], like: Neighbors
) -> Neighbors:
    """Build a list for a subset of the particles of another list.

    Args:
        position: of every slot, padding included.
        still: particles that never move and whose forces are not needed: they are
            neighbours of others, but have none.
        like: the other list; the capacity is the same.
    """
    count, room = position.shape[0], like.listed.shape[0]
    radius = CUTOFF + min(_SKIN_OF_PART, like.wide_skin)
    more = int(1.15 * room * (radius / (CUTOFF + SKIN)) ** 3) + 1
    made = _of_part(position, still, cells.blank(count, radius, more, like.wide), room)
    if bool(made.overflow):
        made = allocate(position)
    return made


@functools.partial(jax.jit, static_argnums=3)
def _of_part(
    position: Float[Array, "q 3"], still: Bool[Array, " q"], wide: Any, room: int
) -> Neighbors:
    wide = cells.relist(wide, position, still)
    listed, most = find_near(position, wide.idx, room)
    return Neighbors(listed, position, most > room, wide)


def update(neighbors: Neighbors, position: Float[Array, "n 3"]) -> Neighbors:
    """Return the list for new positions, rebuilt only after too long moves."""
    return rebuilt(neighbors, position, outgrown(neighbors, position))


def find_near(
    position: Float[Array, "n 3"], wide: Int[Array, "n w"], room: int
) -> tuple[Int[Array, "k n"], Int[Array, ""]]:
    """Extract the near list from the wide one, with the maximum per particle.

    On a CPU by a compiled loop, if available (see `jaxgrow.kernels`).
    """
    exact = position.dtype == jnp.float64 and wide.dtype == jnp.int32
    by_scan = functools.partial(_near_by_scan, room=room)
    if not (exact and registered("near")):
        return by_scan(position, wide)
    by_loop = functools.partial(_near_by_loop, room=room)
    return jax.lax.platform_dependent(position, wide, cpu=by_loop, default=by_scan)


def _near_by_loop(
    position: Float[Array, "n 3"], wide: Int[Array, "n w"], *, room: int
) -> tuple[Int[Array, "k n"], Int[Array, ""]]:
    square = jnp.full(1, (CUTOFF + SKIN) ** 2)
    listed, most = call(
        "near",
        NEAR_ARGUMENTS,
        NEAR_RESULTS,
        {"position": position, "wide": wide, "square": square},
        {"listed": (room, position.shape[0]), "most": (1,)},
        vmap_method="sequential",
    )
    return listed, most[0]


def _near_by_scan(
    position: Float[Array, "n 3"], wide: Int[Array, "n w"], *, room: int
) -> tuple[Int[Array, "k n"], Int[Array, ""]]:
    """Scan the entries of all particles, without storing pairs."""
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

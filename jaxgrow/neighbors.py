"""Neighbour lists of particles: the only module that imports jax-md, and lazily.

Importing jax-md takes seconds and initialises the XLA backend, so it waits for the
first list. `allocate` runs on the host and decides capacities; `NeighborList.update`
runs in compiled code and rebuilds the list when a particle has moved by half the skin.
An update that does not fit sets a flag that stays set, and forces computed from such a
list are wrong: `relax` rolls back and allocates anew.
"""

import contextlib
import dataclasses
import functools
import math
import warnings
from collections.abc import Iterator
from typing import Any

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int

from jaxgrow.capacity import capacity_for
from jaxgrow.energy.a2 import CUTOFF


SKIN = 0.4
"""Extra radius of a list, in r0: it holds until a particle has moved by half of it."""

_HEADROOM = 1.25
_LEAST_OCCUPANCY = 32
_LEAST_IN_CELL = 16

NeighborList = Any
"""A `jax_md.partition.NeighborList`: the type would import jax-md."""


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

_cell_lists: dict[int, Any] = {}
"""The cell hash of each size class, made once: a new one compiles everything anew."""


@functools.cache
def _functions(cells: int) -> Any:
    """The allocate and update pair for a periodic hash of cells³ cells.

    Space is free and distances are exact; only the hash of the cells is periodic,
    which adds candidates and loses none. A new pair would make every compiled
    function that takes a list compile again, so there is one per size class.
    """
    with _permissive():
        from jax_md import partition, space

        displacement, _ = space.free()
        return partition.neighbor_list(
            displacement,
            box=jnp.asarray((CUTOFF + SKIN) * cells * 1.0001),
            r_cutoff=CUTOFF,
            dr_threshold=SKIN,
            capacity_multiplier=_HEADROOM,
            format=partition.NeighborListFormat.Dense,
        )


def allocate(position: Float[Array, "n 3"], occupancy: int = 0) -> NeighborList:
    """A list for these positions, with room for `occupancy` neighbours at least.

    Args:
        position: in r0; every slot, padding included (parked apart).
        occupancy: smallest capacity per particle, so that a list that grows does not
            come back smaller.
    """
    count = position.shape[0]
    cells = 12 if count <= 4096 else 2 * math.ceil((count / 1.2) ** (1 / 3) / 3)
    with _permissive():
        neighbors = _functions(cells).allocate(position + _SHIFT)
    wanted = capacity_for(max(neighbors.max_occupancy, occupancy), _LEAST_OCCUPANCY)
    extra = wanted - neighbors.max_occupancy
    cell_capacity = capacity_for(neighbors.cell_list_capacity, _LEAST_IN_CELL)
    return dataclasses.replace(
        neighbors,
        idx=jnp.pad(neighbors.idx, ((0, 0), (0, extra)), constant_values=count),
        max_occupancy=wanted,
        cell_list_capacity=cell_capacity,
        cell_list_fn=_cell_lists.setdefault(cells, neighbors.cell_list_fn),
    )


def update(neighbors: NeighborList, position: Float[Array, "n 3"]) -> NeighborList:
    """The list for new positions; rebuilt only when someone moved half the skin."""
    with _permissive():
        return neighbors.update(position + _SHIFT)


def overflowed(neighbors: NeighborList) -> Bool[Array, ""]:
    """Whether an update did not fit, so that the list must not be used."""
    return neighbors.error.code != 0


def listed(neighbors: NeighborList) -> Int[Array, "k n"]:
    """Indices of the neighbours, neighbour-major; an empty entry holds n."""
    return neighbors.idx.T

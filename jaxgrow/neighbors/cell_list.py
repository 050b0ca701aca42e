"""Wide neighbour lists by cells; the only module that imports jax-md.

`make` runs on the host and decides capacities, `filled_on_host` fills a list there by
loops, and `relist` runs in compiled code. The list itself, and its search where there
is no loop, are jax-md's; for many points jax-md only assigns the cells, and the search
within them is done here, in portions.
"""

import contextlib
import dataclasses
import functools
import importlib.util
import math
import sys
import warnings
from collections.abc import Iterator
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax.typing import DTypeLike
from jaxtyping import Array, Bool, Float, Int, UInt
from scipy.spatial import KDTree

from jaxgrow.kernels import loops
from jaxgrow.kernels.ffi import registered, target
from jaxgrow.numerics.bitmask import first_true
from jaxgrow.numerics.capacity import capacity_for


_SHIFT = 512.0
"""Added to every coordinate, in r0: jax-md truncates a coordinate to its cell towards
zero, so the cells around 0 would be two cells wide and hold eight times as much."""

_HEADROOM = 1.25
"""Capacity for neighbours, relative to the present maximum."""

_HEADROOM_IN_CELL = 1.15
"""Capacity of a cell, relative to the present maximum; each slot is a candidate 27
times."""

_MOST_AT_ONCE = 8192
"""Number of points up to which jax-md searches for all neighbours at once."""

_PORTION = 512
"""Points per portion, above that number."""

_LEAST_WIDE = 48
_LEAST_IN_CELL = 16


class Hash(NamedTuple):
    """Periodic spatial hash.

    Space is unbounded and distances are exact; only the hash of the cells is periodic,
    which adds candidates and loses none.

    Attributes:
        cells: number of cells along each axis.
        radius: distance up to which pairs are listed, in r0; no cell is smaller.
    """

    cells: int
    radius: float

    @property
    def size(self) -> float:
        """Edge of a cell, in r0: a little more than the radius."""
        return 1.0001 * self.radius

    @classmethod
    def of(cls, count: int, radius: float) -> "Hash":
        """Return the hash for this many particles."""
        return cls(max(12, 2 * math.ceil((count / 1.2) ** (1 / 3) / 3)), radius)


@contextlib.contextmanager
def _permissive() -> Iterator[None]:
    """Let jax-md mix dtypes and ranks, which our tests forbid elsewhere."""
    with (
        jax.numpy_dtype_promotion("standard"),
        jax.numpy_rank_promotion("allow"),
        warnings.catch_warnings(),
    ):
        # jax-md 0.2.29 writes int64 counts into int32 buffers under x64; both are
        # below 2**31. To be removed when jax-md casts them.
        warnings.filterwarnings("ignore", "scatter inputs have incompatible types")
        yield


@functools.cache
def _partition() -> Any:
    """Import `jax_md.partition` without the rest of jax-md.

    The package imports all of its modules, which import neural networks and sympy and
    compile a hundred programs: five seconds per process. So the two modules that lists
    need are imported from an uninitialised package, which is then removed from
    `sys.modules`, so that a later ``import jax_md`` initialises it as usual and finds
    the same two modules.
    """
    if "jax_md" in sys.modules:
        from jax_md import partition

        return partition
    spec = importlib.util.find_spec("jax_md")
    if spec is None:
        raise ImportError("jaxgrow needs jax-md; install it with: pip install jax-md")
    sys.modules["jax_md"] = importlib.util.module_from_spec(spec)
    try:
        from jax_md import partition
    finally:
        del sys.modules["jax_md"]
    return partition


@functools.cache
def _functions(of: Hash) -> tuple[Any, Any]:
    """Return jax-md's update function and cell list for a hash.

    There is one pair per hash, as every compiled function that takes a list would be
    compiled again for another pair.
    """
    with _permissive():
        partition = _partition()
        space = sys.modules["jax_md.space"]
        displacement, _ = space.free()
        box = of.size * of.cells
        update = partition.neighbor_list(
            displacement,
            box=box,
            r_cutoff=of.radius,
            dr_threshold=0.0,
            format=partition.NeighborListFormat.Dense,
        ).update
        return update, partition.cell_list(box, of.radius, _HEADROOM_IN_CELL)


def make(position: Float[Array, "n 3"], of: Hash, before: Any = None) -> Any:
    """Allocate an empty list with room for these positions.

    `relist` fills it.

    Args:
        position: in r0, of all slots.
        of: the hash and the radius.
        before: a list that is to be replaced; no capacity becomes smaller, and one
            that overflowed becomes larger.

    Returns:
        A `jax_md.partition.NeighborList`.
    """
    points = _finite(position)
    cell = np.trunc((points + _SHIFT) / of.size) % of.cells
    _, in_cell = np.unique(cell, axis=0, return_counts=True)
    wanted = math.ceil(_HEADROOM * most_neighbors(position, of.radius))
    wanted_in_cell = math.ceil(_HEADROOM_IN_CELL * in_cell.max(initial=1))
    least, least_in_cell = _LEAST_WIDE, _LEAST_IN_CELL
    if before is not None:
        failed = bool(before.error.code != 0)
        least, least_in_cell = before.max_occupancy, before.cell_list_capacity
        wanted = max(wanted, least + failed)
        wanted_in_cell = max(wanted_in_cell, least_in_cell + failed)
    room = capacity_for(wanted, least)
    partition = _partition()
    update, cell_list = _functions(of)
    # unaliased arrays; jnp.asarray would compile a program for every shape
    return partition.NeighborList(
        idx=jax.device_put(np.full((len(points), room), len(points), np.int32)),
        reference_position=jax.device_put(points + _SHIFT),
        error=partition.PartitionError(jax.device_put(np.uint8(0))),
        cell_list_capacity=capacity_for(wanted_in_cell, least_in_cell),
        max_occupancy=room,
        format=partition.NeighborListFormat.Dense,
        cell_size=of.radius,
        cell_list_fn=cell_list,
        update_fn=update,
    )


_FARTHEST = 1e9
"""Coordinates beyond it, in r0, have no cell."""


def _finite(position: Float[Array, "n 3"]) -> Float[np.ndarray, "n 3"]:
    """Copy positions to the host; those without a cell become 0.

    jax-md's cells treat them the same.
    """
    points = np.asarray(position)
    return np.where(np.abs(points) < _FARTHEST, points, 0)


def most_neighbors(position: Float[Array, "n 3"], radius: float) -> int:
    """Count the neighbours within a radius; return the maximum."""
    points = _finite(position)
    if len(points) == 0:
        return 0
    tree = KDTree(points)
    return int(tree.query_ball_point(points, radius, return_length=True).max()) - 1


def relist(
    wide: Any, position: Float[Array, "n 3"], still: Bool[Array, " n"] | None = None
) -> Any:
    """Fill the list for these positions; set its error on overflow.

    On a CPU by a compiled loop, if available (see `jaxgrow.kernels`).

    Args:
        wide: a list for as many points.
        position: in r0.
        still: points that get no entries, though they are entries of others.
    """
    if still is None:
        still = jnp.zeros(position.shape[0], bool)
    by_cells = functools.partial(_by_cells, wide)
    if position.dtype == jnp.float64 and registered("cells"):
        by_loop = functools.partial(_by_loop, wide)
        entries, code = jax.lax.platform_dependent(
            position, still, cpu=by_loop, default=by_cells
        )
    else:
        entries, code = by_cells(position, still)
    return dataclasses.replace(
        wide,
        idx=entries,
        reference_position=position + _SHIFT,
        error=_partition().PartitionError(code),
    )


def filled_on_host(
    wide: Any, position: Float[Array, "n 3"], radius: float, room: int, *, anew: bool
) -> tuple[Any, Int[Array, "k n"], int] | None:
    """Fill the wide and the near list by loops, without any XLA program.

    Args:
        wide: a list for as many points.
        position: in r0, as values.
        radius: distance below which neighbours are near, in r0.
        room: capacity for near neighbours of a point.
        anew: whether the wide list is to be rebuilt for these positions.

    Returns:
        The wide list, the near one (neighbour-major; n for an empty entry), and the
        largest number of near neighbours; None if loops are not available.
    """
    if not (position.dtype == jnp.float64 and registered("cells")):
        return None
    if any(device.platform != "cpu" for device in position.devices()):
        return None
    points = np.array(position)  # writeable: one compiled signature
    kernel = loops("anew")
    if anew:
        of = Hash.of(len(points), wide.cell_size)
        entries, most = kernel.wide_neighbors(
            points, of.size, of.radius, of.cells, wide.max_occupancy
        )
        full = most > wide.max_occupancy
        code = int(wide.error.code)
        code |= int(_partition().PartitionErrorCode.NEIGHBOR_LIST_OVERFLOW) * full
        # unaliased arrays
        wide = dataclasses.replace(
            wide,
            idx=jax.device_put(entries),
            reference_position=jax.device_put(points + _SHIFT),
            error=_partition().PartitionError(jax.device_put(np.uint8(code))),
        )
    listed, most = kernel.near_neighbors(points, np.array(wide.idx), radius, room)
    return wide, jax.device_put(listed), int(most)


def _by_loop(
    wide: Any, position: Float[Array, "n 3"], still: Bool[Array, " n"]
) -> tuple[Int[Array, "n k"], UInt[Array, ""]]:
    """Return entries and error code by the compiled loop."""
    of = Hash.of(position.shape[0], wide.cell_size)
    results = (
        jax.ShapeDtypeStruct(wide.idx.shape, jnp.int32),
        jax.ShapeDtypeStruct((1,), jnp.int32),
    )
    call = jax.ffi.ffi_call(target("cells"), results, vmap_method="sequential")
    lengths = jnp.array([of.size, of.radius])
    entries, most = call(position, lengths, jnp.array([of.cells], jnp.int32), ~still)
    full = _partition().PartitionErrorCode.NEIGHBOR_LIST_OVERFLOW
    return entries, wide.error.update(full, most[0] > wide.max_occupancy).code


def _by_cells(
    wide: Any, position: Float[Array, "n 3"], still: Bool[Array, " n"]
) -> tuple[Int[Array, "n k"], UInt[Array, ""]]:
    """Return entries and error code by jax-md's cells."""
    with _permissive():
        moved = position + _SHIFT
        if position.shape[0] <= _MOST_AT_ONCE:
            found = wide.update(moved)  # no move is too small: dr_threshold is 0
            return _without(found.idx, still), found.error.code
        cells = wide.cell_list_fn.update(moved, wide.cell_list_capacity)
    entries, most = _in_portions(wide, cells, moved)
    code = _partition().PartitionErrorCode
    error = wide.error.update(code.CELL_LIST_OVERFLOW, cells.did_buffer_overflow)
    return _without(entries, still), error.update(
        code.NEIGHBOR_LIST_OVERFLOW, most > wide.max_occupancy
    ).code


def _without(entries: Int[Array, "n k"], still: Bool[Array, " n"]) -> Array:
    return jnp.where(still[:, None], entries.shape[0], entries)


def _in_portions(
    wide: Any, cells: Any, position: Float[Array, "n 3"]
) -> tuple[Int[Array, "n k"], Int[Array, ""]]:
    """Return entries as jax-md's, and their maximum, portion by portion.

    jax-md stores all pairs of points in adjacent cells, a gigabyte for 100 000 points.
    """
    count, room = position.shape[0], wide.max_occupancy
    side, slots = cells.id_buffer.shape[0], cells.id_buffer.shape[3]
    held = cells.id_buffer.reshape(-1, slots)
    way = jnp.arange(27, dtype=jnp.int32)
    ways = jnp.stack([way // 9, way // 3 % 3, way % 3], axis=1) - 1
    digits = jnp.array([1, side, side**2], jnp.int32)

    def of_portion(start: Int[Array, ""]) -> tuple[Array, Array]:
        own = jnp.minimum(start + jnp.arange(_PORTION, dtype=jnp.int32), count - 1)
        around = (cells.particle_cell_id[own][:, None, :] + ways[None]) % side
        cell = jnp.sum(around * digits[None, None, :], axis=2, dtype=jnp.int32)
        other = held[cell].reshape(_PORTION, 27 * slots)
        safe = jnp.minimum(other, count - 1)
        square = jnp.zeros(other.shape, position.dtype)
        for column in position.T:
            square += (column[own][:, None] - column[safe]) ** 2
        near = (other < count) & (square < wide.cell_size**2) & (other != own[:, None])
        places, found = first_true(near, room)
        entries = jnp.take_along_axis(
            other, jnp.minimum(places, other.shape[1] - 1), axis=1
        )
        real = places < other.shape[1]
        return jnp.where(real, entries, count), jnp.max(found)

    starts = jnp.arange(0, count, _PORTION, dtype=jnp.int32)
    entries, most = jax.lax.map(of_portion, starts)
    return entries.reshape(-1, room)[:count], jnp.max(most)


def moved(wide: Any, position: Float[Array, "n 3"]) -> Float[Array, "n 3"]:
    """Return the displacement of every point since the list was made, in r0."""
    return position + _SHIFT - wide.reference_position


def listed_at(wide: Any) -> Float[Array, "n 3"]:
    """Return the positions for which the list was made, in r0."""
    return wide.reference_position - _SHIFT


def listed_by_loop(
    wide: Any,
    entries: Int[Array, "n k"],
    position: Float[Array, "n 3"],
    full: Bool[Array, ""],
) -> Any:
    """Return a list whose entries a loop made for these positions.

    Args:
        wide: the list before.
        entries: neighbours of each point.
        position: in r0.
        full: whether the capacity was exceeded.
    """
    code = _partition().PartitionErrorCode.NEIGHBOR_LIST_OVERFLOW
    return dataclasses.replace(
        wide,
        idx=entries,
        reference_position=position + _SHIFT,
        error=_partition().PartitionError(wide.error.update(code, full).code),
    )


def moved_to(wide: Any, chosen: Int[Array, " k"], position: Float[Array, "k 3"]) -> Any:
    """Set the reference positions of some points, before relisting them.

    Args:
        wide: the list.
        chosen: the points; n is padding.
        position: where they are, in r0.
    """
    reference = wide.reference_position.at[chosen].set(position + _SHIFT, mode="drop")
    return dataclasses.replace(wide, reference_position=reference)


def blank(count: int, radius: float, room: int, like: Any) -> Any:
    """Allocate an empty list for a subset of the points of another list.

    Args:
        count: number of slots.
        radius: distance up to which pairs are listed, in r0; at most that of the
            other list.
        room: capacity for neighbours of a point.
        like: the other list.
    """
    update, cell_list = _functions(Hash.of(count, radius))
    return dataclasses.replace(
        like,
        idx=_no_entries(count, room),
        reference_position=_nowhere(count, like.reference_position.dtype),
        error=_partition().PartitionError(jnp.zeros((), jnp.uint8)),
        max_occupancy=room,
        cell_size=radius,
        cell_list_fn=cell_list,
        update_fn=update,
    )


@functools.lru_cache(maxsize=8)
def _no_entries(count: int, room: int) -> Int[Array, "n k"]:
    return jnp.full((count, room), count, jnp.int32)


@functools.lru_cache(maxsize=8)
def _nowhere(count: int, dtype: DTypeLike) -> Float[Array, "n 3"]:
    return jnp.zeros((count, 3), dtype)

"""The loops over lists find what XLA finds, and are used where they may be."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxgrow.neighbors import cell_list as cells
from jaxgrow.neighbors.verlet_list import _near_by_scan, allocate, find_near


RADIUS = 2.4


def points(count, seed=0):
    """A dense cloud, far from the origin on one side, and a few parked far away."""
    rng = np.random.default_rng(seed)
    side = (0.8 * count) ** (1 / 3)
    position = rng.uniform(-side / 2, side / 2, (count, 3)) - [7.3, 0, 0]
    position[-3:] = [[300.0, 0, 0], [0, -4e4, 0], [1e9, 1e9, 1e9]]
    return jnp.asarray(position)


def sorted_rows(entries):
    return np.sort(np.asarray(entries), axis=1)


@pytest.mark.parametrize("count", [5, 300, 9000])  # in portions where there are many
def test_wide_list_is_that_of_jax_md(count):
    position = points(count)
    wide = cells.make(position, cells.Hash.of(count, RADIUS))
    assert "jaxgrow_cells" in jax.jit(cells.relist).lower(wide, position).as_text()
    made = jax.jit(cells.relist)(wide, position)
    everyone = jnp.zeros(count, bool)
    entries, code = jax.jit(cells._by_cells)(wide, position, everyone)
    assert int(code) == int(made.error.code) == 0
    np.testing.assert_array_equal(sorted_rows(made.idx), sorted_rows(entries))
    np.testing.assert_array_equal(cells.moved(made, position), 0)


def test_wide_list_is_that_of_all_distances():
    position = points(200, seed=1)
    wide = cells.make(position, cells.Hash.of(200, RADIUS))
    made = cells.relist(wide, position)
    gap = np.linalg.norm(position[:, None] - position[None], axis=-1)
    for i, row in enumerate(np.asarray(made.idx)):
        near = np.flatnonzero(gap[i] < RADIUS)
        assert sorted(row[row < 200]) == [j for j in near if j != i]


def test_points_that_are_nowhere_are_near_nobody():
    position = points(300).at[7].set(jnp.nan).at[8, 1].set(jnp.inf)
    wide = cells.make(position, cells.Hash.of(300, RADIUS))
    entries = np.asarray(cells.relist(wide, position).idx)
    assert not np.isin(entries, [7, 8]).any()
    assert (entries[[7, 8]] == 300).all()


def test_wide_list_that_is_too_small_says_so():
    apart = 5 * points(300)
    wide = cells.make(apart, cells.Hash.of(300, RADIUS))
    crowded = 0.4 * points(300)
    _, most = np.unique(
        np.argwhere(np.linalg.norm(crowded[:, None] - crowded[None], axis=-1) < RADIUS)[
            :, 0
        ],
        return_counts=True,
    )
    assert most.max() > wide.max_occupancy
    assert int(cells.relist(wide, crowded).error.code) != 0
    assert int(cells.relist(wide, apart).error.code) == 0


@pytest.mark.parametrize("room", [16, 64])
def test_near_list_is_that_of_the_program(room):
    position = points(400, seed=2)
    wide = allocate(position).wide.idx
    moved = position + 0.1 * jnp.sin(7 * position)
    arguments = moved.at[5].set(jnp.nan), wide
    found = jax.jit(find_near, static_argnums=2)
    assert "jaxgrow_near" in found.lower(*arguments, room).as_text()
    listed, most = found(*arguments, room)
    wanted, wanted_most = jax.jit(_near_by_scan, static_argnames="room")(
        *arguments, room=room
    )
    assert int(most) == int(wanted_most) > 16
    np.testing.assert_array_equal(listed, wanted)


def test_lists_of_32_bits_are_left_to_xla():
    position = points(300)
    wide = cells.make(position, cells.Hash.of(300, RADIUS))
    single = position.astype(jnp.float32)
    said = jax.jit(cells.relist).lower(wide, single).as_text()
    said += jax.jit(find_near, static_argnums=2).lower(single, wide.idx, 32).as_text()
    assert "jaxgrow_" not in said

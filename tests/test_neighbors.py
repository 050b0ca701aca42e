"""Neighbour lists against scipy's trees."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.spatial import KDTree

from jaxgrow import neighbors as nb
from jaxgrow.energy.a2 import CUTOFF
from jaxgrow.state import parked


COUNT = 64


def pairs_of(neighbors, position, radius=CUTOFF):
    """Listed pairs (ordered) that are within the radius."""
    listed = np.asarray(nb.listed(neighbors))
    count = len(position)
    own = np.broadcast_to(np.arange(count), listed.shape)
    real = listed < count
    first, second = own[real], listed[real]
    near = np.linalg.norm(position[first] - position[second], axis=1) <= radius
    return sorted(zip(first[near].tolist(), second[near].tolist(), strict=True))


def pairs_by_tree(position, radius=CUTOFF):
    pairs = KDTree(position).query_pairs(radius, output_type="ndarray").tolist()
    return sorted((i, j) for a, b in pairs for i, j in ((a, b), (b, a)))


def box(seed, scale=3.0, count=COUNT):
    return np.random.default_rng(seed).uniform(0, scale, (count, 3))


def test_every_pair_is_listed_once_from_both_sides():
    position = box(0)
    wanted = pairs_by_tree(position)
    assert len(wanted) > 500
    assert pairs_of(nb.allocate(jnp.asarray(position)), position) == wanted


def test_entries_are_neighbour_major_and_nobody_is_its_own_neighbour():
    position = box(0)
    neighbors = nb.allocate(jnp.asarray(position))
    listed = np.asarray(nb.listed(neighbors))
    assert listed.shape == (neighbors.max_occupancy, COUNT)
    assert not np.any(listed == np.arange(COUNT))


@pytest.mark.parametrize("offset", [0.0, -50.0, 1e4])
def test_positions_far_outside_of_the_hash_lose_no_pair(offset):
    # the cells are periodic with a box of 23 r0
    position = box(1, scale=60.0)
    position[:30] = box(2)[:30] + offset
    position[30:40] = position[20:30] + 0.5
    assert pairs_of(nb.allocate(jnp.asarray(position)), position) == pairs_by_tree(
        position
    )


def test_particles_one_box_apart_are_no_neighbours():
    position = np.asarray(parked(COUNT)) * 1.0
    position[:2] = [[0, 0, 0], [12 * (CUTOFF + nb.SKIN) * 1.0001, 0, 0]]
    assert pairs_of(nb.allocate(jnp.asarray(position)), position) == []


def test_parked_slots_have_no_neighbours():
    position = np.concatenate([box(3, scale=2.0)[:40], np.asarray(parked(24))])
    listed = np.asarray(nb.listed(nb.allocate(jnp.asarray(position))))
    assert np.all(listed[:, 40:] == COUNT)
    assert not np.any((listed >= 40) & (listed < COUNT))


def test_parked_slots_are_apart_in_any_number():
    position = np.asarray(parked(5000))
    assert KDTree(position).query(position, k=2)[0][:, 1].min() >= 4
    more = np.asarray(parked(40, 30))
    np.testing.assert_array_equal(more, position[30:70])


update = jax.jit(nb.update)


def test_update_lists_every_pair_along_a_walk():
    rng = np.random.default_rng(4)
    position = box(4, scale=4.0)
    neighbors = nb.allocate(jnp.asarray(position), 40)
    for _ in range(30):
        position = position + 0.1 * rng.normal(size=position.shape)
        neighbors = update(neighbors, jnp.asarray(position))
        assert not nb.overflowed(neighbors)
        assert pairs_of(neighbors, position) == pairs_by_tree(position)


def test_update_keeps_the_list_while_nobody_moved_by_half_the_skin():
    position = box(5, scale=4.0)
    neighbors = nb.allocate(jnp.asarray(position), 40)
    step = np.array([0.49 * nb.SKIN, 0, 0])
    one = np.arange(COUNT)[:, None] == 3
    kept = update(neighbors, jnp.asarray(position + one * step))
    np.testing.assert_array_equal(nb.listed(kept), nb.listed(neighbors))
    np.testing.assert_array_equal(kept.reference_position, neighbors.reference_position)
    moved = position + one * 1.1 * step
    rebuilt = update(neighbors, jnp.asarray(moved))
    shift = np.asarray(rebuilt.reference_position - neighbors.reference_position)
    np.testing.assert_allclose(shift, moved - position, atol=1e-12)


def test_update_that_does_not_fit_is_flagged_and_stays_flagged():
    sparse = 2.5 * np.stack(np.unravel_index(np.arange(COUNT), (4, 4, 4)), axis=1)
    neighbors = nb.allocate(jnp.asarray(sparse))
    assert not nb.overflowed(neighbors)
    full = update(neighbors, jnp.asarray(box(6, scale=1.5)))
    assert nb.overflowed(full)
    assert nb.overflowed(update(full, jnp.asarray(sparse)))


def test_list_allocated_anew_after_an_overflow_is_complete():
    dense = box(6, scale=1.5)
    again = nb.allocate(jnp.asarray(dense), 24)
    assert not nb.overflowed(again)
    assert pairs_of(again, dense) == pairs_by_tree(dense)


def test_list_that_is_made_anew_does_not_come_back_smaller():
    sparse = 2.5 * np.stack(np.unravel_index(np.arange(COUNT), (4, 4, 4)), axis=1)
    neighbors = nb.allocate(jnp.asarray(sparse), 37)
    assert nb.listed(neighbors).shape[0] == 48
    assert nb.allocate(jnp.asarray(sparse)).max_occupancy % 8 == 0


def test_lists_of_the_same_capacity_share_a_compiled_program():
    compiled = []

    @jax.jit
    def program(neighbors):
        compiled.append(1)
        return nb.listed(neighbors).sum()

    for seed in (7, 8, 9):
        program(nb.allocate(jnp.asarray(box(seed, scale=6.0)), 40))
    assert len(compiled) == 1


def test_two_particles_have_a_list():
    position = np.array([[0.0, 0, 0], [1, 0, 0]])
    assert pairs_of(nb.allocate(jnp.asarray(position)), position) == [(0, 1), (1, 0)]


def test_single_particle_has_a_list():
    assert pairs_of(nb.allocate(jnp.zeros((1, 3))), np.zeros((1, 3))) == []


@pytest.mark.slow
def test_thousands_of_particles_lose_no_pair():
    position = box(10, scale=16.0, count=5000)
    position[:10] -= 40.0
    assert pairs_of(nb.allocate(jnp.asarray(position)), position) == pairs_by_tree(
        position
    )

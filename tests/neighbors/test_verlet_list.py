"""Neighbour lists against scipy's trees."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.spatial import KDTree

from jaxgrow import kernels
from jaxgrow.energy.a2 import CUTOFF
from jaxgrow.neighbors import cell_list as cells, verlet_list as nb
from jaxgrow.transfer.device import parked


COUNT = 64


def pairs_of(neighbors, position, radius=CUTOFF):
    """Listed pairs (ordered) that are within the radius."""
    listed = np.asarray(neighbors.listed)
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


def lattice():
    return 2.5 * np.stack(np.unravel_index(np.arange(COUNT), (4, 4, 4)), axis=1)


def roomy(position):
    """A list with room for all."""
    dense = nb.allocate(jnp.asarray(box(6, scale=1.5)))
    return nb.allocate(jnp.asarray(position), dense)


def test_every_pair_is_listed_once_from_both_sides():
    position = box(0)
    wanted = pairs_by_tree(position)
    assert len(wanted) > 500
    assert pairs_of(nb.allocate(jnp.asarray(position)), position) == wanted


def test_entries_are_neighbour_major_and_nobody_is_its_own_neighbour():
    position = box(0)
    neighbors = nb.allocate(jnp.asarray(position))
    listed = np.asarray(neighbors.listed)
    assert listed.shape[1] == COUNT
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
    position = parked(COUNT)
    position[:2] = [[0, 0, 0], [12 * (CUTOFF + nb.WIDE_SKIN) * 1.0001, 0, 0]]
    assert pairs_of(nb.allocate(jnp.asarray(position)), position) == []


def test_parked_slots_have_no_neighbours():
    position = np.concatenate([box(3, scale=2.0)[:40], parked(24)])
    listed = np.asarray(nb.allocate(jnp.asarray(position)).listed)
    assert np.all(listed[:, 40:] == COUNT)
    assert not np.any((listed >= 40) & (listed < COUNT))


def test_parked_slots_are_apart_in_any_number():
    position = parked(5000)
    assert KDTree(position).query(position, k=2)[0][:, 1].min() >= 4
    more = parked(40, 30)
    np.testing.assert_array_equal(more, position[30:70])


update = jax.jit(nb.update)


def test_update_lists_every_pair_along_a_walk():
    rng = np.random.default_rng(4)
    position = box(4, scale=4.0)
    neighbors = roomy(position)
    for _ in range(30):
        position = position + 0.1 * rng.normal(size=position.shape)
        neighbors = update(neighbors, jnp.asarray(position))
        assert not neighbors.overflow
        assert pairs_of(neighbors, position) == pairs_by_tree(position)


@pytest.mark.parametrize("share", [[1.0], [0.7, 0.3], [0.5, 0.5]])
def test_update_keeps_the_list_until_two_moved_by_the_skin_together(share):
    position = box(5, scale=4.0)
    neighbors = roomy(position)
    step = np.zeros_like(position)
    step[3 : 3 + len(share), 1] = share
    step[10:, 0] = 0.005  # all others move too, but not as far
    kept = update(neighbors, jnp.asarray(position + 0.99 * nb.SKIN * step))
    np.testing.assert_array_equal(kept.listed, neighbors.listed)
    np.testing.assert_array_equal(kept.reference, neighbors.reference)
    moved = position + 1.15 * nb.SKIN * step
    anew = update(neighbors, jnp.asarray(moved))
    np.testing.assert_array_equal(anew.reference, moved)


def test_near_list_is_found_in_a_wide_one_that_is_kept():
    position = box(5, scale=4.0)
    neighbors = roomy(position)
    near = update(neighbors, jnp.asarray(position + np.array([0.3, 0, 0])))
    np.testing.assert_array_equal(near.reference, position + np.array([0.3, 0, 0]))
    before = neighbors.wide.reference_position
    np.testing.assert_array_equal(near.wide.reference_position, before)
    far = update(near, jnp.asarray(position + np.array([0.5, 0, 0])))
    assert np.all(np.asarray(far.wide.reference_position - before)[:, 0] > 0.49)


def test_update_that_does_not_fit_is_flagged_and_stays_flagged():
    sparse = lattice()
    neighbors = nb.allocate(jnp.asarray(sparse))
    assert not neighbors.overflow
    full = update(neighbors, jnp.asarray(box(6, scale=1.5)))
    assert full.overflow
    assert update(full, jnp.asarray(sparse)).overflow


def test_list_allocated_anew_after_an_overflow_is_complete():
    dense = box(6, scale=1.5)
    again = nb.allocate(jnp.asarray(dense))
    assert not again.overflow
    assert pairs_of(again, dense) == pairs_by_tree(dense)


def test_list_that_is_made_anew_does_not_come_back_smaller():
    dense, sparse = roomy(box(7)), nb.allocate(jnp.asarray(lattice()))
    again = nb.allocate(jnp.asarray(lattice()), dense)
    assert sparse.listed.shape[0] < dense.listed.shape[0]
    assert sparse.listed.shape[0] % 8 == 0
    assert again.listed.shape == dense.listed.shape
    assert again.wide.idx.shape == dense.wide.idx.shape


def test_list_that_was_too_small_is_made_anew_larger_where_it_would_fit():
    # the positions that it did not fit were given up
    full = update(nb.allocate(jnp.asarray(lattice())), jnp.asarray(box(6, scale=1.5)))
    again = nb.allocate(jnp.asarray(lattice()), full)
    assert not again.overflow
    rooms = [(a.listed.size, a.wide.idx.size) for a in (full, again)]
    assert sum(rooms[1]) > sum(rooms[0])


@pytest.mark.parametrize("offset", np.linspace(0, 2.4, 21))
def test_list_of_few_is_complete_after_one_of_many(offset):
    # 4200 particles have as many cells as a few have, but smaller ones
    nb.allocate(jnp.asarray(parked(4200)))
    position = parked(COUNT)
    neighbors = nb.allocate(jnp.asarray(position))
    apart = CUTOFF + nb.WIDE_SKIN - nb.SKIN - 0.02
    position[:2] = [[offset, 0, 0], [offset + apart, 0, 0]]
    neighbors = update(neighbors, jnp.asarray(position))  # by cells
    position[1, 0] = offset + CUTOFF - 0.01  # not farther than the wide list allows
    neighbors = update(neighbors, jnp.asarray(position))
    assert pairs_of(neighbors, position) == [(0, 1), (1, 0)]


def test_lists_of_the_same_capacity_share_a_compiled_program():
    compiled = []

    @jax.jit
    def program(neighbors):
        compiled.append(1)
        return neighbors.listed.sum()

    for seed in (7, 8, 9):
        program(roomy(box(seed, scale=6.0)))
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


MANY = nb.FEW + 404


def crowd(seed, count=MANY):
    """Particles, and fifty parked slots."""
    side = (count / 1.2) ** (1 / 3)
    position = box(seed, scale=side, count=count)
    return np.concatenate([position[:-50], parked(50)])


def is_symmetric(listed):
    """Whether nobody is listed twice, and everybody by those that it lists."""
    count = listed.shape[1]
    own = np.broadcast_to(np.arange(count), listed.shape)
    real = listed < count
    there, back = own[real] * count + listed[real], listed[real] * count + own[real]
    return np.array_equal(np.unique(there), np.sort(back))


def made_anew(before, after):
    """Whether all were listed, not a few of them."""
    kept = np.all(np.asarray(before.reference) == np.asarray(after.reference), axis=1)
    return not kept.any()


@pytest.mark.parametrize(
    "count, strays", [(MANY, 1), (MANY, 5), (MANY, 25), (400, 1), (400, 5)]
)
def test_few_that_jump_are_listed_alone(count, strays):
    rng = np.random.default_rng(strays)
    position = crowd(7, count)
    inner = position[: count - 50]
    neighbors = roomy_for(position)
    alone = 0
    for _ in range(5):
        before = neighbors
        inner += 0.02 / np.sqrt(3) * rng.uniform(-1, 1, inner.shape)
        # daughters come from where slots are parked, and pairs jump together
        chosen = rng.choice(count, strays, replace=False)
        position[chosen] = inner[rng.choice(len(inner), strays)] + 0.3
        position[chosen[:2]] = position[chosen[0]] + [[0, 0, 0], [0.5, 0, 0]][:strays]
        neighbors = update(neighbors, jnp.asarray(position))
        assert not neighbors.overflow
        assert is_symmetric(np.asarray(neighbors.listed))
        assert is_symmetric(np.asarray(neighbors.wide.idx).T)
        assert pairs_of(neighbors, position) == pairs_by_tree(position)
        if not made_anew(before, neighbors):
            alone += 1
            moved = np.linalg.norm(position - np.asarray(neighbors.reference), axis=1)
            assert moved.max() <= nb.SKIN / 4
    assert alone > 0
    # the wide list, too, was kept: the next one is made of it
    anew = nb.rebuilt(neighbors, jnp.asarray(position), jnp.asarray(True))
    assert pairs_of(anew, position) == pairs_by_tree(position)


def roomy_for(position):
    """A list with room for some more than there are."""
    loose = nb.allocate(jnp.asarray(position))
    more = np.zeros((8, loose.listed.shape[1]), np.int32) + len(position)
    listed = jnp.concatenate([loose.listed, jnp.asarray(more)])
    return nb.Neighbors(listed, loose.reference, loose.full, loose.wide)


def test_one_that_jumps_into_a_full_place_is_told():
    position = crowd(8)
    neighbors = nb.allocate(jnp.asarray(position))
    room = neighbors.listed.shape[0]
    position[: room + 1] = position[100] + 0.1 * box(9)[: room + 1]
    for one in range(room + 1):  # one by one: a few each time
        now = np.array(neighbors.reference)
        now[one] = position[one]
        neighbors = update(neighbors, jnp.asarray(now))
    assert neighbors.overflow


@pytest.mark.parametrize("nowhere", [np.nan, np.inf, -np.inf, 1e300])
def test_a_list_made_of_places_that_are_none_does_not_hold(nowhere):
    position = box(11)
    bad = position.copy()
    bad[3] = nowhere
    neighbors = nb.allocate(jnp.asarray(bad), roomy(position))
    assert nb.outgrown(neighbors, jnp.asarray(position))
    again = nb.update(neighbors, jnp.asarray(position))
    assert again.overflow or pairs_of(again, position) == pairs_by_tree(position)


def test_the_list_of_a_part_is_that_of_its_particles():
    position = crowd(10)
    whole = nb.allocate(jnp.asarray(position))
    moved = position + 0.04 * np.sin(37 * position)
    index = np.flatnonzero(np.linalg.norm(position - 5.0, axis=1) < 5)
    room = len(index) + 20
    slots = np.concatenate([moved[index], np.asarray(parked(20))])
    still = np.arange(room) % 3 == 0
    part = nb.of_part(jnp.asarray(slots), jnp.asarray(still), whole)
    assert part.listed.shape == (whole.listed.shape[0], room)

    def of_moving(pairs):
        return [(i, j) for i, j in pairs if not still[i]]

    assert pairs_of(part, slots) == of_moving(pairs_by_tree(slots))
    rng = np.random.default_rng(12)
    for _ in range(10):
        moves = 0.05 * rng.normal(size=(room, 3))
        slots = np.where(still[:, None], slots, slots + moves)
        part = update(part, jnp.asarray(slots))
        assert not part.overflow
        found = pairs_of(part, slots)
        assert of_moving(found) == of_moving(pairs_by_tree(slots))


def test_the_list_of_a_part_that_is_denser_has_more_room():
    whole = nb.allocate(jnp.asarray(crowd(10)))
    dense = 0.5 * crowd(10)
    part = nb.of_part(jnp.asarray(dense), jnp.zeros(len(dense), bool), whole)
    assert part.listed.shape[0] > whole.listed.shape[0]
    assert pairs_of(part, dense) == pairs_by_tree(dense)


@pytest.mark.parametrize("crowded", [False, True])
def test_list_made_in_portions_is_that_made_at_once(crowded, monkeypatch):
    rng = np.random.default_rng(0)
    position = jnp.asarray(rng.uniform(-9, 9, (2500, 3)))
    wide = cells.make(position, cells.Hash.of(2500, 2.0))
    if crowded:
        position = 0.4 * position
    whole = jax.jit(lambda at: cells.relist(wide, at))(position)
    monkeypatch.setattr(cells, "_MOST_AT_ONCE", 0)
    parts = jax.jit(lambda at: cells.relist(wide, at))(position)
    assert jax.tree.structure(parts) == jax.tree.structure(whole)
    assert (whole.error.code != 0) == crowded
    assert parts.error.code == whole.error.code
    if not crowded:
        np.testing.assert_array_equal(parts.idx, whole.idx)
        np.testing.assert_array_equal(parts.reference_position, position + 512.0)


def test_a_near_list_that_is_full_is_enlarged_from_the_wide_one():
    position = box(13, scale=3.0)
    room = 8
    loose = nb.allocate(jnp.asarray(position))
    short = nb.Neighbors(
        loose.listed[:room], loose.reference, jnp.asarray(True), loose.wide
    )
    again = nb.allocate(jnp.asarray(position), short)
    assert not again.overflow
    kept = np.array_equal(again.wide.idx, loose.wide.idx)
    assert kept  # and was not searched for again
    assert again.listed.shape[0] > room
    assert pairs_of(again, position) == pairs_by_tree(position)


def test_a_near_list_that_was_full_elsewhere_gets_more_room():
    position = box(14)
    before = nb.allocate(jnp.asarray(position))
    full = nb.Neighbors(before.listed, before.reference, jnp.asarray(True), before.wide)
    again = nb.allocate(jnp.asarray(position), full)
    assert again.listed.shape[0] > before.listed.shape[0]
    assert pairs_of(again, position) == pairs_by_tree(position)


def test_a_full_near_list_is_not_made_from_a_wide_one_that_does_not_hold():
    position = box(15)
    before = nb.allocate(jnp.asarray(position))
    full = nb.Neighbors(before.listed, before.reference, jnp.asarray(True), before.wide)
    far = box(16)
    assert pairs_of(nb.allocate(jnp.asarray(far), full), far) == pairs_by_tree(far)


@pytest.mark.parametrize("room", [40, 8])
@pytest.mark.parametrize("crowd", [1.0, 0.3])
def test_lists_made_on_the_host_are_those_of_the_program(room, crowd):
    if not kernels.wanted():
        pytest.skip("there are no loops here")
    position = np.concatenate([box(0, scale=5.0, count=256), parked(3)])
    empty = nb.allocate(jnp.asarray(position)).wide
    # where it is more crowded the wide list is too small
    position[:256] *= crowd
    position = jnp.asarray(position)
    found = cells.filled_on_host(empty, position, CUTOFF + nb.SKIN, room, anew=True)
    assert found is not None
    wide, listed, most = found
    wanted = nb._filled_by_program(position, empty, room, relist=True)
    assert (most > room) == bool(wanted.full)
    assert bool(wide.error.code) == (crowd < 0.5)
    assert int(wide.error.code) == int(wanted.wide.error.code)
    for ours, theirs in (
        (wide.idx, wanted.wide.idx),
        (wide.reference_position, wanted.wide.reference_position),
        (listed, wanted.listed),
    ):
        np.testing.assert_array_equal(np.asarray(ours), np.asarray(theirs))
        assert ours.dtype == theirs.dtype
    again = cells.filled_on_host(wide, position, CUTOFF + nb.SKIN, room, anew=False)
    assert again is not None
    assert again[0] is wide
    np.testing.assert_array_equal(np.asarray(again[1]), np.asarray(listed))

"""Lists that the loop of a descent makes anew hold the pairs of the program's."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxgrow.energy.contact import list_contacts
from jaxgrow.energy.parameters import Parameters
from jaxgrow.equilibrium.lbfgs import LBFGS
from jaxgrow.equilibrium.loops import with_loops
from jaxgrow.equilibrium.native_descent import descend_by_loop
from jaxgrow.equilibrium.problem import Problem
from jaxgrow.equilibrium.refresh_lists import allocate_lists
from jaxgrow.kernels.layout import Touching
from jaxgrow.neighbors.update_particle import Links, relink
from jaxgrow.state import Particles
from jaxgrow.transfer.device import get, parked


def places(count, seed=0):
    return np.random.default_rng(seed).uniform(0, (count / 1.2) ** (1 / 3), (count, 3))


def neighbours(place, radius, room):
    """Every pair from both sides, neighbour-major."""
    count = len(place)
    apart = np.linalg.norm(place[:, None] - place[None], axis=2)
    near = (apart < radius) & ~np.eye(count, dtype=bool)
    listed = np.full((room, count), count, np.int32)
    for i in range(count):
        who = np.flatnonzero(near[i])[:room]
        listed[: len(who), i] = who
    return listed


def as_sets(listed):
    count = listed.shape[1]
    return [set(column[column < count].tolist()) for column in listed.T]


def test_particle_that_went_far_is_listed_as_the_program_does_it():
    from jaxgrow.kernels import links

    place, radius = places(80), 1.6
    listed = neighbours(place, radius, 48)
    for one, seed in ((3, 1), (79, 2), (3, 3), (40, 4)):
        place[one] = places(80, seed)[one]
        near = np.linalg.norm(place - place[one], axis=1) < radius
        near[one] = False
        wanted = relink(
            Links(jnp.asarray(listed), jnp.zeros((), bool)),
            jnp.asarray(one),
            jnp.asarray(near),
        )
        assert links.relink(listed, one, place, radius)
        assert not bool(wanted.full)
        assert as_sets(listed) == as_sets(np.asarray(wanted.listed))
        assert as_sets(listed) == as_sets(neighbours(place, radius, 48))


def test_list_without_room_for_a_particle_says_so():
    from jaxgrow.kernels import links

    place, radius = places(80), 1.6
    near = as_sets(neighbours(place, radius, 79))
    most = max(map(len, near))
    crowded = max(range(80), key=lambda i: len(near[i]))
    newcomer = int(np.linalg.norm(place - place[crowded], axis=1).argmax())
    listed = neighbours(place, radius, most + 1)
    place[newcomer] = place[crowded] + [0.05, 0.0, 0.0]
    roomy = listed.copy()
    assert links.relink(roomy, newcomer, place, radius)
    assert len(as_sets(roomy)[crowded]) == most + 1
    assert not links.relink(listed[:most], newcomer, place, radius)


@pytest.fixture(scope="module")
def under_a_sheet(make_sheet):
    """Particles around a wavy sheet with long triangles among short ones."""
    rng = np.random.default_rng(5)
    membrane = make_sheet(lambda x, y: 0.4 * np.sin(x) * np.cos(y))
    position = rng.uniform([-2.0, -2.0, -2.5], [6.0, 6.0, 2.5], (200, 3))
    position[7] = [60.0, 0.0, 0.0]
    particles = Particles(
        jnp.asarray(position),
        jnp.zeros(200, int),
        jnp.arange(200) % 9 != 4,
        jnp.zeros(200, bool),
    )
    return particles, membrane


@pytest.mark.parametrize("radius", [0.3, 1.05, 2.0])
def test_contacts_are_those_of_the_program_in_the_same_order(under_a_sheet, radius):
    from jaxgrow.kernels import touching

    particles, membrane = under_a_sheet
    wanted = list_contacts(particles, membrane, jnp.asarray(radius), 4096)
    count = int(wanted.real.sum())
    assert count > 20
    listed = Touching(
        np.zeros(4096, np.int32),
        np.zeros(4096, np.int32),
        np.zeros((3, 4096), np.int64),
        np.zeros(4096, np.uint8),
    )
    given = (
        *(get(particles.position), get(particles.alive).view(np.uint8)),
        *(get(membrane.vertices), get(membrane.faces)),
        get(membrane.face_alive).view(np.uint8),
    )
    assert touching.list_all(*given, radius, listed) == count
    np.testing.assert_array_equal(listed.real, wanted.real)
    np.testing.assert_array_equal(listed.particle[:count], wanted.particle[:count])
    np.testing.assert_array_equal(listed.face[:count], wanted.face[:count])
    np.testing.assert_array_equal(listed.corners[:, :count], wanted.corners[:, :count])
    # what there is no room for is left out, and counted
    small = jax.tree.map(lambda a: a[..., : count - 1].copy(), listed)
    assert touching.list_all(*given, radius, small) == count


def crowd(position, slots):
    count = len(position)
    place = np.concatenate([position, np.asarray(parked(slots - count))])
    return Particles(
        jnp.asarray(place),
        jnp.ones(slots, int),
        jnp.arange(slots) < count,
        jnp.zeros(slots, bool),
    )


@pytest.mark.parametrize("count, slots", [(300, 320), (4200, 4224)])
@pytest.mark.parametrize("moved", ["one", "some", "all"])
def test_neighbours_are_complete_however_many_went_far(count, slots, moved):
    """Few are patched, of many as well as of few; else lists are made by cells."""
    position = places(count)
    lists = allocate_lists(Problem.of(crowd(position, slots), None))
    rng = np.random.default_rng(8)
    who = {"one": [5], "some": range(0, count, 7), "all": range(count)}[moved]
    far = 1.5 if moved == "one" else 0.6
    position = position.copy()
    position[list(who)] += far * rng.normal(size=(len(list(who)), 3))
    problem = Problem.of(crowd(position, slots), None, Parameters())
    limits = (jnp.asarray(n) for n in (1e-9, 0, 0.1))
    problem = with_loops(problem, lists)
    end = jax.jit(descend_by_loop)(problem, lists, LBFGS(), *limits)
    assert int(end.rebuilds) == 1
    if bool(end.lists.overflow):
        lists = allocate_lists(problem, end.lists)
        limits = (jnp.asarray(n) for n in (1e-9, 0, 0.1))
        end = jax.jit(descend_by_loop)(problem, lists, LBFGS(), *limits)
    near = as_sets(np.asarray(end.lists.neighbors.listed))
    wide = as_sets(np.asarray(end.lists.neighbors.wide.idx).T)
    for i in range(0, count, 11):
        apart = np.linalg.norm(position - position[i], axis=1)
        apart[i] = np.inf
        assert set(np.flatnonzero(apart < 1.5).tolist()) <= near[i]
        assert near[i] <= wide[i]

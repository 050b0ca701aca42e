"""Collision: its formula on known shapes, its derivatives, and its clearances."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxgrow.energy.a2 import A2
from jaxgrow.energy.collision import (
    collision_clearances,
    collision_energy,
    Collisions,
    narrow_collisions,
    PARALLEL,
)
from jaxgrow.energy.distance import segment_distance
from jaxgrow.energy.parameters import Parameters
from jaxgrow.energy.vectors import split
from jaxgrow.transfer.constructors import make_membrane

from ..quick_jit import quick_jit


PARAMETERS = Parameters(collision_range=0.5)


energy_there = quick_jit(collision_energy)
clearances_there = quick_jit(collision_clearances)
narrow_there = quick_jit(narrow_collisions)


def membrane_of(vertices):
    """A membrane of so many vertices; collisions ask for nothing else of it."""
    return make_membrane(jnp.asarray(vertices, float), np.zeros((0, 3), int))


def pairs(vertices, *, vertex=(), edges=(), apart=True, margin=0.3, still=()):
    """Lists of a pair (vertex, its triangle) and of pairs of edges."""
    index = [v for v, _ in vertex]
    corners = [c for _, c in vertex]
    return Collisions(
        still=jnp.asarray(np.reshape(still, (-1, 3)), float),
        vertex=jnp.asarray(index, int),
        corners=jnp.asarray(np.reshape(corners, (-1, 3)), int),
        apart=jnp.full(len(index), apart),
        vertex_margin=jnp.full(len(index), margin),
        edges=jnp.asarray(np.reshape(edges, (-1, 4)), int),
        edge_margin=jnp.full(len(edges), margin),
        reference=jnp.asarray(vertices, float),
        skin=jnp.asarray(0.4),
        stale=jnp.zeros((), bool),
        full=jnp.zeros((), bool),
    )


FLOOR = [[-1.0, -1.0, 0.0], [2.0, -1.0, 0.0], [-1.0, 2.0, 0.0]]


def above(height):
    """A vertex over a triangle."""
    vertices = [*FLOOR, [0.0, 0.0, height]]
    return membrane_of(vertices), pairs(vertices, vertex=[(3, (0, 1, 2))])


@quick_jit
def _value_and_slope(height):
    return jax.value_and_grad(lambda z: collision_energy(*above(z), PARAMETERS))(height)


def at_height(height):
    """The energy of a vertex over a triangle, and its slope."""
    return _value_and_slope(jnp.asarray(height, float))


@pytest.mark.parametrize("height", [0.05, 0.2, 0.35, 0.49])
def test_vertex_over_a_triangle_has_the_repulsive_profile_and_the_barrier(height):
    u = height / 0.5
    wanted = quick_jit(A2(0.0, PARAMETERS.smoothing).energy)(jnp.asarray(u))
    wanted += 10 * (-((u - 0.3) ** 2) * np.log(u / 0.3) if u < 0.3 else 0)
    energy, _ = at_height(height)
    np.testing.assert_allclose(energy, 0.5 * wanted, rtol=1e-12)


def test_nothing_is_felt_beyond_the_range():
    value, slope = at_height(0.5000001)
    assert value == 0
    assert slope == 0


@pytest.mark.parametrize("height", np.linspace(0.01, 0.499, 12))
def test_collisions_only_repel(height):
    assert at_height(height)[1] < 0


def test_barrier_grows_without_bound():
    assert at_height(1e-8)[1] < 1e3 * at_height(1e-3)[1] < 0


@pytest.mark.parametrize("name", ["barrier_range", "collision_range"])
@pytest.mark.parametrize("apart", [True, False], ids=["apart", "neighbours"])
def test_margins_have_derivatives_in_the_parameters(name, apart):
    """As if they were listed anew: b, or a length at rest of 0.1 r0 in ranges."""
    vertices = [*FLOOR, [0.0, 0.0, 0.05]]

    def listed(values):
        margin = values.barrier_range if apart else 0.1 / values.collision_range
        return pairs(vertices, vertex=[(3, (0, 1, 2))], apart=apart, margin=margin)

    def energy(value, lists=None):
        values = Parameters(**{"collision_range": 0.5, name: value})
        there = listed(values) if lists is None else lists
        return collision_energy(membrane_of(vertices), there, values)

    @quick_jit
    def both(value):
        return energy(value), jax.grad(lambda v: energy(v, listed(PARAMETERS)))(value)

    start = jnp.asarray(getattr(PARAMETERS, name))
    slope = both(start)[1]
    wanted = (both(start + 1e-6)[0] - both(start - 1e-6)[0]) / 2e-6
    assert (abs(wanted) > 0.01) == (apart or name == "collision_range")
    np.testing.assert_allclose(slope, wanted, rtol=1e-7, atol=1e-9)


def test_neighbours_feel_nothing_beyond_their_margin():
    vertices = [*FLOOR, [0.0, 0.0, 0.2]]
    near = pairs(vertices, vertex=[(3, (0, 1, 2))], apart=False, margin=0.3)
    assert energy_there(membrane_of(vertices), near, PARAMETERS) == 0
    vertices[3][2] = 0.1
    near = pairs(vertices, vertex=[(3, (0, 1, 2))], apart=False, margin=0.3)
    assert energy_there(membrane_of(vertices), near, PARAMETERS) > 0


def crossing(gap, angle=np.pi / 2):
    """Two edges of length 2 whose middles lie over each other."""
    c, s = np.cos(angle), np.sin(angle)
    return [[-1.0, 0, 0], [1.0, 0, 0], [-c, -s, gap], [c, s, gap]]


@pytest.mark.parametrize("gap", [0.01, 0.1, 0.149])
def test_crossed_edges_have_the_barrier(gap):
    vertices, u = crossing(gap), gap / 0.5
    energy = energy_there(
        membrane_of(vertices), pairs(vertices, edges=[(0, 1, 2, 3)]), PARAMETERS
    )
    wanted = -0.5 * 10 * (u - 0.3) ** 2 * np.log(u / 0.3)
    np.testing.assert_allclose(energy, wanted, rtol=1e-12)


def test_term_of_edges_fades_out_where_they_are_parallel():
    angles = [0.0, 0.5 * np.sqrt(PARALLEL), 2 * np.sqrt(PARALLEL), 1.0]
    energies = []
    for angle in angles:
        vertices = crossing(0.05, angle)
        listed = pairs(vertices, edges=[(0, 1, 2, 3)])
        energies.append(energy_there(membrane_of(vertices), listed, PARAMETERS))
    full = energies[3]
    np.testing.assert_allclose(energies[0], 0, atol=1e-15)
    assert 0.3 * full < energies[1] < 0.6 * full
    np.testing.assert_allclose(energies[2], full, rtol=1e-12)


def test_static_vertices_repel_too():
    vertices = [[0.0, 0.0, 0.2]]
    listed = pairs(vertices, vertex=[(0, (1, 2, 3))], still=FLOOR)
    energy = energy_there(membrane_of(vertices), listed, PARAMETERS)
    np.testing.assert_allclose(energy, at_height(0.2)[0], rtol=1e-12)


@pytest.fixture(scope="module")
def tangle():
    """Random vertices with random pairs, some closer than the barrier's range."""
    rng = np.random.default_rng(3)
    vertices = rng.uniform(0, 1, (16, 3))
    vertex = np.sort(rng.integers(0, 16, 40))
    corners = [rng.permutation(np.delete(np.arange(16), v))[:3] for v in vertex]
    edges = [rng.permutation(16)[:4] for _ in range(40)]
    listed = pairs(
        vertices, vertex=list(zip(vertex, corners, strict=True)), edges=edges
    )
    return membrane_of(vertices), listed


def test_derivatives_are_those_of_the_energy(tangle):
    membrane, listed = tangle

    def energy(vertices):
        at = eqx.tree_at(lambda m: m.vertices, membrane, vertices)
        return collision_energy(at, listed, PARAMETERS)

    @quick_jit
    def derived(vertices):
        both = jax.value_and_grad(energy)
        return *both(vertices), jax.jvp(jax.grad(energy), (vertices,), (way,))[1]

    at = membrane.vertices
    way = np.random.default_rng(1).normal(size=at.shape)
    h = 1e-7
    (up, slope_up, _), (down, slope_down, _) = (
        derived(at + s * h * way) for s in (1, -1)
    )
    _, slope, curve = derived(at)
    value = (up - down) / (2 * h)
    np.testing.assert_allclose(np.sum(slope * way), value, rtol=1e-5)
    change = (slope_up - slope_down) / (2 * h)
    np.testing.assert_allclose(curve, change, rtol=1e-5, atol=1e-4 * abs(change).max())


def segment_oracle(first, second):
    """Distance of two segments by a fine grid and its refinement."""
    low, distance = np.zeros(2), np.zeros(1)
    high = np.ones(2)
    for _ in range(30):
        s, t = np.meshgrid(
            *(np.linspace(a, b, 21) for a, b in zip(low, high, strict=True))
        )
        p = first[0] + s[..., None] * (first[1] - first[0])
        q = second[0] + t[..., None] * (second[1] - second[0])
        distance = np.linalg.norm(p - q, axis=-1)
        best = np.unravel_index(distance.argmin(), distance.shape)
        centre, width = np.array([s[best], t[best]]), 0.15 * (high - low)
        low, high = np.clip(centre - width, 0, 1), np.clip(centre + width, 0, 1)
    return distance.min()


def test_segment_distance_is_that_of_a_search():
    rng = np.random.default_rng(0)
    first, second = rng.normal(size=(2, 40, 2, 3))
    second[:5, 1] = second[:5, 0] + 0.7 * (first[:5, 1] - first[:5, 0])  # parallel
    second[5:8, 1] = second[5:8, 0]  # a point
    wanted = [segment_oracle(a, b) for a, b in zip(first, second, strict=True)]
    ends = [split(jnp.asarray(x[:, end])) for x in (first, second) for end in (0, 1)]
    found = quick_jit(segment_distance)(*ends)
    np.testing.assert_allclose(found, wanted, rtol=1e-7)


def test_half_of_the_clearance_keeps_all_pairs_apart(tangle):
    membrane, listed = tangle
    clear = np.asarray(clearances_there(membrane, listed))
    distances = quick_jit(Collisions.distances)
    rng = np.random.default_rng(0)
    for _ in range(20):
        step = rng.normal(size=(16, 3))
        step *= (0.499 * clear / np.linalg.norm(step, axis=1))[:, None]
        for share in np.linspace(0, 1, 11):
            at = eqx.tree_at(
                lambda m: m.vertices, membrane, membrane.vertices + share * step
            )
            vertex, edge = distances(listed, at)
            assert vertex.min() > 0
            assert edge.min() > 0


def test_clearance_is_the_smallest_distance_of_what_a_vertex_belongs_to():
    membrane, listed = above(0.2)
    np.testing.assert_allclose(clearances_there(membrane, listed), 0.2)


def test_list_is_stale_once_two_vertices_have_moved_by_its_skin_together(tangle):
    membrane, listed = tangle
    skin = float(listed.skin)
    for share, stale in ((0.99, False), (1.01, True)):
        for first in (1.0, 0.6, 0.5):
            moved = membrane.vertices.at[4, 1].add(first * share * skin)
            moved = moved.at[2, 0].add((1 - first) * share * skin)
            assert bool(listed.checked(moved).stale) is stale


def narrow(listed, membrane, room=256, skin=0.1):
    return narrow_there(listed, membrane, PARAMETERS, least=0.25, skin=skin, room=room)


@pytest.fixture
def loose(tangle):
    """The same over twice the size: some pairs are near, some are not."""
    membrane, listed = tangle
    vertices = 2 * membrane.vertices
    return (
        eqx.tree_at(lambda m: m.vertices, membrane, vertices),
        eqx.tree_at(lambda c: c.reference, listed, vertices),
    )


def test_what_is_near_has_the_energy_and_the_forces_of_all_while_it_holds(loose):
    membrane, listed = loose
    near = narrow(listed, membrane)
    assert not near.full
    shorter = int((near.vertex_margin > 0).sum() + (near.edge_margin > 0).sum())
    assert 4 < shorter < 0.9 * (len(listed.vertex) + len(listed.edges))
    energy = quick_jit(jax.value_and_grad(collision_energy, allow_int=True))
    rng = np.random.default_rng(1)
    felt = 0
    for _ in range(20):
        step = rng.normal(size=membrane.vertices.shape)
        step *= 0.0499 / np.linalg.norm(step, axis=1).max()
        at = eqx.tree_at(
            lambda m: m.vertices, membrane, membrane.vertices + jnp.asarray(step)
        )
        assert not near.checked(at.vertices).stale
        (all_energy, of_all), (near_energy, of_near) = (
            energy(at, lists, PARAMETERS) for lists in (listed, near)
        )
        np.testing.assert_allclose(near_energy, all_energy, rtol=1e-12)
        np.testing.assert_allclose(of_near.vertices, of_all.vertices, atol=1e-11)
        felt += np.abs(of_all.vertices).max() > 1e-3
        # and so has the way that nothing may cross, for steps that are made
        clear = [clearances_there(at, lists) for lists in (listed, near)]
        np.testing.assert_array_equal(*(np.minimum(c, 0.25) for c in clear))
    assert felt > 10


def test_a_list_without_room_says_so(loose):
    membrane, listed = loose
    assert narrow(listed, membrane, room=2).full
    empty = narrow(listed, membrane, room=400)
    assert np.all(np.asarray(empty.vertex)[-3:] == membrane.vertices.shape[0] - 1)
    assert not np.any(np.asarray(empty.apart)[-3:])


def test_a_move_to_nowhere_makes_a_list_stale(tangle):
    membrane, listed = tangle
    assert listed.checked(membrane.vertices.at[2, 0].set(jnp.nan)).stale

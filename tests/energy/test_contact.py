"""The smooth contact distance, its list of pairs, and the barrier."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxgrow.energy import points_in_spheres as spheres
from jaxgrow.energy.a2 import A2, CUTOFF
from jaxgrow.energy.contact import (
    barrier,
    clearances,
    contact_distances,
    contact_energy,
    Contacts,
    count_contacts,
    list_contacts,
    narrow_contacts,
    reach,
    smooth_distance,
)
from jaxgrow.energy.distance import point_triangle_distance
from jaxgrow.energy.parameters import Parameters
from jaxgrow.mesh.proximity import closest_on_triangles
from jaxgrow.state import Membrane, Particles
from jaxgrow.transfer.constructors import make_membrane, make_particles


FACES = 128  # capacity of all surfaces here, so that they share one program
PARAMETERS = jax.tree.map(jnp.asarray, Parameters(contact_range=1.0, barrier_range=0.3))
SHARPNESS = 20.0


@jax.jit
def _both(points, corners, real, sharpness):
    """Smooth and exact distance of each point to all the triangles."""
    parameters = eqx.tree_at(lambda p: p.contact_sharpness, PARAMETERS, sharpness)

    def one(point):
        spread = jnp.broadcast_to(point, (FACES, 3))
        distance = jnp.where(real, point_triangle_distance(spread, corners), jnp.inf)
        zeros = jnp.zeros(FACES, int)
        none = (jnp.zeros((1, 3)), jnp.zeros((1, 3)))
        corners_of = jnp.zeros((3, FACES), int)
        contacts = Contacts(zeros, zeros, corners_of, real, none, jnp.asarray(False))
        return smooth_distance(distance, contacts, 1, parameters)[0], distance.min()

    return jax.vmap(one)(points)


def both(points, corners, sharpness=SHARPNESS):
    extra = FACES - len(corners)
    corners = jnp.asarray(np.concatenate([corners, np.zeros((extra, 3, 3))]))
    real = jnp.arange(FACES) < FACES - extra
    points = np.asarray(points, float)
    rest = np.zeros((64 - len(points) % 64, 3))  # few shapes
    smooth, exact = _both(
        jnp.asarray(np.concatenate([points, rest])),
        corners,
        real,
        jnp.asarray(sharpness),
    )
    return np.asarray(smooth)[: len(points)], np.asarray(exact)[: len(points)]


def flat(spacing, extent, turn=False):
    """A flat grid over [-extent, extent]², its diagonals one way or the other."""
    n = round(2 * extent / spacing)
    line = np.linspace(-extent, extent, n + 1)
    x, y = np.meshgrid(line, line)
    at = np.stack([x, y, 0 * x], axis=-1)
    a, b, c, d = at[:-1, :-1], at[:-1, 1:], at[1:, 1:], at[1:, :-1]
    halves = [(a, b, d), (b, c, d)] if turn else [(a, b, c), (a, c, d)]
    return np.concatenate([np.stack(h, axis=2).reshape(-1, 3, 3) for h in halves])


def crumpled(seed=0):
    rng = np.random.default_rng(seed)
    triangles = flat(1.0, 3.0)
    shift = 0.3 * rng.normal(size=(7, 7, 3))
    index = np.round(triangles[..., :2] + 3).astype(int)
    return triangles + shift[index[..., 0], index[..., 1]]


def around(seed=1, count=500):
    return np.random.default_rng(seed).uniform([-3, -3, -1.6], [3, 3, 1.6], (count, 3))


def test_smooth_distance_never_overestimates():
    smooth, exact = both(around(), crumpled())
    assert np.all(smooth <= np.minimum(exact, CUTOFF) * (1 + 1e-14))


def test_smooth_distance_of_one_triangle_is_the_exact_one_up_to_the_reach():
    smooth, exact = both(around(), crumpled()[:1])
    np.testing.assert_allclose(smooth, np.minimum(exact, CUTOFF), rtol=1e-13)
    assert np.any(exact > CUTOFF)
    assert np.any(exact < CUTOFF)


@pytest.mark.parametrize("sharpness", [6.0, 20.0])
def test_smooth_distance_is_bounded_below_by_the_number_of_triangles(sharpness):
    surface, points = crumpled(), around()
    smooth, exact = both(points, surface, sharpness)
    near = np.stack(
        [
            closest_on_triangles(points, np.broadcast_to(t, (len(points), 3, 3)))[0]
            for t in surface
        ]
    )
    number = np.maximum((near < CUTOFF).sum(axis=0), 1)
    bound = number ** (-1 / sharpness) * np.minimum(exact, CUTOFF)
    assert np.all(smooth >= bound * (1 - 1e-13))
    assert np.any(smooth < 0.97 * np.minimum(exact, CUTOFF))


def test_equal_triangles_reach_the_bound():
    # six copies of a triangle, very near: the reach no longer matters
    corners = np.repeat(flat(1.0, 0.5)[:1], 6, axis=0)
    smooth, exact = both([[0.1, -0.1, 0.01]], corners)
    np.testing.assert_allclose(smooth, 6 ** (-1 / SHARPNESS) * exact, rtol=1e-12)


def test_smooth_distance_tends_to_the_exact_one_as_the_sharpness_grows():
    points, surface = around(), crumpled()
    errors = []
    for sharpness in (10.0, 40.0, 160.0, 640.0):
        smooth, exact = both(points, surface, sharpness)
        errors.append((1 - smooth / np.minimum(exact, CUTOFF)).max())
    # n^(-1/p) is 1 - log(n)/p: first order in 1/p
    assert np.all(np.diff(errors) < 0)
    assert errors[-1] < 0.5 * errors[-2]
    assert errors[-1] < 0.005


def test_smooth_distance_vanishes_only_where_the_exact_one_does():
    # over a vertex of six triangles a log-sum-exp turns negative
    height = np.array([1e-1, 1e-3, 1e-6])
    points = np.stack([0 * height, 0 * height, height], axis=1)
    smooth, exact = both(points, flat(1.0, 2.0))
    assert np.all(smooth > 0)
    assert np.all(smooth >= 6 ** (-1 / SHARPNESS) * exact * (1 - 1e-9))


def test_triangles_beyond_the_reach_do_not_matter_at_all():
    points = around(count=100)
    points[:, 2] = -abs(points[:, 2])
    near, _ = both(points, crumpled())
    far = flat(1.0, 2.0) + np.array([0, 0, 3.2])
    more, _ = both(points, np.concatenate([crumpled(), far]))
    np.testing.assert_array_equal(more, near)


def paths():
    """Straight paths across an edge, over a vertex, and through a medial axis."""
    roof = np.array(
        [[[0, -3, 0], [0, 3, 0], [-2, 0, -2]], [[0, 3, 0], [0, -3, 0], [2, 0, -2.0]]]
    )
    grid = flat(1.0, 3.0)
    return {
        "edge of a flat membrane": (grid, [-0.3, 0.2, 0.5], [0.4, 0.3, 0.5]),
        "vertex of a flat membrane": (grid, [-0.3, -0.4, 0.4], [0.3, 0.4, 0.4]),
        "outside of a ridge": (roof, [-0.5, 0.1, 0.5], [0.5, 0.1, 0.5]),
        "medial axis under a ridge": (roof, [-0.5, 0.1, -1.2], [0.5, 0.1, -1.2]),
        "into the reach": (grid, [0.1, 0.2, 1.7], [0.1, 0.2, 1.3]),
    }


def largest_jump(name, steps, of=lambda u: u):
    """Largest change of the slope between steps, smooth and with the exact distance."""
    surface, start, end = paths()[name]
    share = np.linspace(0, 1, steps + 1)[:, None]
    points = (1 - share) * np.array(start) + share * np.array(end)
    smooth, exact = both(points, surface)
    values = of(jnp.asarray(smooth)), of(jnp.asarray(np.minimum(exact, CUTOFF)))
    return [np.abs(np.diff(np.diff(np.asarray(u)) * steps)).max() for u in values]


@pytest.mark.parametrize("name", [name for name in paths() if "reach" not in name])
def test_smooth_distance_has_a_continuous_derivative_within_reach(name):
    coarse, fine = largest_jump(name, 2000)[0], largest_jump(name, 4000)[0]
    # a kink keeps its jump as the step shrinks; a continuous derivative halves it
    assert fine < 0.6 * coarse
    assert fine < 0.02


@pytest.mark.parametrize("name", list(paths()))
def test_contact_energy_has_a_continuous_derivative(name):
    # at the reach the distance has a kink, but there the tapered force is 0
    energy = jax.jit(A2(1.0, 0.1).energy)
    coarse, fine = (largest_jump(name, n, energy)[0] for n in (2000, 4000))
    assert fine < 0.6 * coarse
    assert fine < 0.02


def test_exact_distance_has_a_kink_where_the_smooth_one_has_none():
    assert largest_jump("medial axis under a ridge", 4000)[1] > 0.1


def test_smooth_distance_hardly_depends_on_the_triangles_of_a_flat_membrane():
    rng = np.random.default_rng(4)
    height = np.repeat([0.3, 0.7, 1.0, 1.3], 100)
    points = np.stack([*rng.uniform(-0.6, 0.6, (2, 400)), height], axis=1)
    surfaces = [
        flat(0.8, 3.2),
        flat(0.8, 3.2, turn=True),
        flat(1.0, 4.0),
        flat(2.0, 4.0),
    ]
    share = np.stack([both(points, surface)[0] / height for surface in surfaces])
    assert share.max() <= 1 + 1e-14
    # never below the six equal triangles around a vertex by more than a few per cent
    assert share.min() > 6 ** (-1 / SHARPNESS) - 0.04
    # and the rest distance, at u = 1, differs by less than the six make: 0.09 r_s
    at_rest = share[:, height == 1.0]
    assert np.ptp(at_rest, axis=0).max() < 1 - 6 ** (-1 / SHARPNESS)


@pytest.fixture(scope="module")
def crowd(scene):
    """The scene with a dead particle and a dead face in reach of others."""
    particles = eqx.tree_at(
        lambda p: p.alive, scene.particles, scene.particles.alive.at[5].set(False)
    )
    membrane = eqx.tree_at(
        lambda m: m.face_alive,
        scene.membrane,
        scene.membrane.face_alive.at[9].set(False),
    )
    return particles, membrane


def brute_force(particles: Particles, membrane: Membrane):
    """Exact distance of every living pair, infinite otherwise."""
    points = np.asarray(particles.position)
    corners = np.asarray(membrane.vertices)[np.asarray(membrane.faces)]
    table = np.stack(
        [
            closest_on_triangles(points, np.broadcast_to(t, (len(points), 3, 3)))[0]
            for t in corners
        ],
        axis=1,
    )
    table[~np.asarray(particles.alive)] = np.inf
    table[:, ~np.asarray(membrane.face_alive)] = np.inf
    return table


make_list = eqx.filter_jit(list_contacts)


@pytest.mark.parametrize("radius", [0.5, 1.05, 1.4])
def test_list_holds_every_pair_within_the_radius_once(crowd, radius):
    contacts = make_list(*crowd, jnp.asarray(radius), 512)
    wanted = set(zip(*np.nonzero(brute_force(*crowd) < radius), strict=True))
    real = np.asarray(contacts.real)
    pairs = np.stack([contacts.particle, contacts.face], axis=1)[real]
    assert {tuple(p) for p in pairs} == wanted
    assert len(pairs) == len(wanted) > 10
    assert not contacts.overflow


def test_list_is_ordered_by_particle_through_its_padding(crowd):
    contacts = make_list(*crowd, jnp.asarray(1.0), 512)
    assert np.array_equal(np.sort(contacts.particle), contacts.particle)


def test_count_of_contacts_is_no_less_than_the_pairs(crowd):
    count = count_contacts(*crowd, jnp.asarray(1.0))
    assert int(count) >= (brute_force(*crowd) < 1.0).sum()


@pytest.mark.parametrize("few", [spheres.FEW_PAIRS, 0], ids=["table", "bundles"])
def test_list_of_large_and_dead_faces_is_that_of_brute_force(few, monkeypatch):
    monkeypatch.setattr(spheres, "FEW_PAIRS", few)
    rng = np.random.default_rng(3)
    centre = rng.uniform([0, 0, -0.5], [8, 8, 0.5], (150, 1, 3))
    size = np.where(np.arange(150) < 5, 6.0, 0.6)[:, None, None]
    corners = centre + size * rng.normal(size=(150, 3, 3))
    particles = eqx.tree_at(
        lambda p: p.alive,
        make_particles(rng.uniform([0, 0, -2], [8, 8, 0], (60, 3))),
        jnp.asarray(rng.uniform(size=60) < 0.8),
    )
    membrane = eqx.tree_at(
        lambda m: m.face_alive,
        make_membrane(corners.reshape(-1, 3), np.arange(450).reshape(-1, 3)),
        jnp.asarray(rng.uniform(size=150) < 0.8),
    )
    table = brute_force(particles, membrane)
    made = eqx.filter_jit(lambda *given: list_contacts(*given, 1536))
    found = made(particles, membrane, jnp.asarray(1.2))
    count = int(found.real.sum())
    assert not found.overflow
    pairs = np.stack([found.particle, found.face])[:, :count]
    np.testing.assert_array_equal(pairs, np.nonzero(table < 1.2))
    assert count > 100


def test_list_that_is_too_small_says_so(crowd):
    wanted = int((brute_force(*crowd) < 1.4).sum())
    assert make_list(*crowd, jnp.asarray(1.4), wanted - 1).overflow
    assert not make_list(*crowd, jnp.asarray(1.4), wanted).overflow


def test_list_whose_candidates_do_not_fit_says_so(crowd):
    # spheres around the triangles leave more than three pairs a contact
    particles, membrane = crowd
    radius = jnp.asarray(0.2)
    wanted = int((brute_force(*crowd) < 0.2).sum())
    candidates = int(count_contacts(particles, membrane, radius))
    assert candidates > 3 * wanted
    assert make_list(particles, membrane, radius, wanted).overflow


def test_narrow_list_of_moved_nodes_is_that_made_from_scratch(crowd):
    particles, membrane = crowd
    wide = make_list(*crowd, jnp.asarray(1.6), 1024)
    rng = np.random.default_rng(0)
    position = particles.position + rng.uniform(-0.05, 0.05, particles.position.shape)
    vertices = membrane.vertices + rng.uniform(-0.05, 0.05, membrane.vertices.shape)
    moved = (
        eqx.tree_at(lambda p: p.position, particles, position),
        eqx.tree_at(lambda m: m.vertices, membrane, vertices),
    )
    assert 0.05 < float(wide.moved(position, vertices)) < 0.2
    radius = jnp.asarray(1.4)
    found = eqx.filter_jit(narrow_contacts)(wide, *moved, radius, 512)
    wanted = make_list(*moved, radius, 512)
    for name in ("particle", "face", "corners", "real"):
        part = np.asarray(getattr(found, name))[..., np.asarray(found.real)]
        whole = np.asarray(getattr(wanted, name))[..., np.asarray(wanted.real)]
        np.testing.assert_array_equal(part, whole)
    assert len(whole) > 100
    assert not found.overflow
    assert eqx.filter_jit(narrow_contacts)(wide, *moved, radius, 64).overflow


def test_longer_list_changes_nothing(crowd):
    energy = eqx.filter_jit(contact_energy)
    parameters = Parameters()
    short = make_list(*crowd, jnp.asarray(reach(parameters)), 512)
    long = make_list(*crowd, jnp.asarray(reach(parameters) + 0.3), 768)
    assert int(long.real.sum()) > int(short.real.sum())
    np.testing.assert_allclose(
        energy(*crowd, long, parameters), energy(*crowd, short, parameters), rtol=1e-14
    )


def test_listed_distances_are_exact_and_infinite_for_padding(crowd):
    contacts = make_list(*crowd, jnp.asarray(1.4), 512)
    found = np.asarray(contact_distances(*crowd, contacts))
    real = np.asarray(contacts.real)
    table = brute_force(*crowd)
    wanted = table[np.asarray(contacts.particle), np.asarray(contacts.face)]
    np.testing.assert_allclose(found[real], wanted[real], atol=1e-14)
    assert np.all(np.isinf(found[~real]))


def test_clearances_are_the_nearest_of_particle_and_of_vertex(crowd):
    particles, membrane = crowd
    contacts = make_list(*crowd, jnp.asarray(1.4), 512)
    distance = contact_distances(*crowd, contacts)
    count = particles.position.shape[0]
    of_particle, of_vertex = clearances(distance, contacts, membrane, count)
    table = brute_force(*crowd)
    table[table >= 1.4] = np.inf
    np.testing.assert_allclose(of_particle, table.min(axis=1), atol=1e-14)
    wanted = np.full(membrane.vertices.shape[0], np.inf)
    faces = np.asarray(membrane.faces)
    np.minimum.at(wanted, faces.ravel(), np.repeat(table.min(axis=0), 3))
    np.testing.assert_allclose(of_vertex, wanted, atol=1e-14)


def test_barrier_is_the_printed_logarithm_below_its_range_and_zero_above():
    parameters = Parameters()
    u = jnp.asarray([1e-6, 0.1, 0.29, 0.3, 0.5, 1.5])
    below = np.minimum(np.asarray(u), 0.3)
    wanted = -((below - 0.3) ** 2) * np.log(below / 0.3)
    np.testing.assert_allclose(barrier(u, parameters.barrier_range), wanted, atol=1e-15)
    assert not np.any(barrier(u, parameters.barrier_range)[3:])


def test_barrier_is_twice_differentiable_where_it_sets_in():
    second = jax.vmap(
        jax.grad(jax.grad(lambda u: barrier(u, Parameters().barrier_range)))
    )
    found = second(jnp.asarray([0.3 - 1e-7, 0.3 + 1e-7]))
    np.testing.assert_allclose(found, 0, atol=1e-4)


def test_barrier_repels_without_bound():
    slope = jax.vmap(jax.grad(lambda u: barrier(u, Parameters().barrier_range)))
    force = -np.asarray(slope(jnp.asarray([1e-1, 1e-3, 1e-5, 1e-7])))
    assert np.all(np.diff(force) > 0)
    assert force[-1] > 1e4


def one_particle(height):
    """A particle over the middle of one large triangle."""
    corners = [[5.0, 0, 0], [-2.5, 4.0, 0], [-2.5, -4.0, 0]]
    return make_particles([[0.0, 0.0, height]]), make_membrane(corners, [[0, 1, 2]])


def test_particle_rests_at_the_contact_range():
    def energy(height):
        particles, membrane = one_particle(height)
        contacts = jax.lax.stop_gradient(list_contacts(particles, membrane, 3.0, 8))
        return contact_energy(particles, membrane, contacts, Parameters())

    slope = jax.jit(jax.vmap(jax.grad(energy)))
    force = -np.asarray(slope(jnp.asarray([0.35, 0.6, 0.7, 0.8, 1.06])))
    np.testing.assert_allclose(force[2], 0, atol=1e-12)
    assert force[1] > 0 > force[3]
    # A2 in units of the contact range, half way in
    np.testing.assert_allclose(force[0], (0.75 + 0.375) / 2, rtol=1e-12)
    assert force[4] == 0

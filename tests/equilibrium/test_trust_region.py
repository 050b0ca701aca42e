"""Newton's method within a trust region: from far, off saddles, within the bounds."""

from itertools import pairwise, product

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.spatial.distance import pdist

from jaxgrow.energy.pair import pair_energy
from jaxgrow.energy.parameters import Parameters
from jaxgrow.equilibrium.linear_response import linear_response
from jaxgrow.equilibrium.problem import Problem
from jaxgrow.equilibrium.refresh_lists import allocate_lists
from jaxgrow.equilibrium.relax import relax
from jaxgrow.equilibrium.trust_region import descend_by_trust
from jaxgrow.growth.collision_broad_phase import CollisionFinder
from jaxgrow.mesh.proximity import closest_on_triangles
from jaxgrow.runtime.results import Result
from jaxgrow.state import Nodes
from jaxgrow.transfer.device import put_particles


PARAMETERS = jax.tree.map(lambda v: jnp.asarray(v, float), Parameters())

EACH = 40
"""Hessian products up to which every iterate is looked at."""

compiled = eqx.filter_jit(descend_by_trust)


@eqx.filter_jit
def total_energy(problem, lists):
    return problem.energy(problem.nodes(), lists)


def energy(particles, membrane=None):
    problem = Problem(particles, membrane, PARAMETERS)
    return float(total_energy(problem, allocate_lists(problem)))


def pairs_alone(particles):
    """Their energy by the sum over all pairs."""
    count = particles.position.shape[0]
    index = np.arange(count)
    every = jnp.asarray((index[None, :] + index[1:, None]) % count)
    return float(pair_energy(particles, every, PARAMETERS))


def iterates(problem, products, tolerance=1e-12, lists=None):
    """The states after the given numbers of Hessian products, each of them once."""
    if lists is None:
        lists = allocate_lists(problem)
    last = None
    for most in products:
        limits = jnp.asarray(tolerance), jnp.asarray(most), jnp.asarray(0.1)
        outcome = compiled(problem, lists, *limits)
        assert Result.of(outcome.code) in (Result.STEP_LIMIT, Result.CONVERGED)
        assert outcome.steps <= most
        if last is None or outcome.residual != last.residual:
            yield outcome
        last = outcome
        if Result.of(outcome.code) is Result.CONVERGED:
            return


@pytest.fixture(scope="module")
def ball():
    """200 particles: the inner part of a face-centred lattice, jittered by 0.1 r0."""
    index = np.arange(-6, 7)
    lattice = np.stack(np.meshgrid(index, index, index), -1).reshape(-1, 3)
    lattice = lattice[lattice.sum(axis=1) % 2 == 0]
    nearest = np.argsort((lattice**2).sum(axis=1), kind="stable")[:200]
    jitter = 0.1 * np.random.default_rng(0).normal(size=(200, 3))
    position = lattice[nearest] * (0.96 / np.sqrt(2)) + jitter
    return put_particles(position, np.zeros(200, int), np.zeros(200, bool), 200)


@pytest.fixture(scope="module")
def crowded(ball):
    """Iterates of the ball's relaxation to the rounding of its forces."""
    problem = Problem(ball, None, PARAMETERS)
    lists = allocate_lists(problem, relax(ball).lists)
    return list(iterates(problem, range(1, 400), 1e-13, lists))


# from far


def test_it_reaches_a_strict_minimum_from_far(ball):
    outcome = relax(ball, tolerance=1e-8, method="newton")
    assert outcome.result is Result.CONVERGED
    assert outcome.stats.method == "newton"
    assert 0 < outcome.stats.residual <= 1e-8
    assert energy(outcome.state[0]) < energy(ball) - 2
    nothing = Nodes(jnp.zeros_like(ball.position), None)
    found = linear_response(outcome.state[0], forces=nothing)
    assert found.result is Result.CONVERGED
    assert found.null_modes == 6
    assert found.softest > 0.01


def test_convergence_is_superlinear(crowded):
    residuals = np.array([float(o.residual) for o in crowded])
    assert residuals[0] > 0.1
    assert residuals[-1] <= 1e-13
    before, after = residuals[:-1], residuals[1:]
    near = (before < 1e-3) & (before > 1e-11)
    assert near.sum() >= 3
    # systems are solved to the square root of the residual
    assert np.all(after[near] <= 5 * before[near] ** 1.4), residuals


def test_energy_falls_in_every_iteration(ball, crowded):
    energies = [pairs_alone(ball)]
    for outcome in crowded:
        moved = eqx.tree_at(lambda p: p.position, ball, outcome.nodes.particles)
        energies.append(pairs_alone(moved))
    assert len(energies) > 10
    assert np.all(np.diff(energies) < 1e-13 * abs(energies[-1]))


@pytest.mark.parametrize("seed", range(3))
def test_it_comes_to_rest_from_anywhere(make_particles, seed):
    rng = np.random.default_rng(seed)
    start = make_particles(rng.uniform(0, 3, (60, 3)))  # two and more per r0³
    outcome = relax(start, tolerance=1e-10, method="newton")
    assert outcome.result is Result.CONVERGED
    assert outcome.stats.steps < 1500


def test_bound_on_the_products_is_kept(ball):
    outcome = relax(ball, tolerance=1e-8, method="newton", max_steps=7)
    assert outcome.result is Result.STEP_LIMIT
    assert outcome.stats.steps == 7
    assert energy(outcome.state[0]) < energy(ball)


def test_equilibrium_is_left_as_it_is(cluster):
    rest = relax(cluster, tolerance=1e-6)
    outcome = relax(*rest.state, tolerance=1e-5, method="newton")
    assert outcome.result is Result.CONVERGED
    assert outcome.stats.steps == 0
    np.testing.assert_array_equal(outcome.state[0].position, rest.state[0].position)


# saddles


def test_it_leaves_a_particle_between_two_by_its_side(make_particles):
    # compressed between two held ones, on their line but for a billionth
    position = np.array([[-0.8, 0, 0], [0.05, 1e-9, 0], [0.8, 0, 0]])
    start = make_particles(position, np.array([True, False, True]))
    saddle = eqx.tree_at(lambda p: p.position, start, start.position.at[1].set(0.0))
    outcome = relax(start, tolerance=1e-10, method="newton")
    assert outcome.result is Result.CONVERGED
    assert energy(outcome.state[0]) < energy(saddle) - 0.01
    np.testing.assert_allclose(outcome.state[0].position[1], [0, 0.6, 0], atol=1e-8)


def test_it_leaves_the_saddle_of_a_symmetric_cluster(make_particles):
    # a cuboctahedron around a particle turns into an icosahedron
    corners = [v for v in product((-1, 0, 1), repeat=3) if sum(map(abs, v)) in (0, 2)]
    position = np.array(corners) / np.sqrt(2)
    saddle = relax(make_particles(position), tolerance=1e-13, method="lbfgs")
    nothing = Nodes(jnp.zeros_like(saddle.state[0].position), None)
    response = linear_response(saddle.state[0], forces=nothing)
    assert response.result is Result.SINGULAR
    noise = 1e-9 * np.random.default_rng(0).normal(size=position.shape)
    outcome = relax(make_particles(position + noise), tolerance=1e-12, method="newton")
    assert outcome.result is Result.CONVERGED
    assert energy(outcome.state[0]) < energy(saddle.state[0]) - 1e-3
    response = linear_response(outcome.state[0], forces=nothing)
    assert response.result is Result.CONVERGED


# particles and membrane


def test_minimum_is_that_of_lbfgs_where_there_is_one(bed):
    # near it the energy is convex
    near = relax(*bed, tolerance=1e-3, method="lbfgs").state
    ends = [relax(*near, tolerance=1e-11, method=m) for m in ("newton", "lbfgs")]
    assert all(end.result is Result.CONVERGED for end in ends)
    found, known = (energy(*end.state) for end in ends)
    assert found == pytest.approx(known, abs=1e-12)
    assert found < energy(*near) - 1e-6
    for leaf in ("position", "vertices"):
        one, other = (
            next(getattr(part, leaf) for part in end.state if hasattr(part, leaf))
            for end in ends
        )
        np.testing.assert_allclose(one, other, atol=1e-8)


@pytest.fixture(scope="module")
def daughter(make_particles, make_membrane):
    """Iterates after a birth a millionth of r0 under the membrane, and the faces."""
    rng = np.random.default_rng(1)
    floor = rng.uniform([-2.2, -2.2, -2.0], [2.2, 2.2, -0.5], (49, 3))
    position = np.concatenate([[[0.0, 0.0, -1e-6]], floor])
    particles = make_particles(position, position[:, 2] < -1.6)
    problem = Problem(particles, make_membrane(), PARAMETERS)
    membrane = problem.membrane
    faces = np.asarray(membrane.faces)[np.asarray(membrane.face_alive)]
    lists = relax(particles, membrane).lists  # room enough for all of the way
    lists = allocate_lists(problem, lists)
    found = iterates(problem, [*range(1, EACH), 400], 1e-6, lists)
    return problem, faces, list(found)


def test_no_node_moves_by_half_of_its_distance_to_what_it_must_not_cross(daughter):
    problem, faces, outcomes = daughter
    assert Result.of(outcomes[-1].code) is Result.CONVERGED
    steps = [problem.nodes(), *[o.nodes for o in outcomes[:-1]]]
    assert len(steps) > 15
    for before, after in pairwise(steps):
        old, corners = np.asarray(before.particles)[:50], np.asarray(before.vertices)
        table, _ = closest_on_triangles(
            np.repeat(old, len(faces), axis=0), np.tile(corners[faces], (50, 1, 1))
        )
        table = table.reshape(50, len(faces))
        clearance = np.full(len(corners), np.inf)
        np.minimum.at(clearance, faces.ravel(), np.repeat(table.min(axis=0), 3))
        moves = np.asarray(after.particles)[:50] - old, after.vertices - corners
        for move, near in zip(moves, (table.min(axis=1), clearance), strict=True):
            length = np.linalg.norm(move, axis=1)
            assert np.all(length <= np.minimum(0.4 * near, 0.1) * (1 + 1e-9) + 1e-15)


def test_what_is_born_under_the_membrane_stays_under_it(daughter):
    problem, _, outcomes = daughter
    last = problem.at(outcomes[-1].nodes)
    inner = np.asarray(last.membrane.free)
    position = np.asarray(last.particles.position)[:50]
    # the grid is so flat that heights tell the sides
    assert position[:, 2].max() < np.asarray(last.membrane.vertices)[inner, 2].min()
    assert position[0, 2] < -0.1


def test_what_is_held_pinned_or_dead_stays_to_the_bit(daughter):
    problem, _, outcomes = daughter
    before, after = problem.nodes(), outcomes[-1].nodes
    for leaf, on in (
        ("particles", problem.particles.free),
        ("vertices", problem.membrane.free),
    ):
        still = ~np.asarray(on)
        first, last = getattr(before, leaf), getattr(after, leaf)
        np.testing.assert_array_equal(last[still], first[still])
        assert np.abs(last - first)[~still].max() > 0.01


def test_particle_on_the_membrane_is_a_result(make_particles, make_membrane):
    position = np.array([[0.2, 0.3, 0.0], [0.0, 0.0, -1.0]])
    outcome = relax(make_particles(position), make_membrane(), method="newton")
    assert outcome.result is Result.ON_MEMBRANE


# lists


def test_list_that_overflows_on_the_way_is_made_anew(ball):
    # jitter makes room, which is gone when the ball has contracted
    outcome = relax(ball, tolerance=1e-8, method="newton")
    assert outcome.result is Result.CONVERGED
    assert outcome.stats.overflows >= 1
    again = relax(ball, tolerance=1e-8, method="newton", lists=outcome.lists)
    assert again.stats.overflows == 0
    found, known = (pdist(end.state[0].position) for end in (outcome, again))
    np.testing.assert_allclose(found, known, atol=1e-6)


def test_collisions_are_listed_anew_on_the_way(make_membrane, load):
    # a vertex pulled far out: the skin of the list holds for 0.2 r0
    membrane = make_membrane()
    surface = np.full(int(membrane.vertex_alive.sum()), -1)
    collide = CollisionFinder.of(membrane, surface, None, Parameters())
    listed = []

    def lister(vertices, before):
        listed.append(vertices)
        return collide(vertices, before)

    outcome = relax(
        None, membrane, load=load(24, [0, 0, 0.5]), method="newton", collide=lister
    )
    assert outcome.result is Result.CONVERGED
    assert outcome.state[1].vertices[24, 2] > 1
    assert len(listed) > 3

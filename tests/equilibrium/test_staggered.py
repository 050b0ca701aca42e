"""The paper's turns of tissue and surface: where they converge, and where not."""

from itertools import pairwise

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxgrow.energy.parameters import Parameters
from jaxgrow.equilibrium.linear_response import linear_response
from jaxgrow.equilibrium.problem import Problem
from jaxgrow.equilibrium.refresh_lists import allocate_lists
from jaxgrow.equilibrium.relax import relax
from jaxgrow.mesh.proximity import closest_on_triangles
from jaxgrow.runtime.results import Result
from jaxgrow.state import Nodes


TAUT = Parameters(spring_stiffness=3.0, pretension=0.5)
"""Springs that are stiffer than what presses on them."""

SOFT = Parameters(spring_stiffness=0.03, pretension=0.02)
"""Springs just reset that dead loads throw away."""

TOLERANCE = 1e-8


@eqx.filter_jit
def forces(problem, lists):
    return problem.forces(problem.nodes(), lists)


def largest_force(state, parameters, load=None):
    """On what may move."""
    problem = Problem.of(*state, parameters, load)
    force = forces(problem, allocate_lists(problem))
    each = jax.tree.map(
        lambda f, on: np.linalg.norm(f * on, axis=1).max(), force, problem.free()
    )
    return max(jax.tree.leaves(each))


@pytest.fixture(scope="module")
def resting(bed):
    return relax(*bed, parameters=TAUT, tolerance=1e-10).state


def test_under_a_taut_membrane_they_reach_the_equilibrium_of_both(resting, load):
    push = load(24, [0.02, 0, -0.05])
    turns, known = (
        relax(*resting, parameters=TAUT, tolerance=TOLERANCE, load=push, method=method)
        for method in ("staggered", "lbfgs")
    )
    assert turns.result is known.result is Result.CONVERGED
    assert turns.stats.method == "staggered"
    assert turns.stats.residual <= TOLERANCE
    assert largest_force(turns.state, TAUT, push) <= TOLERANCE * (1 + 1e-6)
    nothing = Nodes(*(jnp.zeros_like(x) for x in (turns.forces.particles, push)))
    response = linear_response(*known.state, parameters=TAUT, load=push, forces=nothing)
    assert response.result is Result.CONVERGED
    # forces of a tolerance on all of 100 nodes move the softest mode by this
    bound = 2 * 10 * TOLERANCE / response.softest
    for part, leaf in ((0, "position"), (1, "vertices")):
        found, wanted, start = (
            np.asarray(getattr(state[part], leaf))
            for state in (turns.state, known.state, resting)
        )
        np.testing.assert_allclose(found, wanted, atol=bound)
        assert np.abs(wanted - start).max() > 100 * bound


@pytest.fixture(scope="module")
def thrown(bed):
    """What becomes of the bed under a soft membrane, and its state in every turn."""
    seen = []
    outcome = relax(
        *bed, parameters=SOFT, method="staggered", max_steps=1500, observe=seen.append
    )
    return outcome, seen


def test_under_a_soft_membrane_they_do_not_come_to_rest(bed, thrown):
    outcome, seen = thrown
    assert outcome.result is Result.STEP_LIMIT
    assert outcome.stats.steps <= 1500
    assert outcome.stats.residual > 1e-3
    assert len(seen) > 5
    together = relax(*bed, parameters=SOFT, method="lbfgs")
    assert together.result is Result.CONVERGED


def test_state_that_is_returned_is_the_one_that_is_reported(thrown):
    outcome, seen = thrown
    residual = largest_force(outcome.state, SOFT)
    assert residual == pytest.approx(outcome.stats.residual, rel=1e-9)
    np.testing.assert_array_equal(outcome.state[0].position, seen[-1].particles)
    np.testing.assert_array_equal(outcome.state[1].vertices, seen[-1].vertices)


def test_vertices_move_by_less_than_half_of_their_distance_to_the_particles(
    bed, thrown
):
    faces = np.asarray(bed[1].faces)[np.asarray(bed[1].face_alive)]
    alive = np.asarray(bed[0].alive)
    longest = 0.0
    for before, after in pairwise(thrown[1]):
        points, corners = np.asarray(before.particles)[alive], before.vertices[faces]
        distance, _ = closest_on_triangles(
            np.repeat(points, len(faces), axis=0),
            np.tile(np.asarray(corners), (len(points), 1, 1)),
        )
        nearest = distance.reshape(len(points), len(faces)).min(axis=0)
        clearance = np.full(len(before.vertices), np.inf)
        np.minimum.at(clearance, faces.ravel(), np.repeat(nearest, 3))
        move = np.linalg.norm(after.vertices - before.vertices, axis=1)
        assert np.all(move <= np.minimum(0.4 * clearance, 0.1) * (1 + 1e-9))
        longest = max(longest, move.max())
    assert longest == pytest.approx(0.1)  # they would have gone farther


def test_a_vertex_that_is_pressed_onto_a_particle_does_not_pass_it(
    make_particles, make_membrane, load
):
    held = make_particles([[0.0, 0.0, -0.05], [0.0, 0.0, -2.0]], [True, False])
    gaps = []
    relax(
        held,
        make_membrane(),
        parameters=TAUT,
        method="staggered",
        load=load(24, [0, 0, -5.0]),
        max_steps=1000,
        observe=lambda nodes: gaps.append(float(nodes.vertices[24, 2]) + 0.05),
    )
    ratios = np.array(gaps[1:]) / np.array(gaps[:-1])
    # the load presses it down, and the barrier throws it up
    assert ratios.min() == pytest.approx(0.6, abs=0.01)
    assert ratios.max() == pytest.approx(1.4, abs=0.01)
    assert min(gaps) > 0


def test_no_particle_is_beyond_the_membrane_in_any_turn(bed, thrown):
    alive, inner = np.asarray(bed[0].alive), np.asarray(bed[1].vertex_alive)
    for nodes in thrown[1]:
        highest = np.asarray(nodes.particles)[alive, 2].max()
        assert highest < np.asarray(nodes.vertices)[inner, 2].min()


def test_what_is_held_pinned_or_dead_stays_to_the_bit(bed, thrown):
    for before, after, leaf in zip(
        bed, thrown[0].state, ("position", "vertices"), strict=True
    ):
        still = ~np.asarray(before.free)
        np.testing.assert_array_equal(
            getattr(after, leaf)[still], getattr(before, leaf)[still]
        )
        np.testing.assert_array_equal(after.free, before.free)


def test_particle_on_the_membrane_is_a_result(make_particles, make_membrane):
    position = np.array([[0.2, 0.3, 0.0], [0.0, 0.0, -1.0]])
    outcome = relax(make_particles(position), make_membrane(), method="staggered")
    assert outcome.result is Result.ON_MEMBRANE


def test_position_that_is_not_finite_is_a_result(bed):
    broken = eqx.tree_at(
        lambda p: p.position, bed[0], bed[0].position.at[7].set(jnp.nan)
    )
    assert relax(broken, bed[1], method="staggered").result is Result.NON_FINITE


@pytest.mark.parametrize("without", ["particles", "membrane"])
def test_it_is_for_particles_and_a_membrane(bed, without):
    state = (None, bed[1]) if without == "particles" else (bed[0], None)
    with pytest.raises(ValueError, match="'staggered', which is for particles and a"):
        relax(*state, method="staggered")

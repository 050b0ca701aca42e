"""Linear response against the dense Hessian, its null modes, and every failure."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from jax.flatten_util import ravel_pytree

from jaxgrow.energy.parameters import Parameters
from jaxgrow.equilibrium import hessian_solve as response
from jaxgrow.equilibrium.hessian_solve import linearise, respond, solve
from jaxgrow.equilibrium.problem import Problem
from jaxgrow.equilibrium.refresh_lists import allocate_lists
from jaxgrow.equilibrium.relax import relax
from jaxgrow.runtime.results import Result
from jaxgrow.state import Nodes

from ..quick_jit import quick_jit
from .springs import springs


PARAMETERS = jax.tree.map(lambda v: jnp.asarray(v, float), Parameters())


@quick_jit
def answer(problem, lists, force):
    return respond(linearise(problem, lists), force)


@quick_jit
def product(problem, lists, vector):
    return linearise(problem, lists).product(vector)


@quick_jit
def hessian(problem, lists):
    """Second derivatives of the energy, all of them."""
    flat, shaped = ravel_pytree(problem.nodes())
    return jax.hessian(lambda x: problem.energy(shaped(x), lists))(flat)


def as_problem(particles, membrane=None, parameters=PARAMETERS, load=None):
    """A problem where it is, and its lists."""
    problem = Problem(particles, membrane, parameters, load)
    return problem, allocate_lists(problem)


def at_rest(particles, membrane=None, parameters=PARAMETERS, load=None):
    """A problem at its equilibrium, and its lists."""
    outcome = relax(
        particles, membrane, parameters=parameters, tolerance=1e-11, load=load
    )
    assert outcome.result is Result.CONVERGED
    return as_problem(*outcome.state, parameters, load)


def any_force(problem, seed=0):
    """A force on every row, padding included."""
    rng = np.random.default_rng(seed)
    return jax.tree.map(
        lambda x: jnp.asarray(rng.normal(size=x.shape), x.dtype), problem.nodes()
    )


def flat(nodes):
    return np.asarray(ravel_pytree(nodes)[0])


def mask(problem):
    """Of the coordinates that may move."""
    return flat(problem.free()) > 0


def isolated(problem, dense):
    """The part of a dense Hessian that belongs to what may move."""
    on = mask(problem)
    return np.asarray(dense)[np.ix_(on, on)]


@pytest.fixture(scope="module")
def drop(make_particles):
    """A free cluster of 27 particles."""
    rng = np.random.default_rng(1)
    return at_rest(make_particles(rng.uniform(0, 3, (27, 3))))


@pytest.fixture(scope="module")
def scenes(cluster, bed, drop):
    """Equilibria with held particles, of both kinds of nodes, and of a free cluster.

    Each with the free part of its dense Hessian.
    """
    found = {"held": at_rest(cluster), "both": at_rest(*bed), "free": drop}
    return {
        name: (problem, lists, isolated(problem, hessian(problem, lists)))
        for name, (problem, lists) in found.items()
    }


# against the dense Hessian


@pytest.mark.parametrize("name", ["held", "both", "free"])
def test_product_is_that_of_the_dense_hessian(scenes, name):
    problem, lists, dense = scenes[name]
    vector, on = any_force(problem), mask(problem)
    wanted = np.zeros(len(on))
    wanted[on] = dense @ flat(vector)[on]
    found = flat(product(problem, lists, vector))
    np.testing.assert_allclose(found, wanted, atol=1e-13 * np.abs(wanted).max())


@pytest.mark.parametrize("name", ["held", "both", "free"])
def test_product_is_symmetric(scenes, name):
    problem, lists, _ = scenes[name]
    one, other = any_force(problem, 1), any_force(problem, 2)
    first = flat(one) @ flat(product(problem, lists, other))
    second = flat(other) @ flat(product(problem, lists, one))
    assert first == pytest.approx(second, rel=1e-12)


@pytest.mark.parametrize("name", ["held", "both", "free"])
def test_response_is_the_inverse_of_the_dense_hessian(scenes, name):
    problem, lists, dense = scenes[name]
    force, on = any_force(problem), mask(problem)
    found = answer(problem, lists, force)
    assert Result.of(found.code) is Result.CONVERGED
    assert found.residual <= 1e-9
    wanted = np.zeros(len(on))
    inverse = np.linalg.pinv(dense, rcond=1e-9, hermitian=True)
    wanted[on] = inverse @ flat(force)[on]
    error = np.linalg.norm(flat(found.nodes) - wanted) / np.linalg.norm(wanted)
    assert error <= 1e-8
    assert not flat(found.nodes)[~on].any()


@pytest.mark.parametrize("name", ["held", "both", "free"])
def test_softest_curvature_bounds_the_lowest_eigenvalue_from_above(scenes, name):
    problem, lists, dense = scenes[name]
    found = answer(problem, lists, any_force(problem))
    values = np.linalg.eigvalsh(dense)
    lowest = values[values > 1e-9].min()
    assert lowest <= found.softest <= 10 * lowest


def test_coarse_response_takes_fewer_products(scenes):
    problem, lists, _ = scenes["held"]

    def solved(relative):
        compiled = quick_jit(lambda *p, f: solve(linearise(*p), f, relative))
        return compiled(problem, lists, f=any_force(problem))

    coarse, fine = solved(1e-3), solved(None)
    assert coarse.products < fine.products
    assert 1e-8 < coarse.residual <= 1e-2
    assert Result.of(coarse.code) is Result.CONVERGED


def test_response_of_a_spring_is_force_over_stiffness(load):
    # pinned by two springs in a line, 0.3 each; across it their tension holds
    row = jnp.asarray([[0, 0, 0], [1.1, 0, 0], [2.2, 0, 0]])
    chain = springs(row, [[0, 1], [1, 2]], 1.0, [True, False, True])
    stiff = eqx.tree_at(
        lambda p: (p.spring_stiffness, p.pretension),
        PARAMETERS,
        (jnp.asarray(0.3), jnp.asarray(0.0)),
    )
    problem, lists = at_rest(None, chain, stiff)
    found = answer(problem, lists, Nodes(None, load(1, [0.1, 0.2, 0])))
    wanted = [0.1 / (2 * 0.3), 0.2 / (2 * 0.3 * 0.1 / 1.1), 0]
    np.testing.assert_allclose(found.nodes.vertices[1], wanted, atol=1e-10)


# null modes


CORNERS = [[0, 0, 0], [0.9, 0.1, 0], [0.4, 0.9, 0.1], [0.5, 0.3, 0.8]]
LINE = [[0, 0, 0], [1, 0, 0]]
FAR = [[9, 9, 9], [-9, 9, 9]]


@pytest.mark.parametrize(
    "position, held, count",
    [
        (CORNERS[:1], 0, 3),
        (CORNERS[:2], 0, 5),
        (CORNERS[:3], 0, 6),
        (CORNERS, 0, 6),
        (CORNERS[:2] + FAR[:1], 0, 8),
        (CORNERS + FAR, 0, 12),
        (CORNERS, 3, 0),
        (CORNERS + FAR, 3, 6),
    ],
    ids=[
        "loner",
        "dimer",
        "trimer",
        "tetramer",
        "dimer and loner",
        "tetramer and loners",
        "held",
        "held and loners",
    ],
)
def test_null_modes_are_counted(make_particles, position, held, count):
    particles = make_particles(position, np.arange(len(position)) < held)
    problem, lists = at_rest(particles)
    found = answer(problem, lists, any_force(problem))
    assert Result.of(found.code) is Result.CONVERGED
    assert found.null_modes == count
    values = np.linalg.eigvalsh(isolated(problem, hessian(problem, lists)))
    assert np.sum(np.abs(values) < 1e-9) == count


def test_pinned_membrane_has_no_null_modes(make_membrane):
    problem, lists = at_rest(None, make_membrane())
    found = answer(problem, lists, any_force(problem))
    assert Result.of(found.code) is Result.CONVERGED
    assert found.null_modes == 0


def test_held_particles_hold_the_membrane_and_pins_the_particles(scenes):
    problem, lists, _ = scenes["both"]
    assert answer(problem, lists, any_force(problem)).null_modes == 0


def test_free_cluster_neither_shifts_nor_turns(drop):
    problem, lists = drop
    found = answer(problem, lists, any_force(problem)).nodes.particles
    found, position = np.asarray(found)[:27], np.asarray(problem.particles.position)
    arm = position[:27] - position[:27].mean(axis=0)
    assert np.abs(found).max() > 1
    np.testing.assert_allclose(found.sum(axis=0), 0, atol=1e-11)
    np.testing.assert_allclose(np.cross(arm, found).sum(axis=0), 0, atol=1e-11)


def test_force_that_only_shifts_or_turns_gets_no_response(drop):
    problem, lists = drop
    position = problem.particles.position
    whirl = jnp.cross(jnp.asarray([[0.3, -0.5, 1.0]]), position) + 2.0
    found = answer(problem, lists, Nodes(whirl, None))
    np.testing.assert_allclose(found.nodes.particles, 0, atol=1e-10)


def test_load_holds_the_direction_of_a_free_spring(load):
    # ±(f, 0, 0) keeps it along x with the length l; ±(0, g, 0) turns it by g / f
    stiffness, rest, pull, push = 0.5, 1.0, 0.2, 1e-3
    parameters = eqx.tree_at(
        lambda p: (p.spring_stiffness, p.pretension),
        PARAMETERS,
        (jnp.asarray(stiffness), jnp.asarray(0.0)),
    )
    length = rest + pull / stiffness
    ends = jnp.asarray([[0, 0, 0], [length, 0, 0]])
    spring = springs(ends, [[0, 1]], rest, [False, False])
    pulled = load(1, [pull, 0, 0]) - load(0, [pull, 0, 0])
    problem, lists = at_rest(None, spring, parameters, pulled)
    across = load(1, [0, push, 0]) - load(0, [0, push, 0])
    found = answer(problem, lists, Nodes(None, across))
    assert Result.of(found.code) is Result.CONVERGED
    assert found.null_modes == 3
    turned = 0.5 * length * push / pull
    np.testing.assert_allclose(found.nodes.vertices[1], [0, turned, 0], atol=1e-12)
    np.testing.assert_allclose(found.nodes.vertices[0], [0, -turned, 0], atol=1e-12)


# failures


def column(make_particles, height):
    """A particle in the middle between two held ones."""
    position = [[0, 0, 0], [height / 2, 0, 0], [height, 0, 0]]
    return at_rest(make_particles(position, np.array([True, False, True])))


@pytest.mark.parametrize(
    "push", [[0.1, 0, 0], [0, 0.1, 0], [0, 0, 0]], ids=["along", "across", "none"]
)
def test_compressed_column_is_singular_whatever_pushes_it(make_particles, push):
    # pushed along its axis, conjugate gradients alone would not see that it buckles
    problem, lists = column(make_particles, 1.7)
    force = Nodes(jnp.zeros((64, 3)).at[1].set(jnp.asarray(push, float)), None)
    found = answer(problem, lists, force)
    assert Result.of(found.code) is Result.SINGULAR
    assert found.softest < 0
    assert np.isnan(found.nodes.particles).all()


def test_stretched_column_is_stable(make_particles):
    problem, lists = column(make_particles, 2.2)
    found = answer(problem, lists, any_force(problem))
    assert Result.of(found.code) is Result.CONVERGED


@pytest.mark.parametrize(
    "position",
    [
        [[0, 0, 0], [1, 0, 0], [2, 0, 0]],
        [*CORNERS, *(np.array(CORNERS) + 9)],
    ],
    ids=["hinge", "two tetramers"],
)
def test_further_null_modes_are_singular(make_particles, position):
    problem, lists = at_rest(make_particles(position))
    found = answer(problem, lists, any_force(problem))
    assert Result.of(found.code) is Result.SINGULAR
    assert np.isnan(found.nodes.particles).all()


def test_solution_that_is_not_reached_is_a_result(scenes, monkeypatch):
    problem, lists, _ = scenes["held"]
    monkeypatch.setattr(response, "MAX_PRODUCTS", 5)
    respond_now = quick_jit(lambda *p, f: respond(linearise(*p), f))
    found = respond_now(problem, lists, f=any_force(problem))
    assert Result.of(found.code) is Result.NOT_SOLVED
    assert found.products == 10
    assert found.residual > 1e-3
    assert np.isnan(found.nodes.particles).all()


@pytest.mark.parametrize("value", [np.nan, np.inf])
def test_force_that_is_not_finite_is_not_solved(scenes, value):
    problem, lists, _ = scenes["held"]
    force = eqx.tree_at(
        lambda f: f.particles,
        any_force(problem),
        replace_fn=lambda f: f.at[1].set(value),
    )
    found = answer(problem, lists, force)
    assert Result.of(found.code) is Result.NOT_SOLVED
    assert np.isnan(found.nodes.particles).all()


# the rest


def test_no_force_gives_no_response(scenes):
    problem, lists, _ = scenes["both"]
    found = answer(problem, lists, jax.tree.map(jnp.zeros_like, problem.nodes()))
    assert Result.of(found.code) is Result.CONVERGED
    assert found.residual == 0
    assert not flat(found.nodes).any()


def test_forces_on_what_may_not_move_change_nothing(scenes):
    problem, lists, _ = scenes["both"]
    force, free = any_force(problem), problem.free()
    strong = jax.tree.map(lambda f, on: jnp.where(on > 0, f, 1e6), force, free)
    first, second = answer(problem, lists, force), answer(problem, lists, strong)
    np.testing.assert_array_equal(flat(first.nodes), flat(second.nodes))


def test_padding_changes_no_bit(drop, make_particles):
    problem, lists = drop
    force = any_force(problem)
    moved = eqx.tree_at(
        lambda p: p.particles.position,
        problem,
        problem.particles.position.at[27:].add(3.0),
    )
    first, second = answer(problem, lists, force), answer(moved, lists, force)
    np.testing.assert_array_equal(first.nodes.particles, second.nodes.particles)


def test_single_precision_is_kept(drop):
    def single(tree):
        return jax.tree.map(
            lambda a: a.astype(jnp.float32) if eqx.is_inexact_array(a) else a, tree
        )

    problem, lists = drop
    force = any_force(problem)
    exact = answer(problem, lists, force)
    narrow = single(problem)
    found = answer(narrow, allocate_lists(narrow), single(force))
    assert Result.of(found.code) is Result.CONVERGED
    assert found.null_modes == 6
    assert found.nodes.particles.dtype == jnp.float32
    error = np.linalg.norm(flat(found.nodes) - flat(exact.nodes))
    assert error <= 1e-2 * np.linalg.norm(flat(exact.nodes))

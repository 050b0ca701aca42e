"""The loop of conjugate gradients finds what XLA's does."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxgrow.energy.parameters import Parameters
from jaxgrow.equilibrium import hessian_solve as response
from jaxgrow.equilibrium.hessian_solve import linearise, probe, solve
from jaxgrow.equilibrium.loops import with_loops
from jaxgrow.equilibrium.problem import Problem
from jaxgrow.equilibrium.relax import relax
from jaxgrow.runtime.results import Result

from ..quick_jit import quick_jit


@pytest.fixture(scope="module", params=["bed", "drop", "sheet"])
def scene(request, bed, make_particles, make_membrane):
    """A pinned bed, a drop with six rigid modes, a sheet."""
    rng = np.random.default_rng(3)
    drop = make_particles(rng.uniform(0, 3, (40, 3)))
    bodies = {"bed": bed, "drop": (drop, None), "sheet": (None, make_membrane())}
    outcome = relax(*bodies[request.param], tolerance=1e-12)
    assert outcome.result is Result.CONVERGED
    return Problem.of(*outcome.state, Parameters()), outcome.lists


def answers(problem, lists, force):
    linear = linearise(problem, lists)
    return solve(linear, force), probe(linear)


def has_loop(problem, lists):
    """Whether the loop answers; traced, as hundreds of operations would be compiled."""
    return eqx.filter_eval_shape(
        lambda *inputs: linearise(*inputs).respond is not None, problem, lists
    )


solved = eqx.filter_jit(answers)
reference = quick_jit(answers)


def force_on(problem, seed=0):
    rng = np.random.default_rng(seed)
    return jax.tree.map(
        lambda x: jnp.asarray(rng.normal(size=x.shape)), problem.nodes()
    )


def test_response_is_that_of_the_program(scene):
    problem, lists = scene
    looped = with_loops(problem, lists, products=True)
    assert has_loop(looped, lists)
    assert not has_loop(problem, lists)
    force = force_on(problem)
    found = solved(looped, lists, force)[0]
    wanted = reference(problem, lists, force)[0]
    assert int(found.code) == int(wanted.code) == Result.CONVERGED.code
    assert int(found.null_modes) == int(wanted.null_modes)
    assert float(found.residual) < 1e-9
    for a, b in zip(*map(jax.tree.leaves, (found.nodes, wanted.nodes)), strict=True):
        np.testing.assert_allclose(a, b, atol=1e-7 * float(jnp.abs(b).max()))


def test_diagonal_blocks_save_products(bed):
    # with the mean stiffness of each node in their place it takes 100
    outcome = relax(*bed, tolerance=1e-12)
    problem = Problem.of(*outcome.state, Parameters())
    looped = with_loops(problem, outcome.lists, products=True)
    found = solved(looped, outcome.lists, force_on(problem))[0]
    assert int(found.code) == Result.CONVERGED.code
    assert int(found.products) < 85


def test_minimum_is_proved_as_by_the_program(scene):
    problem, lists = scene
    looped = with_loops(problem, lists, products=True)
    force = force_on(problem)
    found = solved(looped, lists, force)[1]
    wanted = reference(problem, lists, force)[1]
    assert int(found.code) == int(wanted.code) == Result.CONVERGED.code


def test_saddle_is_not_proved_a_minimum(make_particles):
    # three in a row that repel each other: the middle one gives way sideways
    row = make_particles([[0, 0, 0], [0.999, 0, 0], [1.998, 0, 0]])
    squeezed = row.at(0.9 * row.position)
    problem = Problem.of(squeezed, None, Parameters())
    lists = relax(row, max_steps=1).lists
    looped = with_loops(problem, lists, products=True)
    found = solved(looped, lists, force_on(problem))[1]
    wanted = reference(problem, lists, force_on(problem))[1]
    assert int(found.code) == int(wanted.code) == Result.SINGULAR.code
    assert all(bool(jnp.isnan(x).all()) for x in jax.tree.leaves(found.nodes))


def test_bound_on_products_is_kept(make_particles, monkeypatch):
    rng = np.random.default_rng(3)
    drop = make_particles(rng.uniform(0, 3, (40, 3)))
    outcome = relax(drop, tolerance=1e-12)
    problem, lists = Problem.of(*outcome.state, Parameters()), outcome.lists
    monkeypatch.setattr(response, "MAX_PRODUCTS", 9)
    looped = with_loops(problem, lists, products=True)
    found = eqx.filter_jit(lambda p, f: solve(linearise(p, lists), f))(
        looped, force_on(problem)
    )
    assert int(found.code) == Result.NOT_SOLVED.code
    assert int(found.products) <= 9

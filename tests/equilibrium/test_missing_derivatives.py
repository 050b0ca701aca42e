"""Equilibria that have no derivative, or whose system is not solved: all is NaN."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from jaxgrow.equilibrium import hessian_solve as response, implicit_diff as implicit
from jaxgrow.equilibrium.problem import Problem
from jaxgrow.state import Nodes

from .derivatives import backward, flat, forward, PARAMETERS, rest, settled, still


def failing(problem, **options):
    """Both derivatives in all floats of a problem that has none."""
    tangent = jax.tree.map(jnp.ones_like, still(problem))
    _, pushed = eqx.filter_jvp(lambda p: rest(p, **options), (problem,), (tangent,))

    def total(problem):
        return sum(jnp.sum(x) for x in jax.tree.leaves(rest(problem, **options)))

    pulled = eqx.filter(eqx.filter_grad(total)(problem), eqx.is_inexact_array)
    return np.concatenate([flat(pushed), flat(pulled)])


def test_equilibrium_that_was_not_reached_has_no_derivative(cluster):
    problem = Problem(cluster, None, PARAMETERS)
    assert np.isnan(failing(problem, max_steps=1)).all()


def test_equilibrium_that_was_nearly_reached_has_no_derivative(cage):
    # its Hessian is that of a minimum, so nothing else tells
    near = eqx.tree_at(lambda p: p.parameters.adhesion, cage, jnp.asarray(0.21))
    assert np.isnan(failing(near, max_steps=1, method="lbfgs")).all()


def test_compressed_column_has_no_derivative(make_particles):
    # a push on its end, along its axis, does not show that it buckles
    position = [[0, 0, 0], [0.85, 0, 0], [1.7, 0, 0]]
    column = settled(make_particles(position, np.array([True, False, True])))
    assert np.isnan(failing(column)).all()
    end = jnp.zeros((64, 3)).at[0, 0].set(1.0)
    tangent = eqx.tree_at(lambda p: p.particles.position, still(column), end)
    assert np.isnan(forward(column, tangent)).all()
    middle = Nodes(jnp.zeros((64, 3)).at[1, 0].set(1.0), None)
    assert np.isnan(flat(backward(column, middle).parameters)).all()


def test_cluster_in_two_parts_has_no_derivative(make_particles):
    triangle = np.array([[0, 0, 0], [0.95, 0, 0], [0.5, 0.9, 0]])
    parts = settled(make_particles(np.concatenate([triangle, triangle + 5])))
    assert np.isnan(failing(parts)).all()


def test_system_that_was_not_solved_gives_no_derivative(cage, monkeypatch):
    monkeypatch.setattr(response, "MAX_PRODUCTS", 3)
    for name in ("_forward", "_backward"):
        inner = getattr(implicit, name).__wrapped__
        monkeypatch.setattr(implicit, name, jax.jit(lambda r, v, f=inner: f(r, v)))
    assert np.isnan(failing(cage, method="lbfgs")).all()

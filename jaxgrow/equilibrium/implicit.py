r"""The derivative of an equilibrium with respect to everything it depends on.

At an equilibrium :math:`F(x^*, \theta) = 0`, so

.. math:: \delta x^* = H^{-1}\, \partial_\theta F\, \delta\theta, \qquad
          \bar\theta = (\partial_\theta F)^T H^{-1} \bar x

(implicit function theorem; H is symmetric, so the same solver serves both). Forward and
reverse mode take one linear solve in every direction, and keep the equilibrium alone:
nothing of the way to it. One more solve, when the equilibrium is found, proves it a
strict minimum (`jaxgrow.equilibrium.response`). If either fails the derivative is NaN,
all of it.

:math:`\theta` are the parameters, rest lengths, load, and positions of what is held or
pinned. Where free nodes started from carries no derivative: an equilibrium is unique
in its basin. Where nothing is pinned, the rigid motion of the whole is none either.

First derivatives only, one direction at a time: JAX has no rule to differentiate or to
batch `linear_call`, and says so (`jax.hessian`, `jax.jacfwd`, `jax.jacrev`).
"""

import equinox as eqx
import jax
import jax.numpy as jnp
from jax.core import Tracer
from jax.custom_derivatives import linear_call
from jax.flatten_util import ravel_pytree
from jaxtyping import Array, Bool, Float, PyTree

from jaxgrow.equilibrium.lists import Lists
from jaxgrow.equilibrium.loops import with_loops
from jaxgrow.equilibrium.problem import Problem
from jaxgrow.equilibrium.response import linearise, probe, solve
from jaxgrow.results import Result
from jaxgrow.state import Nodes


def is_differentiated(tree: PyTree) -> bool:
    """Whether a derivative is being taken with respect to a leaf."""
    return any(isinstance(leaf, Tracer) for leaf in jax.tree.leaves(tree))


def primal(tree: PyTree) -> PyTree:
    """The values without their derivatives."""
    return jax.tree.map(
        lambda a: jax.lax.stop_gradient(a) if eqx.is_array(a) else a, tree
    )


def at_equilibrium(
    problem: Problem, nodes: Nodes, lists: Lists, *, valid: bool
) -> Nodes:
    """The equilibrium, with its derivative in what the problem depends on.

    Args:
        problem: being differentiated.
        nodes: its equilibrium, without derivative; best relaxed to rounding, since
            the derivative is off by about its residual.
        lists: valid there.
        valid: whether it is an equilibrium; if not, the derivative is NaN.
    """
    known = with_loops(primal(problem).at(nodes), lists, products=True)
    problem = problem.with_loops(known.loops)
    proved = _is_minimum(known, lists) if valid else jnp.zeros((), bool)
    floats, rest = eqx.partition(problem, eqx.is_inexact_array)
    return _equilibrium(floats, (rest, nodes, lists, proved))


@eqx.filter_jit
def _is_minimum(problem: Problem, lists: Lists) -> Bool[Array, ""]:
    return probe(linearise(problem, lists)).code == Result.CONVERGED.code


@jax.custom_jvp
def _equilibrium(_: Problem, known: PyTree) -> Nodes:
    return known[1]


@_equilibrium.defjvp
def _equilibrium_jvp(primals: PyTree, tangents: PyTree) -> tuple[Nodes, Nodes]:
    floats, known = primals
    # one vector, since `linear_call` wants every operand to carry a derivative
    moved = linear_call(_forward, _backward, (floats, known), _ravelled(tangents[0]))
    return known[1], moved


@jax.jit
def _ravelled(floats: Problem) -> Float[Array, " k"]:
    return ravel_pytree(floats)[0]


def _forces_and_nodes(
    floats: Problem, rest: Problem, nodes: Nodes, lists: Lists
) -> tuple[Nodes, Nodes]:
    """Forces on what may move at the equilibrium, and the problem's own nodes."""
    problem = eqx.combine(floats, rest).with_loops(None)
    free, own = problem.free(), problem.nodes()
    at = jax.tree.map(lambda on, x, y: jnp.where(on > 0, x, y), free, nodes, own)
    return jax.tree.map(jnp.multiply, free, problem.forces(at, lists)), own


@jax.jit
def _forward(residuals: PyTree, flat: Float[Array, " k"]) -> Nodes:
    floats, (rest, nodes, lists, proved) = residuals
    varied = ravel_pytree(floats)[1](flat)
    problem = eqx.combine(floats, rest).at(nodes)
    _, (force, own) = jax.jvp(
        lambda f: _forces_and_nodes(f, rest, nodes, lists), (floats,), (varied,)
    )
    found = solve(linearise(problem, lists), force)
    good = proved & (found.code == Result.CONVERGED.code)

    def choose(on: Array, free: Array, own: Array) -> Array:
        return jnp.where(good, jnp.where(on > 0, free, own), jnp.nan)

    return jax.tree.map(choose, problem.free(), found.nodes, own)


@jax.jit
def _backward(residuals: PyTree, weight: Nodes) -> Float[Array, " k"]:
    floats, (rest, nodes, lists, proved) = residuals
    problem = eqx.combine(floats, rest).at(nodes)
    free = problem.free()
    masked = jax.tree.map(jnp.multiply, free, weight)
    found = solve(linearise(problem, lists), masked)
    good = proved & (found.code == Result.CONVERGED.code)
    own = jax.tree.map(lambda on, w: jnp.where(on > 0, 0, w), free, weight)
    _, pull = jax.vjp(lambda f: _forces_and_nodes(f, rest, nodes, lists), floats)
    (total,) = pull((found.nodes, own))
    return jnp.where(good, _ravelled(total), jnp.nan)

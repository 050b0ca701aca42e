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

*Jacobians.* `jax.jacfwd` and `jax.jacrev` solve for one direction after the other
(`jaxgrow.equilibrium.linear_map`), so every column or row has the bits of a single
derivative. Second derivatives, and what withholds the values, are refused
(`jaxgrow.equilibrium.transformations`).

*Forces* on what is held or pinned have a derivative too, which is computed where it is
asked for: :math:`\delta F = \partial_\theta F\, \delta\theta + \partial_x F\, \delta
x^*`.
"""

from collections.abc import Callable

import equinox as eqx
import jax
import jax.numpy as jnp
from jax.flatten_util import ravel_pytree
from jaxtyping import Array, Bool, Float, PyTree

from jaxgrow.equilibrium.linear_map import linear_map
from jaxgrow.equilibrium.lists import Lists
from jaxgrow.equilibrium.loops import with_loops
from jaxgrow.equilibrium.problem import Problem
from jaxgrow.equilibrium.response import linearise, probe, Response, solve
from jaxgrow.equilibrium.transformations import primal
from jaxgrow.results import Result
from jaxgrow.state import Nodes


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


def forces_at(problem: Problem, forces: Nodes, lists: Lists) -> Nodes:
    """The forces on all nodes, with their derivative.

    Args:
        problem: at its equilibrium, being differentiated.
        forces: on its nodes, without derivative.
        lists: valid there.
    """
    floats, rest = eqx.partition(problem, eqx.is_inexact_array)
    return _forces(floats, (rest, lists, forces))


@eqx.filter_jit
def _is_minimum(problem: Problem, lists: Lists) -> Bool[Array, ""]:
    return probe(linearise(problem, lists)).code == Result.CONVERGED.code


def _response(problem: Problem, lists: Lists, force: Nodes) -> Response:
    """The one solve that a derivative takes; nothing is asked of it but its answer."""
    return solve(linearise(problem, lists), force)


# the equilibrium


@jax.custom_jvp
def _equilibrium(_: Problem, known: PyTree) -> Nodes:
    return known[1]


@_equilibrium.defjvp
def _equilibrium_jvp(primals: PyTree, tangents: PyTree) -> tuple[Nodes, Nodes]:
    floats, known = primals
    nodes = known[1]
    moved = _map(_forward, _backward, (floats, known), tangents[0], nodes)
    return nodes, moved


@jax.jit
def _forward(constants: PyTree, flat: Float[Array, " k"]) -> Float[Array, " l"]:
    floats, (rest, nodes, lists, proved) = constants
    problem = eqx.combine(floats, rest).at(nodes)
    force, own = _pushed(_forces_and_nodes(rest, nodes, lists), floats, flat)
    found = _response(problem, lists, force)
    moved = _chosen(problem.free(), found.nodes, own)
    return _or_nan(_flat(moved), proved, found)


@jax.jit
def _backward(constants: PyTree, flat: Float[Array, " l"]) -> Float[Array, " k"]:
    floats, (rest, nodes, lists, proved) = constants
    problem = eqx.combine(floats, rest).at(nodes)
    free, weight = problem.free(), _shaped(flat, nodes)
    found = _response(problem, lists, jax.tree.map(jnp.multiply, free, weight))
    nothing = jax.tree.map(jnp.zeros_like, weight)
    on = (found.nodes, _chosen(free, nothing, weight))
    pulled = _pulled(_forces_and_nodes(rest, nodes, lists), floats, on)
    return _or_nan(pulled, proved, found)


def _forces_and_nodes(
    rest: Problem, nodes: Nodes, lists: Lists
) -> Callable[[Problem], tuple[Nodes, Nodes]]:
    """Forces on what may move at the equilibrium, and the problem's own nodes."""

    def compute(floats: Problem) -> tuple[Nodes, Nodes]:
        # derivatives in everything are XLA's: loops have those in positions alone
        problem = eqx.combine(floats, rest).with_loops(None)
        free, own = problem.free(), problem.nodes()
        forces = problem.forces(_chosen(free, nodes, own), lists)
        return jax.tree.map(jnp.multiply, free, forces), own

    return compute


def _chosen(free: Nodes, where_free: Nodes, elsewhere: Nodes) -> Nodes:
    """The one on rows that may move, the other on those that may not."""
    return jax.tree.map(
        lambda on, a, b: jnp.where(on > 0, a, b), free, where_free, elsewhere
    )


def _or_nan(flat: Float[Array, " k"], proved: Array, found: Response) -> Array:
    good = proved & (found.code == Result.CONVERGED.code)
    return jnp.where(good, flat, jnp.nan)


# the forces there


@jax.custom_jvp
def _forces(_: Problem, known: PyTree) -> Nodes:
    return known[2]


@_forces.defjvp
def _forces_jvp(primals: PyTree, tangents: PyTree) -> tuple[Nodes, Nodes]:
    floats, (rest, lists, forces) = primals
    constants = floats, rest, lists
    changed = _map(_push_forces, _pull_forces, constants, tangents[0], forces)
    return forces, changed


@jax.jit
def _push_forces(constants: PyTree, flat: Float[Array, " k"]) -> Float[Array, " l"]:
    floats, rest, lists = constants
    changed = _flat(_pushed(_all_forces(rest, lists), floats, flat))
    return jnp.where(jnp.all(jnp.isfinite(flat)), changed, jnp.nan)


@jax.jit
def _pull_forces(constants: PyTree, flat: Float[Array, " l"]) -> Float[Array, " k"]:
    floats, rest, lists = constants
    weight = _shaped(flat, eqx.combine(floats, rest).nodes())
    return _pulled(_all_forces(rest, lists), floats, weight)


def _all_forces(rest: Problem, lists: Lists) -> Callable[[Problem], Nodes]:
    """Forces on all nodes, where the problem is."""

    def compute(floats: Problem) -> Nodes:
        problem = eqx.combine(floats, rest).with_loops(None)
        return problem.forces(problem.nodes(), lists)

    return compute


# the parts of both


def _map(
    forward: Callable[..., Array],
    backward: Callable[..., Array],
    constants: PyTree,
    tangent: Problem,
    like: Nodes,
) -> Nodes:
    """A linear map from tangents of a problem's floats to tangents of its nodes."""
    rows = sum(leaf.size for leaf in jax.tree.leaves(like))
    flat = linear_map(forward, backward, constants, _flat(tangent), rows)
    return _shaped(flat, like)


def _pushed(
    function: Callable[[Problem], PyTree], floats: Problem, flat: Float[Array, " k"]
) -> PyTree:
    """What a function of a problem's floats changes by when they do."""
    return jax.jvp(function, (floats,), (_shaped(flat, floats),))[1]


def _pulled(
    function: Callable[[Problem], PyTree], floats: Problem, weight: PyTree
) -> Float[Array, " k"]:
    """The derivative of a function's weighted results in all of a problem's floats."""
    _, pull = jax.vjp(function, floats)
    (total,) = pull(weight)
    return _flat(total)


@jax.jit
def _flat(tree: PyTree) -> Float[Array, " k"]:
    return ravel_pytree(tree)[0]


@jax.jit
def _shaped(flat: Float[Array, " k"], like: PyTree) -> PyTree:
    return ravel_pytree(like)[1](flat)

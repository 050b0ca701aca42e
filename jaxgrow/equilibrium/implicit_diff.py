r"""Implicit differentiation of an equilibrium.

At an equilibrium :math:`F(x^*, \theta) = 0`, so

.. math:: \delta x^* = H^{-1}\, \partial_\theta F\, \delta\theta, \qquad
          \bar\theta = (\partial_\theta F)^T H^{-1} \bar x

(implicit function theorem; H is symmetric, so the same solver serves both). Forward and
reverse mode take one linear solve per direction, and store the equilibrium only, not
the path to it. One more solve, when the equilibrium is found, proves that it is a
strict minimum (`jaxgrow.equilibrium.hessian_solve`). If either fails the whole
derivative is NaN.

:math:`\theta` are the parameters, rest lengths, load, and positions of what is held or
pinned. The initial positions of free nodes carry no derivative: an equilibrium is
unique in its basin. If nothing is pinned, neither do rigid motions.

*Jacobians.* `jax.jacfwd` and `jax.jacrev` solve for one direction after the other
(`jaxgrow.equilibrium.linear_map`), so every column or row has the bits of a single
derivative. Second derivatives, and transformations that withhold values, are refused
(`jaxgrow.equilibrium.transformations`).

*Forces* on held and pinned nodes have a derivative too, from the same solve:
:math:`\delta F = \partial_p F\, \delta p - H\, \delta x`, with :math:`\delta x` on all
nodes. In reverse mode weights w of the forces and y of the nodes become

.. math:: \lambda = H_{ff}^{-1} (y - H w)_f, \qquad
          \bar p = (\partial_p F)^T (\lambda + w), \qquad
          \bar x_h = (y - H (\lambda + w))_h

on free nodes f, held ones h and in everything else p. :math:`v^T F` is minus the
derivative of the energy along v; its gradient in p differentiates no geometry twice.
"""

from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
from jax.flatten_util import ravel_pytree
from jaxtyping import Array, Bool, Float, Int, PyTree

from jaxgrow.equilibrium.hessian_solve import linearise, probe, Response, solve, solved
from jaxgrow.equilibrium.linear_map import linear_map
from jaxgrow.equilibrium.lists import Lists
from jaxgrow.equilibrium.loops import with_loops
from jaxgrow.equilibrium.problem import Problem
from jaxgrow.equilibrium.products import force_along, hessian_product
from jaxgrow.equilibrium.transformations import primal
from jaxgrow.runtime.results import Result
from jaxgrow.state import Nodes


EXACT = 1e-8
"""Relative residual of the linear solve of a derivative in 64 bits, and about its
error. With 1e-10 a solve takes a quarter more products, and gradients of growths are
not nearer to differences (``experiments/studies/gradient_quality.py``)."""


class Equilibrium(NamedTuple):
    """Equilibrium, or a change of it.

    Attributes:
        nodes: positions, in r0.
        forces: on all of them, in F(0).
    """

    nodes: Nodes
    forces: Nodes


class _Known(NamedTuple):
    """Constants of the derivative of an equilibrium.

    Attributes:
        problem: at the equilibrium, with the loops of Hessian products.
        lists: valid there.
        proved: whether it is a strict minimum.
    """

    problem: Problem
    lists: Lists
    proved: Bool[Array, ""]


def at_equilibrium(
    problem: Problem, found: Equilibrium, lists: Lists, *, valid: bool
) -> Equilibrium:
    """Return the equilibrium with its implicit derivative.

    Args:
        problem: being differentiated.
        found: its equilibrium, without derivative; best relaxed to rounding, since the
            error of the derivative is about its residual.
        lists: valid there.
        valid: whether it is an equilibrium; if not, the derivative is NaN.
    """
    there = with_loops(primal(problem).at(found.nodes), lists, products=True)
    proved = _is_minimum(there, lists) if valid else jnp.zeros((), bool)
    known = _Known(there, lists, proved)

    @jax.custom_jvp
    def equilibrium(_: Float[Array, " k"]) -> Equilibrium:
        return found

    @equilibrium.defjvp
    def _(primals: PyTree, tangents: PyTree) -> tuple[Equilibrium, Equilibrium]:
        rows = sum(leaf.size for leaf in jax.tree.leaves(found))
        moved = linear_map(_forward, _backward, known, tangents[0], rows)
        return equilibrium(*primals), _shaped(moved, found)

    return equilibrium(_flat(_floats(problem)))


@eqx.filter_jit
def _is_minimum(problem: Problem, lists: Lists) -> Bool[Array, ""]:
    return probe(linearise(problem, lists)).code == Result.CONVERGED.code


@jax.jit
def _forward(known: _Known, flat: Float[Array, " k"]) -> Float[Array, " l"]:
    """Compute the change of the equilibrium with that of the problem's floats."""
    problem, lists, _ = known
    nodes, free = problem.nodes(), problem.free()
    floats, rest = eqx.partition(problem.with_loops(None), eqx.is_inexact_array)
    changed = _shaped(flat, floats)

    def forces(floats: Problem) -> Nodes:
        return eqx.combine(floats, rest).forces(nodes, lists)

    _, felt = jax.jvp(forces, (floats,), (changed,))
    product = hessian_product(problem, nodes, lists)
    held = _chosen(free, jax.tree.map(jnp.zeros_like, nodes), changed.nodes())
    response = _respond(problem, lists, _minus(felt, product(held)))
    moved = _chosen(free, response.nodes, held)
    change = Equilibrium(moved, _minus(felt, product(moved)))
    return _or_nan(_flat(change), known, response.code)


@jax.jit
def _backward(known: _Known, flat: Float[Array, " l"]) -> Float[Array, " k"]:
    """Compute the transpose of `_forward`."""
    problem, lists, _ = known
    nodes, free = problem.nodes(), problem.free()
    floats, rest = eqx.partition(problem.with_loops(None), eqx.is_inexact_array)
    weight = _shaped(flat, Equilibrium(nodes, nodes))
    product = hessian_product(problem, nodes, lists)
    response = _respond(problem, lists, _minus(weight.nodes, product(weight.forces)))
    along = jax.tree.map(jnp.add, response.nodes, weight.forces)

    def felt(floats: Problem) -> Float[Array, ""]:
        return force_along(eqx.combine(floats, rest), nodes, lists, along)

    pulled = jax.grad(felt)(floats)
    held = _minus(weight.nodes, product(along))
    nothing = jax.tree.map(jnp.zeros_like, held)
    own = jax.tree.leaves(_chosen(free, nothing, held))
    pulled = eqx.tree_at(_positions, pulled, own)
    return _or_nan(_flat(pulled), known, response.code)


def _respond(problem: Problem, lists: Lists, force: Nodes) -> Response:
    """Solve for the response to a force, as exactly as a derivative needs it."""
    return solve(linearise(problem, lists), force, max(EXACT, solved(problem.dtype)))


def _floats(problem: Problem) -> Problem:
    return eqx.filter(problem, eqx.is_inexact_array)


def _positions(problem: Problem) -> list[Any]:
    """Return the leaves of the nodes of a problem."""
    particles, membrane = problem.particles, problem.membrane
    position = [] if particles is None else [particles.position]
    return position if membrane is None else [*position, membrane.vertices]


def _chosen(free: Nodes, where_free: Nodes, elsewhere: Nodes) -> Nodes:
    """Select the first on free rows, the second on all others."""
    return jax.tree.map(
        lambda on, a, b: jnp.where(on > 0, a, b), free, where_free, elsewhere
    )


def _minus(first: Nodes, second: Nodes) -> Nodes:
    return jax.tree.map(jnp.subtract, first, second)


def _or_nan(
    flat: Float[Array, " k"], known: _Known, code: Int[Array, ""]
) -> Float[Array, " k"]:
    good = known.proved & (code == Result.CONVERGED.code)
    return jnp.where(good, flat, jnp.nan)


@jax.jit
def _flat(tree: PyTree) -> Float[Array, " k"]:
    return ravel_pytree(tree)[0]


@jax.jit
def _shaped(flat: Float[Array, " k"], like: PyTree) -> PyTree:
    return ravel_pytree(like)[1](flat)

"""Products of the energy's derivatives with a displacement of all nodes.

With the forces F = -∇E: the force along a displacement, v·F, and the product with the
Hessian, ∇∇E v.
"""

from collections.abc import Callable

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from jaxgrow.equilibrium.extra_terms import EnergyFunction
from jaxgrow.equilibrium.lists import Lists
from jaxgrow.equilibrium.loops import evaluate
from jaxgrow.equilibrium.problem import Problem
from jaxgrow.state import Nodes


def force_along(
    problem: Problem, nodes: Nodes, lists: Lists, way: Nodes
) -> Float[Array, ""]:
    """Return the scalar product of forces and a displacement of all nodes.

    It is minus the derivative of the energy along it, and so can be differentiated in
    the inputs of the forces without a second derivative of distances.

    Args:
        problem: gives the energy.
        nodes: positions.
        lists: valid there.
        way: the displacement, in r0.
    """
    but = problem.but(functions=(), loops=None)
    _, slope = jax.jvp(lambda at: but.energy(at, lists), (nodes,), (way,))
    for function in problem.functions:  # may have reverse derivatives only

        def own(at: Nodes, energy: EnergyFunction = function) -> Array:
            moved = problem.at(at)
            return energy(moved.particles, moved.membrane)

        along = jax.tree.map(jnp.vdot, jax.grad(own)(nodes), way)
        slope += sum(jax.tree.leaves(along))
    return -slope


def hessian_product(
    problem: Problem, nodes: Nodes, lists: Lists
) -> Callable[[Nodes], Nodes]:
    """Return the function that multiplies a displacement by the Hessian.

    Args:
        problem: gives the energy; its loops of products are used if it has them.
        nodes: positions at which the Hessian is taken.
        lists: valid there.
    """
    loops = problem.loops
    if loops is None or loops.product is None:
        plain = problem.but(loops=None)
        _, slope = jax.linearize(lambda at: plain.forces(at, lists), nodes)
        return lambda along: jax.tree.map(jnp.negative, slope(along))

    def rest(at: Nodes) -> Float[Array, ""]:
        return problem.at(at).energy_here(lists, but=(*loops.names, "load"))

    def multiplied(along: Nodes) -> Nodes:
        own, _ = evaluate(problem, nodes, lists, along)
        if problem.is_looped(lists):
            return own
        more = jax.jvp(jax.grad(rest), (nodes,), (along,))[1]
        return jax.tree.map(jnp.add, own, more)

    return multiplied

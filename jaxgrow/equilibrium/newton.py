"""Newton's method near an equilibrium, to the rounding of the forces.

It converges quadratically down to rounding, where L-BFGS stalls. It is not cheaper:
from a residual of 1e-4 F(0) it takes about as many Hessian products as L-BFGS takes
steps, and a product costs about two force evaluations. Far from an equilibrium the
Hessian has negative curvature: this method then stops at the best positions found
(`jaxgrow.equilibrium.trust_region` handles that case).
"""

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from jaxgrow.equilibrium.descent import Descent
from jaxgrow.equilibrium.hessian_solve import linearise, solve
from jaxgrow.equilibrium.lists import Lists
from jaxgrow.equilibrium.problem import Problem
from jaxgrow.numerics.guards import safe_norm
from jaxgrow.runtime.results import Result
from jaxgrow.state import Nodes


MAX_ITERATIONS = 20
"""Bound on the iterations; four are usual."""

_HALVINGS = 6
"""Number of halvings of a displacement that does not reduce the largest force."""


def polish(
    problem: Problem,
    lists: Lists,
    tolerance: Float[Array, ""],
    largest: Float[Array, ""],
) -> Descent:
    """Iterate Newton's method: solve H δx = F and move by δx.

    The linear systems are solved only as exactly as the next iterate needs (inexact
    Newton, Dembo et al. 1982): to the residual itself, or to the tolerance. No node
    moves farther than the bound of the problem; all move by the same fraction.

    Args:
        problem: near an equilibrium.
        lists: valid for it.
        tolerance: largest force allowed on a free node, in F(0).
        largest: longest displacement of a node in one iteration, in r0.

    Returns:
        The best positions found; the steps are Hessian products.
    """
    free = problem.free()

    def measure(nodes: Nodes, lists: Lists) -> tuple[Nodes, Array]:
        force = problem.forces(nodes, lists)
        each = jax.tree.map(lambda f, on: jnp.max(safe_norm(on * f)), force, free)
        return force, jnp.max(jnp.stack(jax.tree.leaves(each)))

    def running(now: tuple[Descent, Array]) -> Array:
        best, iterations = now
        unfinished = (best.code == Result.STEP_LIMIT.code) & ~best.lists.stale
        return unfinished & (iterations < MAX_ITERATIONS)

    def iterate(now: tuple[Descent, Array]) -> tuple[Descent, Array]:
        best, iterations = now
        relative = jnp.clip(best.residual, 0.03 * tolerance / best.residual, 1e-2)
        at = problem.at(best.nodes)
        linear = linearise(at, best.lists)
        response = solve(linear, linear.force, relative)
        step = jax.tree.map(lambda a: jnp.where(jnp.isfinite(a), a, 0), response.nodes)
        limit = problem.bound(best.nodes, best.lists, largest)

        def fraction(move: Array, bound: Array, on: Array) -> Array:
            length = safe_norm(move)
            some = (length > 0) & (on[:, 0] > 0)
            return jnp.min(jnp.where(some, bound / jnp.where(some, length, 1), 1))

        fractions = jax.tree.map(fraction, step, limit, free)
        scale = jnp.minimum(1, jnp.min(jnp.stack(jax.tree.leaves(fractions))))

        def attempt(scale: Array) -> tuple[Nodes, Lists, Nodes, Array]:
            nodes = jax.tree.map(lambda x, d: x + scale * d, best.nodes, step)
            moved = problem.update(nodes, best.lists)
            return nodes, moved, *measure(nodes, moved)

        def worse(
            tried: tuple[Array, tuple[Nodes, Lists, Nodes, Array], Array],
        ) -> Array:
            _, (_, _, _, residual), halvings = tried
            return ~(residual < best.residual) & (halvings < _HALVINGS)

        def halve(
            tried: tuple[Array, tuple[Nodes, Lists, Nodes, Array], Array],
        ) -> tuple[Array, tuple[Nodes, Lists, Nodes, Array], Array]:
            scale, _, halvings = tried
            return scale / 2, attempt(scale / 2), halvings + 1

        # state before the first attempt, so that it is compiled once
        nowhere = (
            best.nodes,
            best.lists,
            best.force,
            jnp.full_like(best.residual, jnp.inf),
        )
        begin = 2 * scale, nowhere, jnp.full((), -1)
        _, (nodes, moved, force, residual), _ = jax.lax.while_loop(worse, halve, begin)
        better = (residual < best.residual) & ~moved.overflow
        code = jnp.where(residual <= tolerance, Result.CONVERGED.code, best.code)
        after = Descent(
            nodes, force, moved, None, residual, best.steps, best.rebuilds, code
        )
        kept = jax.tree.map(lambda a, b: jnp.where(better, a, b), after, best)
        kept = eqx.tree_at(lambda k: k.steps, kept, best.steps + response.products)
        return kept, jnp.where(better, iterations + 1, MAX_ITERATIONS)

    force, residual = measure(problem.nodes(), lists)
    code = jnp.where(
        residual <= tolerance, Result.CONVERGED.code, Result.STEP_LIMIT.code
    )
    none = jnp.zeros((), int)
    start = Descent(problem.nodes(), force, lists, None, residual, none, none, code)
    best, _ = jax.lax.while_loop(running, iterate, (start, none))
    return best
